"""The rules of the house, read from the source: who may import whom, what stands where, how large a thing may grow.

Nothing is imported to check them, except where a rule says so. Each rule states its reason where it is checked.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
SOURCE_ROOTS = {
    "uwserver": ROOT,
    "uwserver_bench": ROOT / "bench",
    "uwserver_adapters": ROOT / "adapters",
    "uwserver_scenarios": ROOT / "scenarios",
    "uwclient": ROOT / "clients" / "python",
}

# Parts of uwserver, highest first. A module imports only from lower lines, or from its own part; parts that share a line do not
# know each other. So each part can be understood, tested and replaced with what is below it alone.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("__main__",),
    ("cli",),  # verbs of a person: may use everything
    ("server",),  # life cycle: the first that knows loop and thread
    ("recording",),  # a sink, its file, and what runs it again
    ("simulation",),  # the simulation thread, and the crossing to the loop
    ("copies",),  # a scenario's world many times over, in this process
    ("scenario",),  # files -> world; adapters' configuration types come from their contract
    ("logfiles",),  # logs of any origin, as poses and samples
    ("adapter",),  # contract of adapters: knows ports and tables alone, so that an adapter needs nothing more
    ("world",),  # the tick and what lives in it
    ("autopilot",),  # shows its state as a sensor
    ("actuators", "sensors"),
    ("modifiers",),
    ("environment",),  # asks the kernel what the water does
    ("physics",),  # arrays and kernel: knows no component
    ("ports",),  # the vocabulary of every wall
    ("frames", "table", "logs"),
    ("units",),
)
KITS = {"testing": "server", "validation": "recording"}
"""Parts beside the layers: the testing kit of others, and the proofs of physics. Each imports only what stands below the part named, and is
imported by no layer but `cli`."""
RANK = {part: rank for rank, line in enumerate(LAYERS) for part in line}

CONTRACT = {
    "uwserver.adapter",
    "uwserver.adapter.foxglove",
    "uwserver.adapter.pictures",
    "uwserver.ports",
    "uwserver.frames",
    "uwserver.table",
    "uwserver.units",
}
"""All of uwserver that an adapter may import."""

SHARED_BY_ADAPTERS = {
    "uwserver_adapters.native",
    "uwserver_adapters.ros",
    "uwserver_adapters.sil",
    "uwserver_adapters.zenoh_session",
}
"""What several adapters need and no kit can hold: the protocol of uwserver's own, the messages of ROS, the simulator interfaces of autopilots,
and how a session of zenoh is opened."""

LOOP = {"server", "adapter", "cli", "testing"}
"""Parts that may know asyncio and sockets: below them is the simulation, which never waits for a peer."""

CLOCKS = {"uwserver.physics.kernel.right_of_way", "uwserver.simulation.clock", "uwserver.world.threads"}
"""Modules that may read the machine's time: all others ask a Clock, so that tests and free-run need no waiting. Those of the threads measure how
many of them step a world fastest, and how long one has kept the interpreter, which changes no number of it."""

DEGREES = {"uwserver.units"}
"""Where degrees become radians. Loader and codecs call it."""

BULLET = "uwserver.physics.collision.bullet"
"""The only home of pybullet, which is an optional dependency and holds the interpreter lock."""


class Module(NamedTuple):
    """A source file: dotted name, path, text and syntax tree."""

    name: str
    path: Path
    text: str
    tree: ast.Module

    @property
    def part(self) -> str:
        """Its line in LAYERS."""
        return self.name.split(".")[1] if "." in self.name else ""


class Import(NamedTuple):
    """A module named in an import, where, and whether at run time of the module itself (neither in a function nor for type checkers)."""

    target: str
    line: int
    eager: bool


@cache
def modules(package: str) -> tuple[Module, ...]:
    """All source files of one of the SOURCE_ROOTS."""
    base = SOURCE_ROOTS[package]
    found = []
    for path in sorted((base / package).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        name = ".".join(path.relative_to(base).with_suffix("").parts).removesuffix(".__init__")
        found.append(Module(name, path, text, ast.parse(text)))
    assert found, f"no source of {package}"
    return tuple(found)


def every_module() -> Iterator[Module]:
    for package in SOURCE_ROOTS:
        yield from modules(package)


def is_module(name: str) -> bool:
    base = SOURCE_ROOTS.get(name.split(".", 1)[0])
    path = base / Path(*name.split(".")) if base else None
    return path is not None and (path.with_suffix(".py").is_file() or (path / "__init__.py").is_file())


def imports(module: Module) -> list[Import]:
    """Every import, also those inside functions: a cycle that waits is a cycle."""
    found: list[Import] = []

    def visit(node: ast.AST, eager: bool) -> None:
        if isinstance(node, ast.Import):
            found.extend(Import(alias.name, node.lineno, eager) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module.path}:{node.lineno}: relative import"
            source = node.module or ""
            targets = {
                f"{source}.{alias.name}" if is_module(f"{source}.{alias.name}") else source for alias in node.names
            }
            found.extend(Import(target, node.lineno, eager) for target in sorted(targets))
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            eager = False
        inner = eager and not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        for child in ast.iter_child_nodes(node):
            visit(child, inner)

    visit(module.tree, True)
    return found


def at(module: Module, line: int, what: str) -> str:
    return f"{module.path.relative_to(ROOT)}:{line}: {what}"


def importers(package: str, names: set[str]) -> list[tuple[Module, Import]]:
    """Who imports one of these top-level modules."""
    return [(m, i) for m in modules(package) for i in imports(m) if i.target.split(".")[0] in names]


# -- layers -----------------------------------------------------------------------------------------------------------------------------


def test_every_part_of_uwserver_has_a_layer():
    parts = {module.part for module in modules("uwserver")} - {"", *KITS}
    assert parts <= RANK.keys(), f"give {sorted(parts - RANK.keys())} a line in LAYERS"


def test_imports_point_down():
    wrong = []
    for module in modules("uwserver"):
        if module.part == "" or module.part in KITS:
            continue  # the package itself and what stands beside the layers have their own rules
        for target, line, _ in imports(module):
            package, _, rest = target.partition(".")
            part = rest.split(".")[0]
            if package != "uwserver" or not part or part == module.part:
                continue
            if part in KITS and module.part == "cli":
                continue
            if part in KITS or RANK[part] <= RANK[module.part]:
                wrong.append(
                    at(module, line, f"{module.name} must not import {target}: it stands above it or beside it")
                )
    assert not wrong, "\n".join(wrong)


def test_physics_knows_no_component():
    """The kernel is arrays in, arrays out; only `units` and its own modules."""
    for module in modules("uwserver"):
        if module.part == "physics":
            ours = {i.target for i in imports(module) if i.target.startswith("uwserver.")}
            others = {
                t
                for t in ours
                if not t.startswith("uwserver.physics") and t not in ("uwserver.units", "uwserver.frames")
            }
            assert not others, f"{module.name} imports {others}"


def test_ports_and_units_import_nothing_of_ours():
    """They are the vocabulary of everybody, of other languages too."""
    for module in modules("uwserver"):
        if module.part in ("ports", "units", "frames", "table"):
            wrong = [i.target for i in imports(module) if i.target.startswith("uw") and module.part not in i.target]
            assert not wrong, f"{module.name} imports {wrong}"


def test_import_uwserver_is_cheap():
    """`import uwserver` must stay quick: the package imports nothing of ours before `load` is called, and others take its version alone."""
    (package,) = (module for module in modules("uwserver") if module.name == "uwserver")
    assert not [i for i in imports(package) if i.eager and i.target.startswith("uwserver")]
    for module in every_module():
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ImportFrom) and node.module == "uwserver":
                names = [a.name for a in node.names if not is_module(f"uwserver.{a.name}")]
                assert set(names) <= {"__version__"}, at(module, node.lineno, f"from uwserver import {names}")


def test_what_stands_beside_the_layers_cannot_start_a_server():
    """The kit is public, and proofs are of physics: what they need of uwserver stands below the server."""
    for module in modules("uwserver"):
        if module.part in KITS:
            for target, line, _ in imports(module):
                part = target.split(".")[1] if target.startswith("uwserver.") else module.part
                below = part == module.part or (part in RANK and RANK[part] > RANK[KITS[module.part]])
                assert below, at(module, line, f"imports {target}")
                assert target.split(".")[0] not in ("uwserver_adapters", "pytest"), at(
                    module, line, f"imports {target}"
                )


def test_no_import_circle_between_modules():
    """Two modules that need each other are one module; a circle that waits inside a function, or is for types alone, is a circle."""
    graph = {m.name: {i.target for i in imports(m)} - {m.name} for m in every_module()}
    assert circles(graph) == []


def test_no_import_circle_between_rooms():
    """A room is a folder; what its __init__ hands on is a room of its own, and so is each module at the top of a source root."""
    graph: dict[str, set[str]] = {}
    names = {module.name: module for module in every_module()}
    for module in names.values():
        targets = {room_of(names[i.target]) for i in imports(module) if i.target in names}
        graph.setdefault(room_of(module), set()).update(targets - {room_of(module)})
    assert circles(graph) == []


def room_of(module: Module) -> str:
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


def test_nothing_in_uwserver_knows_an_adapter_or_a_client():
    """Adapters and the benchmark are found by entry point: a new one needs no edit here. Scenarios are read as package resources."""
    wrong = [
        at(m, i.line, i.target)
        for m, i in importers("uwserver", {"uwserver_adapters", "uwclient", "uwserver_scenarios", "uwserver_bench"})
    ]
    assert not wrong, wrong


def test_validation_serves_its_commands_alone():
    """`validation` is in the installed package for what a person asks of a model (`validate`, `manoeuvres`, `plot vehicle`); proofs that nobody
    asks for stand beside the benchmark, which stays out. No simulation runs through it."""
    users = {m.name for m in modules("uwserver") for i in imports(m) if i.target.startswith("uwserver.validation")}
    own = {m.name for m in modules("uwserver") if m.part == "validation"}
    assert users - own == {f"uwserver.cli.{name}" for name in ("validate", "manoeuvres", "plot", "vehicle_picture")}


def test_adapters_know_the_contract_alone():
    """Whatever else an adapter needs comes from its context; so one written outside this repository can do all that ours can."""
    wrong = []
    for module in modules("uwserver_adapters"):
        own = ".".join(module.name.split(".")[:2])
        for target, line, _ in imports(module):
            package = target.split(".")[0]
            if package == "uwclient" or (package == "uwserver" and target not in CONTRACT):
                wrong.append(at(module, line, f"imports {target}; allowed: {', '.join(sorted(CONTRACT))}"))
            shared = {own, *SHARED_BY_ADAPTERS}
            if package == "uwserver_adapters" and ".".join(target.split(".")[:2]) not in shared:
                wrong.append(at(module, line, f"imports {target}: adapters do not know each other"))
    assert not wrong, "\n".join(wrong)


def test_the_client_stands_alone():
    """It is its own distribution, for machines without the simulator; and so it proves that the documented wire is enough."""
    wrong = [
        at(m, i.line, i.target)
        for m, i in importers("uwclient", {"uwserver", "uwserver_adapters", "uwserver_scenarios"})
    ]
    assert not wrong, wrong


@pytest.mark.parametrize("folder", ["adapters", "scenarios", "clients", "clients/python"])
def test_source_roots_are_no_packages(folder):
    """An `import adapters` would claim a global name."""
    assert not (ROOT / folder / "__init__.py").exists()


# -- what stands where ------------------------------------------------------------------------------------------------------------------


def test_loop_and_sockets_only_at_the_top_and_in_adapters():
    """The tick never waits for a peer, so nothing below the server may know one."""
    network = {"asyncio", "socket", "socketserver", "selectors", "ssl", "http", "urllib"}
    wrong = [at(m, i.line, i.target) for m, i in importers("uwserver", network) if m.part not in LOOP]
    assert not wrong, wrong


def test_only_the_clock_reads_the_time():
    """All other code asks a Clock (or the loop), so that free-run is free, and tests wait for nothing."""
    wrong = [at(m, i.line, i.target) for m, i in importers("uwserver", {"time"}) if m.name not in CLOCKS]
    wrong += [at(m, i.line, i.target) for m, i in importers("uwserver_adapters", {"time"})]
    for module in modules("uwserver"):
        if module.part in ("world", "physics", "sensors", "modifiers", "actuators", "environment"):
            wrong += [at(module, i.line, i.target) for i in imports(module) if i.target == "datetime"]
    assert not wrong, wrong


def test_bullet_has_one_home():
    found = importers("uwserver", {"pybullet", "pybullet_data"})
    assert {module.name for module, _ in found} == {BULLET}


def test_no_global_randomness():
    """Each component draws from its own stream, seeded by scenario and path: runs repeat, and nobody shifts another's numbers."""
    wrong = []
    for module in every_module():
        if module.name.startswith("uwclient"):
            continue
        wrong += [at(module, i.line, "random") for i in imports(module) if i.target == "random"]
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Attribute):
                dotted = ast.unparse(node)
                drawn = re.fullmatch(r"(np|numpy)\.random\.(\w+)", dotted)
                if drawn and drawn[2] not in ("Generator", "PCG64", "Philox", "SeedSequence", "default_rng"):
                    wrong.append(at(module, node.lineno, dotted))
            if isinstance(node, ast.Call) and not node.args and not node.keywords:
                unseeded = re.search(r"(default_rng|PCG64|Philox)$", ast.unparse(node.func))
                if unseeded:
                    wrong.append(at(module, node.lineno, f"{unseeded[1]}() without a seed"))
    assert not wrong, wrong


