"""Checks a command against the description of its port before anything is sent. No input or output.

The codes are those of the server, so a caller deals with one kind of refusal. Limits of values are left to the server.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Protocol, cast, runtime_checkable

from uwclient.buffers import packed
from uwclient.errors import CallRefused
from uwclient.ports import Field, Port


@runtime_checkable
class _HasToList(Protocol):
    """A numpy array or scalar, recognised without importing numpy."""

    def tolist(self) -> object: ...


def command_value(ports: Mapping[str, Port], path: str, fields: Mapping[str, object]) -> dict[str, object]:
    """Return the value to send, in plain numbers and lists; numpy arrays are converted.

    Raises:
        CallRefused: `unknown_port`, `bad_argument`, `bad_shape` or `not_finite`; the text says what is allowed.
    """
    port = _actuator(ports, path)
    by_name = {field.name: field for field in port.fields}
    if not fields:
        raise CallRefused(f"a command to {path} needs at least one of: {_named(port)}", code="bad_argument", where=path)
    for name in fields:
        if name not in by_name:
            raise CallRefused(
                f'{path} has no field "{name}"{_similar(name, by_name)}; it takes: {_named(port)}',
                code="bad_argument",
                where=name,
            )
    return {name: _prepared(path, by_name[name], value) for name, value in fields.items()}


def _prepared(path: str, field: Field, value: object) -> object:
    if field.type in ("bytes", "buffer"):
        return packed(value)  # the server checks type and shape
    return _checked(path, field, plain(value))


def plain(value: object) -> object:
    """Return `value` with arrays and tuples converted to lists, for either encoding."""
    if isinstance(value, _HasToList):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in cast("list[object]", value)]
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in cast("Mapping[object, object]", value).items()}
    return value


def _actuator(ports: Mapping[str, Port], path: str) -> Port:
    actuators = sorted(port.path for port in ports.values() if port.direction == "actuator")
    allowed = f"actuators here: {', '.join(actuators) or 'none'}"
    if path not in ports:
        raise CallRefused(
            f'there is no port "{path}"{_similar(path, actuators)}; {allowed}', code="unknown_port", where=path
        )
    if ports[path].direction != "actuator":
        raise CallRefused(f"{path} is a sensor and takes no command; {allowed}", code="bad_argument", where=path)
    return ports[path]


def _checked(path: str, field: Field, value: object) -> object:
    where = f"{path}.{field.name}"
    if not _has_shape(value, field.shape):
        raise CallRefused(f"{where} takes {_form(field)}, not {_abridged(value)}", code="bad_shape", where=field.name)
    for leaf in _leaves(value):
        _check_leaf(where, field, leaf)
    return value


def _check_leaf(where: str, field: Field, leaf: object) -> None:
    wanted = {"float": (int, float), "int": (int,), "bool": (bool,), "string": (str,), "str": (str,)}.get(field.type)
    if wanted is None:
        return  # a type of a later server, which checks it
    if not isinstance(leaf, wanted) or (isinstance(leaf, bool) and field.type != "bool"):
        raise CallRefused(
            f"{where} takes {_form(field)}; {_abridged(leaf)} is of type {type(leaf).__name__}",
            code="bad_argument",
            where=field.name,
        )
    if isinstance(leaf, float) and not math.isfinite(leaf):
        raise CallRefused(
            f"{where} takes finite numbers only, not {leaf}; the last good command stands",
            code="not_finite",
            where=field.name,
        )


def _has_shape(value: object, shape: tuple[int, ...]) -> bool:
    if not shape:
        return not isinstance(value, (list, dict))
    if not isinstance(value, list):
        return False
    entries = cast("list[object]", value)
    return shape[0] in (-1, len(entries)) and all(_has_shape(entry, shape[1:]) for entry in entries)


def _leaves(value: object) -> Iterable[object]:
    if not isinstance(value, list):
        yield value
        return
    for entry in cast("list[object]", value):
        yield from _leaves(entry)


def _form(field: Field) -> str:
    sizes = " x ".join("n" if size < 0 else str(size) for size in field.shape)
    if field.type == "buffer":
        return f"a buffer of {field.dtype} {sizes}"
    if not field.shape:
        return f"one {field.type}" if field.type != "bytes" else "bytes"
    return f"a list of {sizes} {field.type}"


def _named(port: Port) -> str:
    return ", ".join(f"{field.name} ({_form(field)}, {field.unit or '1'})" for field in port.fields) or "no field"


def _similar(name: str, names: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(names), n=1)
    return f' (did you mean "{close[0]}"?)' if close else ""


def _abridged(value: object) -> str:
    shown = repr(value)
    return shown if len(shown) <= 60 else shown[:57] + "..."
