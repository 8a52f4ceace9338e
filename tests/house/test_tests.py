"""Who changes a module finds its tests."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from sources import ROOT, Module, module_of, modules, paths

IMPORT = re.compile(r"^ *(?:from ([\w.]+) import (\([^)]*\)|.*)|import (uw[\w.]+))", re.M)
ALSO = re.compile(r"Also of ((?:uwserver[\w.]*\w(?:,\s|\sand\s)?)+)")
"""How the docstring of a test file names modules without a file of their own that it tests."""


def untested(each: Iterable[Module], tests: Mapping[str, str]) -> list[str]:
    """Modules of uwserver that no test is found of.

    Tests of `uwserver/room/module.py` are in `tests/unit/room/test_module.py`; or in another file of the room that imports the module or a name of
    it; or in a file whose docstring says so: "Also of uwserver.room.module".

    Args:
        each: all modules.
        tests: text of each file of tests, by its path in tests/.
    """
    each = list(each)
    origins = {(m.name, i.name): i.target for m in each if m.path.name == "__init__.py" for i in m.imports}
    used = {path: set(imported(text, origins)) for path, text in tests.items()}
    named = {name for text in tests.values() for name in also(text)}
    wrong = []
    for module in each:
        if module.path.name == "__init__.py" or module.name in named:
            continue
        own = Path("unit", *module.path.parts[1:])
        file = str(own.with_name(f"test_{own.name}"))
        room = str(Path(*own.parts[:2])) + "/" if len(own.parts) > 2 else ""
        if file not in tests and not any(module.name in used[path] for path in tests if path.startswith(f"{room}")):
            wrong.append(
                f'{module.name}: write tests/{file}, or say "Also of {module.name}" in the docstring of what tests it'
            )
    return wrong


def imported(text: str, origins: Mapping[tuple[str, str], str]) -> Iterator[str]:
    """Modules that a file takes something of, also where the `__init__` of their package hands it on."""
    for source, names, whole in IMPORT.findall(text):
        yield from filter(None, (source, whole))
        for name in re.findall(r"(\w+)(?: as \w+)?", re.sub(r"#.*", "", names)):
            yield f"{source}.{name}"
            origin = origins.get((source, name))
            while origin is not None:
                yield origin
                origin = origins.get((origin, name))


def also(text: str) -> list[str]:
    """Modules that the docstring of a test file names."""
    found = re.match(r'\s*"""(.*?)"""', text, re.S)
    return [name for each in ALSO.findall(found[1] if found else "") for name in re.findall(r"uwserver[\w.]*\w", each)]


def files_of_tests() -> dict[str, str]:
    base = ROOT / "tests"
    return {str(path.relative_to(base)): path.read_text(encoding="utf-8") for path in sorted(base.rglob("test_*.py"))}


def test_every_module_has_tests():
    assert untested(modules("uwserver"), files_of_tests()) == []


def test_modules_that_tests_say_they_are_of_are_there():
    lost = [
        f"tests/{path}: {name}" for path, text in files_of_tests().items() for name in also(text) if name not in paths()
    ]
    assert lost == []


def test_a_module_without_tests_is_found():
    module = module_of("uwserver.room.thing", "", Path("uwserver/room/thing.py"))
    hands_on = module_of("uwserver.room", "from uwserver.room.thing import Thing", Path("uwserver/room/__init__.py"))

    def is_tested(path: str, text: str) -> bool:
        return untested([module, hands_on], {path: text}) == []

    assert is_tested("unit/room/test_thing.py", "")
    assert is_tested("unit/room/test_all.py", "from uwserver.room.thing import (\n    Thing,\n)")
    assert is_tested("unit/room/inner/test_all.py", "from uwserver.room import Other, Thing")
    assert is_tested(
        "unit/server/test_all.py",
        '"""All of it. Also of uwserver.table, uwserver.room.other and\nuwserver.room.thing."""',
    )
    assert not is_tested("unit/room/test_all.py", "from uwserver.room import Other\nimport uwserver.room.things")
    assert not is_tested("unit/server/test_all.py", "from uwserver.room.thing import Thing")
    assert not is_tested("unit/server/test_all.py", '"""Much."""\nX = "Also of uwserver.room.thing"')