def test_degrees_meet_radians_in_one_module():
    """Inside there are only radians; loader and codecs convert with `units`, so no factor is written twice."""
    words = {"radians", "degrees", "deg2rad", "rad2deg"}
    wrong = []
    for module in (*modules("uwserver"), *modules("uwserver_adapters")):
        if module.name in DEGREES:
            continue
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Attribute) and node.attr in words:
                wrong.append(at(module, node.lineno, ast.unparse(node)))
            if (
                isinstance(node, ast.ImportFrom)
                and node.module in ("math", "numpy")
                and words & {a.name for a in node.names}
            ):
                wrong.append(at(module, node.lineno, ast.unparse(node)))
            if isinstance(node, ast.Constant) and isinstance(node.value, float | int) and _is_degree_factor(node.value):
                wrong.append(at(module, node.lineno, f"literal {node.value}"))
    assert not wrong, wrong


def _is_degree_factor(number: float) -> bool:
    return number in (180, 360) or abs(number - 57.2958) < 1e-2 or abs(number - 0.0174533) < 1e-5


def test_degrees_are_converted_only_at_the_border():
    """Called by the loader and what it builds of tables (files), by codecs (wires), and by reports (people)."""
    for module in modules("uwserver"):
        uses = {
            a.name for n in ast.walk(module.tree) if isinstance(n, ast.ImportFrom) and n.module == "uwserver.units" for a in n.names
        } & {"rad", "deg"}  # fmt: skip
        if uses:
            # Missions are files too, though a client sends them; so are logs. Foxglove's messages are a wire.
            exceptions = (
                "uwserver.autopilot.route",
                "uwserver.autopilot.services",
                "uwserver.adapter.foxglove.codec",
                "uwserver.logfiles.si",
            )
            is_report = module.name.startswith("uwserver.recording.report.")  # for people
            is_file = module.part in ("scenario", "sensors", "modifiers", "validation") or module.name in exceptions
            assert is_file or is_report, f"{module.name} uses {uses}"
    for module in modules("uwserver_adapters"):
        if any(i.target == "uwserver.units" for i in imports(module)):
            assert module.name.rsplit(".", 1)[-1] == "codec", f"{module.name}: units are converted in codec.py"


