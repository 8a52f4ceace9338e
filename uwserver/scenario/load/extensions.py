"""Runs Python files that a scenario names, which add kinds of sensor, modifier, actuator, current and fault.

Loading such a scenario runs its code.
"""

from __future__ import annotations

import hashlib
import re
import sys
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from uwserver.actuators import ActuatorConfig, ActuatorTable
from uwserver.environment.currents import CurrentConfig, CurrentTable
from uwserver.logs import place_of
from uwserver.modifiers import ModifierConfig, ModifierTable
from uwserver.scenario.files.convert import More, kinds_of
from uwserver.scenario.files.documents import MOST_BYTES, is_plain, read_whole, why_not
from uwserver.scenario.files.errors import KeyPath, Problem, label_of
from uwserver.sensors import SensorConfig, SensorTable
from uwserver.world.faults import FaultConfig, FaultTable

_LISTS: Mapping[str, tuple[type, Any]] = {
    "SENSORS": (SensorTable, SensorConfig),
    "MODIFIERS": (ModifierTable, ModifierConfig),
    "ACTUATORS": (ActuatorTable, ActuatorConfig),
    "CURRENTS": (CurrentTable, CurrentConfig),
    "FAULTS": (FaultTable, FaultConfig),
}
"""Names in a file that list its kinds: their base class, and the union of the shipped kinds."""


def extension_kinds(
    names: object,
    beside: Path,
    report: Callable[[KeyPath, str], None],
    add: Callable[[Problem], None],
    within: Path | None = None,
) -> More:
    """Run the extensions of a scenario and return their kinds.

    Args:
        names: value of the key `extensions`; anything but a list of names is reported elsewhere.
        beside: folder where relative names start.
        report: called for errors of the scenario file.
        add: called for errors of the Python files, which have their own places.
        within: folder in which they must lie after links are followed, so that its reader has seen all code that the scenario runs; None:
            anywhere.
    """
    more: dict[type, dict[str, Any]] = {base: {} for base, _ in _LISTS.values()}
    for k, name in enumerate(names if isinstance(names, (list, tuple)) else ()):
        if not isinstance(name, str) or not name:
            continue
        path = beside / name
        if path.suffix != ".py" or not is_plain(path):
            report(("extensions", k), f'there is no Python file "{label_of(path)}"{why_not(path)}')
        elif within is not None and not path.resolve().is_relative_to(within.resolve()):
            report(
                ("extensions", k),
                f'"{label_of(path)}" is code that would be run, but lies outside the folder of this file: move it there or into a folder below',
            )
        else:
            for problem in _run_and_list(path.resolve(), more):
                add(problem)
    return more


def _run_and_list(path: Path, more: dict[type, dict[str, Any]]) -> Iterator[Problem]:
    """Run a file and add the kinds that it lists; yield its errors."""
    label = label_of(path)
    try:
        source = read_whole(path, MOST_BYTES).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not valid UTF-8"
        yield Problem(label, 0, 0, "", f"cannot read it: {why}")
        return
    try:
        module = _run(path, source)
    except SyntaxError as error:
        yield Problem(label, error.lineno or 0, error.offset or 0, "", f"not valid Python: {error.msg}")
        return
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a file of the user may fail in any way
        text = f"running it failed: {type(error).__name__}: {error}"
        yield Problem(label, place_of(error, str(path))[1], 1, "", text)
        return
    if not any(hasattr(module, name) for name in _LISTS):
        text = f"it adds no kinds: list them in {', '.join(_LISTS)}, for example SENSORS = (MySensorTable,)"
        yield Problem(label, 1, 1, "", text)
    for name, (base, union) in _LISTS.items():
        listed = getattr(module, name, ())
        if not isinstance(listed, Sequence):
            yield Problem(label, _line_of(source, rf"{name}\b"), 1, name, "expected a list of classes")
            continue
        for kind in listed:
            taken = {**kinds_of(union), **more[base]}
            fault = _fault(kind, base, taken)
            if fault:
                line = _line_of(source, rf"class {getattr(kind, '__name__', name)}\b|{name}\b")
                yield Problem(label, line, 1, name, fault)
            else:
                more[base][str(kind.__struct_config__.tag)] = kind


def _run(path: Path, source: str) -> types.ModuleType:
    # Not by an import: that would write a cache beside the user's file, and could run an older version from it.
    module = types.ModuleType(f"uwserver_extension_{hashlib.sha256(str(path).encode()).hexdigest()[:16]}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # msgspec looks up annotations of Structs there
    exec(compile(source, str(path), "exec"), module.__dict__)
    return module


def _fault(kind: Any, base: type, taken: Mapping[str, Any]) -> str:
    """Return why a class cannot be a kind; "" if it can."""
    if not isinstance(kind, type) or not issubclass(kind, base):
        return f"{kind!r} does not derive from {_public(base)}: derive it as the shipped kinds do"
    tag = str(kind.__struct_config__.tag)  # type: ignore[attr-defined]  # it is a Struct
    if not callable(getattr(kind, "build", None)):
        return f"{kind.__name__} has no method build(): add one as the shipped kinds have it"
    if tag == kind.__name__:  # msgspec's default if the class gives none
        return f'{kind.__name__} has no tag, which names its kind in files: write class {kind.__name__}({base.__name__}, tag="...", ...)'
    if tag in taken:
        return f'there is a kind "{tag}" already: give the class {kind.__name__} another tag'
    return ""


def _public(base: type) -> str:
    """Return the name to import a class by: from the package if that exports it, else from its module."""
    package = base.__module__.rpartition(".")[0]
    return f"{package if hasattr(sys.modules[package], base.__name__) else base.__module__}.{base.__name__}"


def _line_of(source: str, pattern: str) -> int:
    """Return the first line that begins with the pattern; 1 if none does."""
    found = re.search(rf"^(?:{pattern})", source, re.M)
    return source.count("\n", 0, found.start()) + 1 if found else 1
