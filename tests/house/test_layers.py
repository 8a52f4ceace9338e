"""Who may import whom."""

from __future__ import annotations

import re
from collections.abc import Iterable

import pytest
from layers import RANK, VOCABULARY, stands_at_least
from sources import ROOT, Module, every_module, module_of, modules


def part_of(target: str) -> str:
    """The part of uwserver that an import names; empty for uwserver itself, and for all else."""
    package, _, rest = target.partition(".")
    return rest.split(".")[0] if package == "uwserver" else ""


def upward(each: Iterable[Module]) -> list[str]:
    """Imports of uwserver that do not point down."""
    return [
        module.at(line, f"{module.name} must not import {target}: it stands above it or beside it")
        for module in each
        for target, _, line, _ in module.imports
        if module.part and (part := part_of(target)) not in ("", module.part) and stands_at_least(part, module.part)
    ]


def taken(each: Iterable[Module], packages: set[str]) -> list[str]:
    """Imports of what such packages hold."""
    return [
        module.at(line, f"imports {target}")
        for module in each
        for target, _, line, _ in module.imports
        if target.split(".")[0] in packages
    ]


def test_every_part_of_uwserver_has_a_layer():
    parts = {module.part for module in modules("uwserver")} - {""}
    assert parts <= RANK.keys(), f"give {sorted(parts - RANK.keys())} a line in LAYERS"


def test_imports_point_down():
    assert upward(modules("uwserver")) == []


def test_an_import_that_does_not_point_down_is_found():
    up, beside = "import uwserver.world.parts.part", "def f():\n    from uwserver.actuators import Thrusters"
    assert len(upward([module_of("uwserver.physics.a", up), module_of("uwserver.sensors.a", beside)])) == 2
    assert upward([module_of("uwserver.world.a", "import uwserver.physics.scene, uwserver.world.b, math")]) == []


def test_imports_are_absolute():
    """Else a rule would not see where they lead."""
    assert [m.at(line, target) for m in every_module() for target, _, line, _ in m.imports if target[0] == "."] == []


def test_physics_knows_no_component():
    """The kernel is arrays in, arrays out: of ours it imports only units and rotations, and the command that installs an engine."""
    used = {part_of(i.target) for module in modules("uwserver") if module.part == "physics" for i in module.imports}
    assert used <= {"", "physics", "units", "frames", "packages"}


def test_the_vocabulary_imports_nothing_of_ours():
    for module in modules("uwserver"):
        if module.part in VOCABULARY:
            own = tuple(name for name in {i.target for i in module.imports} if name.startswith("uw"))
            assert {part_of(name) for name in own} <= {module.part}, f"{module.name} imports {own}"


def test_import_uwserver_is_cheap():
    """The package imports nothing of ours but its version before `load` is called, and nobody imports from it: that would be a circle."""
    (package,) = (module for module in modules("uwserver") if module.name == "uwserver")
    eager = {i.target for i in package.imports if i.eager and i.target.startswith("uwserver")}
    assert eager == {"uwserver.version"}
    for module in every_module():
        for target, name, line, _ in module.imports:
            assert target != "uwserver" or name == "", module.at(line, f"from uwserver import {name}")


@pytest.mark.parametrize("kit", ["testing", "validation"])
def test_what_is_there_for_tests_and_commands_serves_the_commands_alone(kit: str):
    """No simulation runs through it. `validation` is in the installed package for what a person asks of a model; proofs that nobody asks for
    stand beside the benchmark, which stays out."""
    users = {m.name for m in modules("uwserver") if m.part != kit for i in m.imports if part_of(i.target) == kit}
    assert {user for user in users if not user.startswith("uwserver.cli.")} == set()


def test_nothing_that_is_installed_needs_pytest():
    assert taken(modules("uwserver"), {"pytest"}) + taken(modules("uwserver_adapters"), {"pytest"}) == []


# -- circles ----------------------------------------------------------------------------------------------------------------------------


def test_no_import_circle_between_modules():
    """Two modules that need each other are one module; a circle that waits inside a function, or is for types alone, is a circle."""
    assert circles({m.name: {i.target for i in m.imports} - {m.name} for m in every_module()}) == []


def test_no_import_circle_between_rooms():
    """A room is a folder; what its __init__ hands on is a room of its own, and so is each module at the top of a source root."""
    graph: dict[str, set[str]] = {}
    names = {module.name: module for module in every_module()}
    for module in names.values():
        targets = {room_of(names[i.target]) for i in module.imports if i.target in names}
        graph.setdefault(room_of(module), set()).update(targets - {room_of(module)})
    assert circles(graph) == []


