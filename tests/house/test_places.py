"""What stands where: sockets, time, chance, degrees, the engine of others."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable

import pytest
from layers import stands_at_least
from sources import Function, Module, every_module, module_of, modules

NETWORK = {"asyncio", "socket", "socketserver", "selectors", "ssl", "http", "urllib"}
CLOCK = "uwserver.simulation.clock"
UNITS = "uwserver.units"
BULLET = "uwserver.physics.collision.bullet"
WORDS = {"radians", "degrees", "deg2rad", "rad2deg"}
SUSPECT_FACTOR = (*(rf"\.{word}\b" for word in sorted(WORDS)), "180", "360", r"57\.[23]", r"\.0174", r"1\.74\d*[eE]")
TABLES = ("scenario", "sensors", "modifiers", "validation")
"""Parts that make numbers of the tables of files."""


def importing(module: Module, packages: set[str]) -> list[str]:
    """Its imports of such packages."""
    return [module.at(i.line, i.target) for i in module.imports if i.target.split(".")[0] in packages]


# -- sockets ----------------------------------------------------------------------------------------------------------------------------


def sockets(each: Iterable[Module]) -> list[str]:
    """Where the network is known, though neither the server, nor what stands above it, nor the contract of adapters is there."""
    below = (
        module for module in each if module.part not in ("", "adapter") and not stands_at_least(module.part, "server")
    )
    return [wrong for module in below for wrong in importing(module, NETWORK)]


def test_the_network_is_known_from_the_server_up_and_to_the_contract_of_adapters():
    """The tick never waits for a peer, so nothing below the server may know one."""
    assert sockets(modules("uwserver")) == []


def test_a_socket_below_the_server_is_found():
    text = "def f():\n    from asyncio import sleep\n    import urllib.request"
    assert len(sockets([module_of("uwserver.simulation.a", text)])) == 2
    assert sockets([module_of("uwserver.server.a", text), module_of("uwserver.adapter.a", text)]) == []


# -- time -------------------------------------------------------------------------------------------------------------------------------


def readings_of_time(each: Iterable[Module]) -> list[str]:
    """Where the machine's time is read by another than the clock.

    Who measures how long something takes is given a clock; that this is `perf_counter_ns` unless a test gives another, its parameter may say.
    """
    wrong = []
    for module in each:
        taken = [i for i in module.imports if i.target == "time" and i.name != "perf_counter_ns"]
        wrong += [module.at(i.line, f"{i.target} {i.name}") for i in taken]
        nodes = list(module.nodes("perf_counter_ns", r"\.now\b", r"\.utcnow\b", r"\.today\b"))
        defaults = {id(value) for node in nodes if isinstance(node, Function) for value in _defaults(node.args)}
        for node in nodes:
            if isinstance(node, ast.Name) and node.id == "perf_counter_ns" and id(node) not in defaults:
                wrong.append(module.at(node.lineno, "perf_counter_ns, not as what a parameter is by default"))
            if isinstance(node, ast.Attribute) and re.fullmatch(
                r"(\w+\.)?(datetime\.(utc)?now|date(time)?\.today)", _text(node)
            ):
                wrong.append(module.at(node.lineno, _text(node)))
    return wrong


def _defaults(arguments: ast.arguments) -> list[ast.expr]:
    return [*arguments.defaults, *(value for value in arguments.kw_defaults if value is not None)]


def _text(node: ast.Attribute) -> str:
    return ast.unparse(node)


def test_only_the_clock_reads_the_time():
    """All other code asks a Clock (or the loop), so that free-run is free, and tests wait for nothing."""
    assert readings_of_time(module for module in modules("uwserver") if module.name != CLOCK) == []
    assert [wrong for module in modules("uwserver_adapters") for wrong in importing(module, {"time"})] == []


def test_a_world_knows_no_calendar():
    below = (m for m in modules("uwserver") if m.part and stands_at_least("world", m.part))
    assert [wrong for module in below for wrong in importing(module, {"datetime"})] == []


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("import time", 1),
        ("from time import sleep", 1),
        ("def f():\n    from time import monotonic_ns as now", 1),
        ("from time import perf_counter_ns\nt = perf_counter_ns()", 1),
        ("from time import perf_counter_ns\nclass A:\n    def f(self):\n        self.now = perf_counter_ns", 1),
        ("from time import perf_counter_ns\ndef f(now_ns=perf_counter_ns, *, too=perf_counter_ns): ...", 0),
        ("from datetime import datetime\nt = datetime.now(timezone.utc)", 1),
        ("import datetime\nt = datetime.date.today()", 1),
        ("from datetime import datetime\nt = datetime.fromtimestamp(0.0)", 0),
    ],
)
def test_who_reads_the_time_is_found(text: str, count: int):
    assert len(readings_of_time([module_of("uwserver.world.a", text)])) == count


# -- chance -----------------------------------------------------------------------------------------------------------------------------


SEEDED = "Generator|PCG64|Philox|SeedSequence|default_rng"
SUSPECT_DRAW = (rf"\.random\.(?!({SEEDED})\b)", r"default_rng\(\)", r"PCG64\(\)", r"Philox\(\)")


def common_chance(each: Iterable[Module]) -> list[str]:
    """Where numbers are drawn from a stream of all, or from one that nobody has seeded."""
    wrong = []
    for module in each:
        wrong += [module.at(i.line, "random") for i in module.imports if i.target == "random"]
        for node in module.nodes(*SUSPECT_DRAW):
            if isinstance(node, ast.Attribute):
                drawn = re.fullmatch(r"(np|numpy)\.random\.(\w+)", ast.unparse(node))
                if drawn and drawn[2] not in SEEDED.split("|"):
                    wrong.append(module.at(node.lineno, drawn[0]))
            if isinstance(node, ast.Call) and not node.args and not node.keywords:
                unseeded = re.search(r"(default_rng|PCG64|Philox)$", ast.unparse(node.func))
                if unseeded:
                    wrong.append(module.at(node.lineno, f"{unseeded[1]}() without a seed"))
    return wrong


def test_no_global_randomness():
    """Each component draws from its own stream, seeded by scenario and path: runs repeat, and nobody shifts another's numbers."""
    assert common_chance(module for module in every_module() if not module.name.startswith("uwclient")) == []


