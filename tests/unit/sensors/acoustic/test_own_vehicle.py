"""Echo sounders of every kind on a vehicle whose shapes stand all around them: they look through it, unless they are told to see it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwserver.ports import Buffer
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.units import NANOSECONDS

DEPTH, BOTTOM = 3.0, 9.0
TANK = f"""schema = 1
[world]
rate_hz = 240
[seabed]
kind = "flat"
depth_m = {BOTTOM}
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, {DEPTH}]
"""
SONAR = """[vehicles.rov.sensors.{kind}]
kind = "{kind}"
rate_hz = 4
ideal = true
{more}
"""
BESIDE = "position_frd_m = [0.0, 0.0, -0.3]\n"
"""Above all shapes of a BlueROV2."""
PINGING = {
    "multibeam": "range_m = 12\nbeams = 24\nbins = 120\nfield_deg = 60\nbeam_width_horizontal_deg = 3\nrays_vertical = 48\nrpy_deg = [0, -90, 0]",
    "side_scan": "range_m = 12\nbins = 120\nrays_vertical = 96\nmin_range_m = 0.5",
    "bathymetry": "range_m = 12\nbins = 240\nbeams = 24\nfield_deg = 60\nbeam_width_across_deg = 3\nmin_range_m = 0.1",
    "profiler": "range_m = 12\nbins = 240\nrpy_deg = [0, -90, 0]\nmin_range_m = 0.1",
    "scanning_sonar": "range_m = 12\nbins = 240\nrpy_deg = [0, -90, 0]\nsector_width_deg = 2",
}
BEAMS = {"altimeter": "max_range_m = 30", "dvl": "", "adcp": "cells = 4\ncell_size_m = 1"}


def told(folder: Path, kind: str, more: str) -> dict[str, Any]:
    """The first reading of a sonar of a kind, by the names of its fields."""
    path = folder / "tank.toml"
    path.write_text(TANK + SONAR.format(kind=kind, more=more), encoding="utf-8")
    world = build(load(path, adapters={}))
    name = f"rov/{kind}"
    fields = [field.name for field in world.ports[name].fields]
    while world.t_ns < 3 * NANOSECONDS:
        for sample in world.step():
            if sample.port == name:
                values = [value.array() if isinstance(value, Buffer) else value for value in sample.value]
                return dict(zip(fields, values, strict=True))
    raise AssertionError("it told nothing")


def nearest(kind: str, value: dict[str, Any]) -> float:
    """The nearest echo of a reading, m."""
    if kind == "profiler":
        return float(value["range"])
    if kind == "bathymetry":
        return float(np.nanmin(value["range"]))
    rows = {
        "multibeam": lambda: value["image"].max(axis=1),
        "side_scan": lambda: value["port"],
        "scanning_sonar": lambda: np.array(value["bins"]),
    }[kind]()
    return float(np.flatnonzero(rows > 0)[0] / len(rows) * value["range"])


@pytest.mark.parametrize("kind", PINGING)
@pytest.mark.parametrize("mount", ["", BESIDE], ids=["amid its shapes", "above them"])
def test_a_sonar_looks_through_its_vehicle(tmp_path: Path, kind: str, mount: str) -> None:
    """The nearest that it hears is the bottom, 6 m below it (9 m along the slanted side-scan at most), less its beam and a little sinking; or
    the surface above it for one that looks up there too."""
    value = told(tmp_path, kind, PINGING[kind] + "\n" + mount)
    above = DEPTH - (0.3 if mount else 0.0)
    least = {"side_scan": above, "multibeam": above, "scanning_sonar": above}.get(kind, BOTTOM - DEPTH)
    assert nearest(kind, value) >= least - 0.3


@pytest.mark.parametrize("kind", PINGING)
def test_one_that_shall_see_it_does(tmp_path: Path, kind: str) -> None:
    value = told(tmp_path, kind, PINGING[kind] + "\nsees_own_vehicle = true\n" + BESIDE)
    assert nearest(kind, value) < 0.7


@pytest.mark.parametrize("mount", ["", BESIDE], ids=["amid its shapes", "above them"])
def test_beams_go_past_their_vehicle(tmp_path: Path, mount: str) -> None:
    """Altimeter, velocity log and current profiler measure the bottom, wherever they sit."""
    height = BOTTOM - DEPTH + (0.3 if mount else 0.0)
    assert told(tmp_path, "altimeter", BEAMS["altimeter"] + "\n" + mount)["range"] == pytest.approx(height, abs=0.05)
    assert told(tmp_path, "dvl", BEAMS["dvl"] + "\n" + mount)["altitude"] == pytest.approx(height, abs=0.05)
    assert told(tmp_path, "adcp", BEAMS["adcp"] + "\n" + mount)["altitude"] == pytest.approx(height, abs=0.05)