# -- size and names ---------------------------------------------------------------------------------------------------------------------


def test_no_module_has_more_than_400_lines():
    """What does not fit on a few screens does more than one thing."""
    long = {m.name: n for m in every_module() if (n := m.text.count("\n")) > 400}
    assert not long


def test_no_function_has_more_than_60_lines():
    """Aim at 50. The equation of motion is one formula; to cut it would hide it, and a compiled call costs."""
    allowed = {"uwserver.physics.dynamics.fossen.derivative": 98}
    wrong = []
    for module in every_module():
        for node in ast.walk(module.tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                if lines > allowed.get(f"{module.name}.{node.name}", 60):
                    wrong.append(at(module, node.lineno, f"{node.name} has {lines} lines"))
    assert not wrong, wrong


def test_no_empty_names():
    """Such a name says that its owner did not know what the thing is; it then collects everything else."""
    empty = re.compile(r"(manager|helper|util|utils|handler|handlers|helpers|misc|common)$", re.IGNORECASE)
    wrong = []
    for module in every_module():
        parts = module.name.split(".")
        if any(re.search(rf"(^|_){empty.pattern}", part, re.IGNORECASE) for part in parts):
            wrong.append(module.name)
        wrong += [
            f"{module.name}.{n.name}"
            for n in ast.walk(module.tree)
            if isinstance(n, ast.ClassDef) and empty.search(n.name)
        ]
    assert not wrong, wrong


def test_every_public_name_has_a_docstring():
    """Units, frames and errors are said there. A method that a framework or a contract names may leave it to that."""
    wrong = []
    for module in modules("uwserver"):
        assert ast.get_docstring(module.tree) or not module.tree.body, f"{module.name} has no docstring"
        wrong += [at(module, node.lineno, node.name) for node in _public(module.tree) if not ast.get_docstring(node)]
    assert not wrong, "\n".join(wrong)


def _public(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef]:
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for member in node.body:
                if isinstance(member, ast.FunctionDef | ast.AsyncFunctionDef) and not member.name.startswith("_"):
                    setter = any(isinstance(d, ast.Attribute) and d.attr == "setter" for d in member.decorator_list)
                    if not setter and not _inherited(node, member.name):
                        yield member


def _inherited(owner: ast.ClassDef, name: str) -> bool:
    """Whether a class fills in what another declares and documents (a subclass, `build` of a table, or an adapter's subscriber)."""
    bases = [ast.unparse(base) for base in owner.bases]
    if name == "build" and any(base.endswith("Table") for base in bases):
        return True
    return bool(bases) and not any(base.endswith(("Protocol", "Table", "Struct")) for base in bases)


# -- tests ------------------------------------------------------------------------------------------------------------------------------

TABLES_ALONE = {
    "uwserver.__main__": "one line that calls the command line",
    "uwserver.units": "factors",
    "uwserver.simulation.services": "a table of services, which test_thread calls",
    "uwserver.autopilot.config": "a table of the scenario's keys",
    "uwserver.autopilot.modes": "a table of modes and of what each holds",
}
"""Modules without behaviour of their own, each with the reason why nothing could be tested of it alone."""

TESTED_WITH = {
    "adapter": {
        "aside": "adapter/test_connection",
        **{f"foxglove.{name}": "adapter/foxglove/test_codec" for name in ("protobuf", "schemas", "shapes")},
    },
    "actuators": {
        "ballast": "actuators/test_servos", "base": "actuators/test_policy", "fin": "actuators/test_servos",
        "moving_mass": "actuators/test_servos", "propeller": "actuators/test_servos", "servo": "actuators/test_servos",
    },
    "copies": {
        "clocks": "copies/test_kernels", "copy": "copies/test_batch", "description": "copies/test_batch", "loops": "copies/test_batch",
        "readings": "copies/test_batch", "rounds": "copies/test_batch", "start": "copies/test_batch",
    },
    "autopilot": {
        "craft": "autopilot/test_outputs", "entries": "autopilot/test_bank", "fins": "autopilot/test_allocation",
        "flight": "autopilot/test_bank", "gains": "autopilot/test_estimator",
        "hover": "autopilot/test_hovering", "pilot": "autopilot/test_orders", "plausibility": "world/test_piloting", "ports": "autopilot/test_orders",
        "route": "autopilot/test_mission", "rows": "autopilot/test_bank", "records": "autopilot/test_bank",
        "services": "autopilot/test_orders",
        "sources": "autopilot/test_estimator", "state": "autopilot/test_orders", "status": "autopilot/test_orders",
        "sticks": "autopilot/test_hovering", "torpedo": "autopilot/test_torpedoes", "tracks": "autopilot/test_torpedoes",
    },
    "cli": {"diagnosis": "cli/test_doctor", "pictures": "cli/test_plot", "replay": "../integration/test_replay"},
    "environment": {"materials": "sensors/acoustic/test_altimeter", "sea": "environment/test_currents"},
    "modifiers": dict.fromkeys(
        ("base", "bias", "delivery", "drift", "misalignment", "noise", "quantise"), "modifiers/test_contract"
    ),
    "physics": {
        "dynamics.runge_kutta": "physics/dynamics/test_integrator", "entries": "physics/test_bodies",
        "kernel.atomics": "physics/kernel/test_sharing", "kernel.giving_way": "physics/kernel/test_right_of_way",
    },
    "recording": {
        "player_deck": "recording/test_player", "player_items": "recording/test_player_track",
        "player_messages": "recording/test_player_track", "player_services": "recording/test_player",
        "player_world": "recording/test_player",
        "report.contents": "recording/report/test_summary", "report.drawing": "recording/report/test_writing",
        "looker": "recording/test_states", "output": "recording/test_recorder",
        "parts": "recording/test_recorder",
    },
    "logfiles": {
        "decoding": "logfiles/test_mcap_file", "foreign": "logfiles/test_opening", "indexed": "logfiles/test_tlog",
        "mcap_records": "logfiles/test_mcap_file", "port_rules": "logfiles/test_rules", "ros_messages": "logfiles/test_bags",
        "si": "logfiles/test_mapping",
        **dict.fromkeys(("export.alog", "export.rosbag2", "export.tlog"), "logfiles/export/test_there_and_back"),
    },
    "scenario": {"build.modems": "world/modems/test_medium", "solids.palette": "scenario/scene/test_scenery"},
    "sensors": {
        "acoustic.echo": "sensors/acoustic/test_altimeter", "acoustic.fan": "sensors/acoustic/test_scanning_sonar",
        "acoustic.current_profile": "sensors/acoustic/test_adcp", "acoustic.janus": "sensors/acoustic/test_dvl",
        "latest": "sensors/test_compound", "messages": "sensors/test_modem", "wiring": "sensors/onboard/test_contact",
        "writing": "world/test_stretch",
        **{f"optical.camera.{name}": "sensors/optical/camera/test_picture" for name in ("formation", "rays", "view")},
        "optical.camera.kernels": "sensors/optical/camera/test_camera",
    },
    "simulation": {"goal": "simulation/test_thread", "source": "server/test_playback"},
    "table": {"": "scenario/files/test_convert"},
    "testing": {
        "adapter_kit": "testing/test_adapters", "call_checks": "testing/test_adapters", "fake_context": "adapter/test_roles",
        "fake_scene": "adapters/web/test_site",
        "loopback": "adapters/sockets/test_connection", "mock_time": "simulation/test_clock", "traces": "../conformance/test_adapters",
    },
    "world": {
        "faults.hull": "world/faults/test_faults", "faults.table": "world/faults/test_faults",
        "faults.targets": "world/faults/test_faults", "faults.timeline": "world/faults/test_faults",
        "agenda": "world/test_stretch", "due": "world/test_sensing", "in_process": "world/test_world", "on_their_way": "world/test_sensing",
        "ticking": "world/test_stretch", "modems.node": "world/modems/test_medium", "modems.packets": "world/modems/test_medium",
        "modems.ways": "world/modems/test_medium", "streams": "world/test_delivery",
    },
}  # fmt: skip
"""Modules that a file named otherwise tests, most often together with their siblings."""


def test_every_module_has_a_test_file():
    """Who changes a module finds its tests at the same place below tests/unit; where several are tested together, the table says where."""
    wrong = []
    for module in modules("uwserver"):
        if module.path.name == "__init__.py" or module.name in TABLES_ALONE:
            continue
        rest = module.name.removeprefix(f"uwserver.{module.part}").lstrip(".")
        together = TESTED_WITH.get(module.part, {}).get(rest)
        own = module.path.relative_to(ROOT / "uwserver")
        file = f"{together}.py" if together else str(own.with_name(f"test_{own.name}"))
        if not (ROOT / "tests" / "unit" / file).is_file():
            wrong.append(f"{module.name}: write tests/unit/{file}, or say in TESTED_WITH which file tests it")
    assert not wrong, "\n".join(wrong)


# -- ports (these rules import the configurations) ---------------------------------------------------------------------------------------

UNITS = {
    "1", "m", "m/s", "m/s^2", "rad", "rad/s", "rad/s^2", "N", "N m", "Pa", "degC", "s", "Hz", "kg", "T", "V", "A", "W", "m^3",
    "mm", "m^2/s^2", "J", "N s", "S/m", "m^2", "ns", "dB", "N, N m",
}  # fmt: skip


@pytest.fixture(scope="module")
def all_ports():
    from uwserver.actuators import ForceTorqueConfig
    from uwserver.scenario.build.world import build
    from uwserver.scenario.load.scenario import load
    from uwserver.sensors import SensorConfig

    world = build(load("one_of_everything", adapters=_any_adapters()))
    kinds = {port.kind for port in world.ports.values()}
    tags = {str(config.__struct_config__.tag) for config in (*SensorConfig.__args__, ForceTorqueConfig)}
    assert tags <= kinds, "one_of_everything has lost a kind"
    return world.ports


def _any_adapters():
    from uwserver.adapter import installed_adapters

    return installed_adapters()


def test_every_field_has_unit_and_text(all_ports):
    """A number without unit is a guess."""
    for path, port in all_ports.items():
        for field in port.fields:
            assert field.unit in UNITS, f'{path}.{field.name}: unit "{field.unit}"'
            assert field.doc.strip(), f"{path}.{field.name}"


def test_every_vector_has_a_frame(all_ports):
    """Three components without frame are a guess too. A list of things of one kind has none: commands of devices, or a plural name."""
    for path, port in all_ports.items():
        for field in port.fields:
            is_list = (
                port.kind in ("thrusters", "fins")
                or (field.name.endswith("s") and field.shape)
                or (port.kind == "autopilot" and field.shape == (6,))  # of all six axes, in B
            )
            if field.shape and not is_list:
                assert field.frame, f"{path}.{field.name} has no frame"
            if not field.shape or is_list:
                assert field.frame == "", f"{path}.{field.name} has a frame"


def test_names_of_vectors_end_in_their_frame(all_ports):
    """Monogram notation: what is seen on the wire says in which frame it is."""
    for path, port in all_ports.items():
        for field in port.fields:
            if field.frame in ("B", "S"):
                assert field.name.endswith(f"_{field.frame}"), f"{path}.{field.name} in {field.frame}"
            elif field.frame:
                # A set point or an estimate of the autopilot is that of B, by its nature.
                word = r"[pqv](_ref)?_NB?" if port.kind == "autopilot" else r"(\w+_)?[pqv]_N[BS]|velocities_N"
                assert re.fullmatch(word, field.name), f"{path}.{field.name} in {field.frame}"


def test_every_service_and_argument_has_a_text(world):
    for path, service in world.services.items():
        assert inspect.cleandoc(service.doc).endswith("."), path
        for argument in service.arguments:
            assert argument.doc, f"{path} {argument.name}"
            assert argument.unit, f"{path} {argument.name}"
