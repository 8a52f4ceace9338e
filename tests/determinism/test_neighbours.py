"""What is far away changes nothing, not in the last bit: neither ranges nor contacts."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import pytest
import uwserver_scenarios
from traces import Trace, difference

import uwserver

TICKS = 240
FAR = """
[structures.far_{n}]
kind = "{kind}"
{size}
position_ned_m = {place}
attitude_rpy_deg = [10.0, 20.0, {n}.0]
"""
NEIGHBOURS = {
    "kilometres away": [("box", "size_m = [30.0, 7.0, 11.0]", [3217.3, -2111.7, 33.1])],
    "small and large": [
        ("cylinder", "radius_m = 0.3\nlength_m = 5000.0", [0.0, 9000.0, 900.0]),
        ("box", "size_m = [0.1, 0.1, 0.1]", [-400.3, 390.1, 30.7]),
    ],
}


def run(scenario: str, more: str, folder: Path) -> Trace:
    text = (Path(uwserver_scenarios.__file__).parent / f"{scenario}.toml").read_text()
    path = folder / f"{scenario}.toml"
    path.write_text(text.replace("[vehicles.", more + "\n[vehicles.", 1))
    world, trace = uwserver.load(path).core, Trace()
    for port in world.ports.values():
        if port.kind == "thrusters":
            world.command(port.path, u=[-0.4, -0.4, 0.4, 0.4, 0.9, 0.9, 0.9, 0.9][: port.fields[0].size])
    for step in range(TICKS):
        trace.take(world.step())
        trace.stand(step + 1, TICKS, world)
    return trace.end()


@cache
def alone(scenario: str) -> Trace:
    with tempfile.TemporaryDirectory() as folder:
        return run(scenario, "", Path(folder))


@pytest.mark.parametrize("neighbours", NEIGHBOURS)
@pytest.mark.parametrize("scenario", ["one_of_everything", "pool_inspection"])
def test_something_far_away_changes_nothing(scenario: str, neighbours: str, tmp_path: Path) -> None:
    more = "".join(
        FAR.format(n=n, kind=kind, size=size, place=place)
        for n, (kind, size, place) in enumerate(NEIGHBOURS[neighbours])
    )
    assert not difference(alone(scenario), run(scenario, more, tmp_path))
