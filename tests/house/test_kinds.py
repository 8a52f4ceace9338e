"""Only the room of a kind knows it: others read what its table declares (`Traits`, `Devices`, `message`), and ask for no class and no kind."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from functools import cache
from typing import NamedTuple

import pytest
from sources import ROOT, Module, module_of, modules

ROOMS = ("sensors", "actuators")
"""Rooms with a file for each kind, and a union where the room begins."""


class Kind(NamedTuple):
    """A kind: the class of its table, what files call it, and where it stands."""

    table: str
    tag: str
    module: str


@cache
def kinds(room: str) -> tuple[Kind, ...]:
    """All that the union of a room names."""
    (head,) = (module for module in modules("uwserver") if module.name == f"uwserver.{room}")
    named = {i.name: i.target for i in head.imports}
    texts = {module.name: module.text for module in modules("uwserver")}
    return tuple(
        Kind(name, tag, target)
        for name, target in named.items()
        if (tag := _tag(texts.get(target, ""), name)) is not None
    )


def _tag(text: str, name: str) -> str | None:
    """The kind that a class is in files; None of a class that is none."""
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef) and node.name == name:
            tags = [k.value.value for k in node.keywords if k.arg == "tag" and isinstance(k.value, ast.Constant)]
            return str(tags[0]) if tags else None
    return None


def classes_of_kinds(each: Iterable[Module]) -> list[str]:
    """Where a room names the table of a kind of another room, or takes anything of the file of a kind of sensor."""
    wrong = []
    for module in each:
        for room in ROOMS:
            tables = {kind.table for kind in kinds(room)}
            files = {kind.module for kind in kinds(room)} if room == "sensors" else set()
            if not module.name.startswith(f"uwserver.{room}"):
                wrong += [
                    module.at(i.line, i.name or i.target)
                    for i in module.imports
                    if i.name in tables or i.target in files
                ]
    return wrong


def switches(each: Iterable[Module]) -> list[str]:
    """Where something is done for one kind of sensor or another: its kind is compared, matched, or looked up in a table of kinds."""
    tags = {kind.tag for kind in kinds("sensors")}
    wrong = []
    for module in each:
        if module.name.startswith("uwserver.sensors"):
            continue
        nodes = list(module.nodes(r"kind\b"))
        tables = dict(_tables(nodes, tags))
        for node in nodes:
            for what in _asked(node):
                keys = {what} if isinstance(what, str) else tables.get(ast.unparse(what), set()) | _texts(what, tags)
                wrong += [module.at(getattr(node, "lineno", 0), key) for key in sorted(keys & tags)]
    return wrong


def _asked(node: ast.AST) -> Iterator[ast.expr | str]:
    """With what a kind is compared, or in what it is looked up."""
    if isinstance(node, ast.Compare) and len(node.comparators) == 1:
        left, right = node.left, node.comparators[0]
        yield from [right] if _is_kind(left) else []
        yield from [left] if _is_kind(right) else []
    elif isinstance(node, ast.Subscript) and _is_kind(node.slice):
        yield node.value
    elif (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in ("get", "index", "pop")
    ):
        yield from [node.func.value] if node.args and _is_kind(node.args[0]) else []
    elif isinstance(node, ast.Match) and _is_kind(node.subject):
        for case in node.cases:
            yield from (
                value.value
                for value in ast.walk(case.pattern)
                if isinstance(value, ast.Constant) and isinstance(value.value, str)
            )


def _is_kind(node: ast.expr) -> bool:
    return (isinstance(node, ast.Attribute) and node.attr in ("kind", "tag")) or (
        isinstance(node, ast.Name) and node.id == "kind"
    )


def _tables(nodes: Iterable[ast.AST], tags: set[str]) -> Iterator[tuple[str, set[str]]]:
    """Names that a module gives to tables, and the kinds that these hold as keys or items."""
    for node in nodes:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            held = _texts(node.value, tags)
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            yield from ((ast.unparse(target), held) for target in targets if held)


def _texts(node: ast.expr | None, tags: set[str]) -> set[str]:
    """Kinds that an expression names: itself, as items, or as keys of a dictionary."""
    if isinstance(node, ast.Constant):
        return {node.value} & tags if isinstance(node.value, str) else set()
    inner: list[ast.expr | None] = []
    if isinstance(node, ast.Dict):
        inner += node.keys
    if isinstance(node, ast.Tuple | ast.List | ast.Set):
        inner += node.elts
    if isinstance(node, ast.Call):
        inner += node.args
    return set().union(*(_texts(each, tags) for each in inner))


_SCRIPTS = ROOT / "clients/web"
_NAMED = re.compile(
    r"""\bkind\b\)*\s*[!=]==?\s*["'](\w+)["']|["'](\w+)["']\s*[!=]==?\s*[\w.?]*\bkind\b|\bcase\s+["'](\w+)["']"""
)
"""A kind that a script compares with a text, or the text of a case."""
_LOOKED_UP = re.compile(
    r"\.kind\s*[!=]==?\s*\w|\w\s*[!=]==?\s*[\w.?]+\.kind\b|\w\[[^\]\n,]*\.kind\)*\]|\.(?:get|has|includes|indexOf)\([^()\n]*\.kind\b"
)
"""A kind that a script compares with a variable, or looks up in a table."""


def script_switches(name: str, text: str) -> list[str]:
    """Return where a script of the page asks of which kind a sensor is. It may ask so of shapes, actuators and panels, by their names alone."""
    tags = {kind.tag for kind in kinds("sensors")}
    wrong = []
    for number, line in enumerate(text.splitlines(), 1):
        named = {tag for found in _NAMED.findall(line) for tag in found} & tags
        looked_up = {found.group() for found in _LOOKED_UP.finditer(line)}
        wrong += [f"{name}:{number}: {what}" for what in sorted(named | looked_up)]
    return wrong


EVERYBODY = ("uwserver", "uwserver_adapters")


def test_every_kind_is_found():
    """Else the rules would look for nothing."""
    assert {"imu", "dvl", "camera", "compound"} <= {kind.tag for kind in kinds("sensors")}
    assert {"thrusters", "force_torque", "ballast"} <= {kind.tag for kind in kinds("actuators")}


@pytest.mark.parametrize("package", EVERYBODY)
def test_no_other_room_names_the_class_of_a_kind(package: str):
    assert classes_of_kinds(modules(package)) == []


@pytest.mark.parametrize("package", EVERYBODY)
def test_no_other_room_asks_of_which_kind_a_sensor_is(package: str):
    """What a middleware makes of a standard message, it may look up by the plain name of the message."""
    assert switches(modules(package)) == []


def test_no_script_of_the_page_asks_of_which_kind_a_sensor_is():
    """It draws and shows a sensor by its message, its beams and its fields, so it treats one of an extension as it treats a shipped one."""
    scripts = [path for path in _SCRIPTS.rglob("*.js") if "vendor" not in path.parts]
    assert len(scripts) > 30
    assert [fault for path in sorted(scripts) for fault in script_switches(path.name, path.read_text())] == []


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ('port.message === "Dvl" || shape.kind === "box" || kind === "waypoint"', 0),
        ("h('div', {}, port.kind.replaceAll('_', ' '))", 0),
        ("const own = JSON.stringify([sensor.kind, sensor.p]); known.get(kind)", 0),
        ('sensor.kind === "dvl"', 1),
        ("'usbl' === port.kind || port.kind !== 'lbl'", 2),
        ('switch (port.kind) {\ncase "altimeter":', 1),
        ("ports.find((port) => port.kind === kind)", 1),
        ("COLOUR[/** @type {keyof typeof COLOUR} */ (sensor.kind)] ?? other", 1),
        ("KINDS.includes(port.kind)", 1),
    ],
)
def test_a_switch_over_kinds_in_a_script_is_found(text: str, count: int):
    assert len(script_switches("a.js", text)) == count


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("from uwserver.sensors import Pose, SensorConfig, SensorTable", 0),
        ("from uwserver.sensors import DvlConfig, Pose", 1),
        ("from uwserver.sensors.optical.camera.camera import Camera", 1),
        ("from uwserver.actuators import Thrusters, ThrustersConfig", 1),
    ],
)
def test_the_class_of_a_kind_is_found(text: str, count: int):
    assert len(classes_of_kinds([module_of("uwserver.scenario.build.a", text)])) == count


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ('def f(port):\n    return port.message == "Dvl" or port.kind == "autopilot"', 0),
        ('imu: str = "imu"', 0),
        ('def f(port):\n    return port.kind == "dvl"', 1),
        ('def f(kind):\n    return kind in ("usbl", "lbl")', 2),
        ('TABLE = {"imu": 1, "dvl": 2}\ndef f(port):\n    return TABLE.get(port.kind)', 2),
        ('def f(port):\n    match port.kind:\n        case "imu" | "dvl":\n            return 1', 2),
    ],
)
def test_a_switch_over_kinds_is_found(text: str, count: int):
    assert len(switches([module_of("uwserver_adapters.ros.a", text)])) == count
    assert switches([module_of("uwserver.sensors.a", text)]) == []