def test_common_chance_is_found():
    text = "import random\nimport numpy as np\nx = np.random.normal() + np.random.default_rng().normal()\nfine = np.random.Philox(5)"
    assert len(common_chance([module_of("uwserver.sensors.a", text)])) == 3


# -- degrees ----------------------------------------------------------------------------------------------------------------------------


def second_factors(each: Iterable[Module]) -> list[str]:
    """Where degrees become radians, or the other way round, without `units`."""
    wrong = []
    for module in each:
        wrong += [
            module.at(i.line, i.name) for i in module.imports if i.target in ("math", "numpy") and i.name in WORDS
        ]
        for node in module.nodes(*SUSPECT_FACTOR):
            if isinstance(node, ast.Attribute) and node.attr in WORDS:
                wrong.append(module.at(node.lineno, ast.unparse(node)))
            if isinstance(node, ast.Constant) and isinstance(node.value, float | int) and _is_factor(node.value):
                wrong.append(module.at(node.lineno, f"literal {node.value}"))
    return wrong


def _is_factor(number: float) -> bool:
    return number in (180, 360) or abs(number - 57.2958) < 1e-2 or abs(number - 0.0174533) < 1e-5


def test_degrees_meet_radians_in_one_module():
    """Inside there are only radians; loader and codecs convert with `units`, so no factor is written twice."""
    assert second_factors(module for module in modules("uwserver") if module.name != UNITS) == []
    assert second_factors(modules("uwserver_adapters")) == []


@pytest.mark.parametrize(
    "text",
    [
        "from math import radians",
        "import numpy as np\nx = np.deg2rad(1.0)",
        "x = a / 180 * pi",
        "x = 0.017453 * a",
        "x = 57.2958",
    ],
)
def test_a_second_factor_is_found(text: str):
    assert len(second_factors([module_of("uwserver.world.a", text)])) == 1


def conversions_inside(each: Iterable[Module]) -> list[str]:
    """Where degrees are converted within the house: neither where the tables of files are read, nor in the codec of a wire, nor in the `si` of
    logs, nor by who names what is in degrees (`heading_deg`)."""
    wrong = []
    for module in each:
        uses = {i.name or "all of it" for i in module.imports if i.target == UNITS} & {"rad", "deg", "all of it"}
        at_border = module.part in TABLES or module.name.rpartition(".")[2] in ("codec", "si")
        if uses and not at_border and not re.search(r"_deg(ps)?\b", module.text, re.I):
            wrong.append(f"{module.name} uses {', '.join(sorted(uses))}")
    return wrong


def test_degrees_are_converted_only_at_the_border():
    """A file, a wire, a log or a person has them; what is inside has radians."""
    assert conversions_inside(modules("uwserver")) == []
    users = {module.name for module in modules("uwserver_adapters") for i in module.imports if i.target == UNITS}
    assert {user for user in users if not user.endswith(".codec")} == set(), "adapters convert units in codec.py"


def test_nothing_that_moves_is_in_degrees():
    """Below the tables of files nobody has anything in degrees, so nobody who steps a body converts them each tick."""
    for module in modules("uwserver"):
        if module.part in ("world", "step", "physics", "simulation", "copies"):
            assert not re.search(r"_deg(ps)?\b", module.text, re.I), module.name


def test_a_conversion_inside_is_found():
    use = "from uwserver.units import NANOSECONDS, rad\nx = rad(90.0)"
    inside = [module_of("uwserver.world.a", use), module_of("uwserver.autopilot.a", "from uwserver import units")]
    assert len(conversions_inside(inside)) == 2
    named = module_of("uwserver.autopilot.a", f"{use}\ny = rad(item.heading_deg)")
    assert (
        conversions_inside([named, module_of("uwserver.adapter.a.codec", use), module_of("uwserver.sensors.a", use)])
        == []
    )
    assert conversions_inside([module_of("uwserver.world.a", "from uwserver.units import NANOSECONDS")]) == []


# -- the engine of others ---------------------------------------------------------------------------------------------------------------


def test_bullet_has_one_home():
    """It is an optional dependency, and holds the interpreter's lock."""
    found = {m.name for m in modules("uwserver") if importing(m, {"pybullet", "pybullet_data"})}
    assert found == {BULLET}