def room_of(module: Module) -> str:
    """The folder that a module is in."""
    if module.path.name == "__init__.py":
        return f"{module.name}.__init__"
    return module.name if module.name.count(".") == 1 else module.name.rpartition(".")[0]


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of nodes that reach each other (Tarjan 1972)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        order[node] = low[node] = len(order)
        stack.append(node)
        for after in sorted(graph.get(node, ())):
            if after not in order:
                visit(after)
            if after in stack:
                low[node] = min(low[node], low[after])
        if low[node] == order[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(sorted(group))

    for node in sorted(graph):
        if node not in order:
            visit(node)
    return found


def test_circles_are_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c"]]


# -- adapters, client, benchmark --------------------------------------------------------------------------------------------------------


def test_nothing_in_uwserver_knows_an_adapter_or_a_client():
    """Adapters and the benchmark are found by entry point: a new one needs no edit here. Scenarios are read as package resources."""
    others = {"uwserver_adapters", "uwclient", "uwserver_scenarios", "uwserver_bench"}
    assert taken(modules("uwserver"), others) == []


def test_the_client_stands_alone():
    """It is its own distribution, for machines without the simulator; and so it proves that the documented wire is enough."""
    assert taken(modules("uwclient"), {"uwserver", "uwserver_adapters", "uwserver_scenarios"}) == []


def beyond_the_contract(each: Iterable[Module], faces: set[str], entries: set[str]) -> list[str]:
    """What adapters import though it is neither the vocabulary nor a face of the contract, nor what several of them share.

    Args:
        each: their modules.
        faces: modules that say in `__all__` what they are for.
        entries: packages of adapters, which are found by entry point; other packages beside them are there to be shared.
    """
    wrong = []
    for module in each:
        own = package_of(module.name)
        for target, line in sorted({(i.target, i.line) for i in module.imports}):
            part = part_of(target)
            contract = target == f"uwserver.{part}" and (part in VOCABULARY or part == "adapter")
            contract = contract or (part == "adapter" and target in faces)
            if target.split(".")[0] == "uwclient" or (target.split(".")[0] == "uwserver" and not contract):
                wrong.append(
                    module.at(line, f"imports {target}: take it from uwserver.adapter, ports, frames, table, units")
                )
            if package_of(target) in entries - {own}:
                wrong.append(
                    module.at(line, f"imports {target}: adapters do not know each other; share a package that is none")
                )
    return wrong


def package_of(name: str) -> str:
    return ".".join(name.split(".")[:2])


def test_adapters_know_the_contract_alone():
    """Whatever else an adapter needs comes from its context; so one written outside this repository can do all that ours can."""
    faces = {module.name for module in modules("uwserver") if re.search(r"^__all__ =", module.text, re.M)}
    table = (ROOT / "pyproject.toml").read_text().partition('[project.entry-points."uwserver.adapters"]\n')[2]
    entries = {package_of(name) for name in re.findall(r'^\w+ = "([\w.]+):', table.partition("\n[")[0], re.M)}
    assert len(entries) > 10
    assert beyond_the_contract(modules("uwserver_adapters"), faces, entries) == []


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("from uwserver.adapter import Adapter", 0),
        ("import uwserver.adapter.drawing", 0),
        ("import uwserver_adapters.shared.codec", 0),
        ("import uwserver_adapters.mine.codec", 0),
        ("from uwserver.adapter.contract import Adapter", 1),
        ("from uwserver.world import World", 1),
        ("from uwserver import load", 1),
        ("import uwserver_adapters.other.codec", 1),
        ("import uwclient", 1),
    ],
)
def test_what_is_beyond_the_contract_is_found(line: str, count: int):
    entries = {"uwserver_adapters.mine", "uwserver_adapters.other"}
    module = module_of("uwserver_adapters.mine.adapter", line)
    assert len(beyond_the_contract([module], {"uwserver.adapter.drawing", "uwserver.world"}, entries)) == count


@pytest.mark.parametrize("folder", ["adapters", "scenarios", "clients", "clients/python"])
def test_source_roots_are_no_packages(folder: str):
    """An `import adapters` would claim a global name."""
    assert not (ROOT / folder / "__init__.py").exists()
