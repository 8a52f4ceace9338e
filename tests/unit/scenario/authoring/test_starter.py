"""The files that `uwserver new` writes: they load and run as they are, whatever their names."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from uwserver.scenario.authoring.hull import MeshHull
from uwserver.scenario.authoring.starter import starter, vehicle_starter
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def test_it_loads_without_a_warning_and_runs(tmp_path: Path, adapters) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(starter("mine", "bluerov2_heavy"), encoding="utf-8")
    resolved = load(path, adapters=adapters)
    assert resolved.warnings == ()
    world = build(resolved)
    samples = world.step(24)
    assert {"rov/mocap", "rov/truth/pose"} <= {sample.port for sample in samples} | set(world.ports)
    assert any(sample.port == "rov/mocap" for sample in samples)


@pytest.mark.parametrize("name", ["mine", "my tank", 'say "hi"', "back\\slash", "ünïcode", "{vehicle}", "100%"])
def test_the_name_is_the_title(name: str) -> None:
    assert tomllib.loads(starter(name, "bluerov2_heavy"))["title"] == name


@pytest.mark.parametrize("vehicle", ["bluerov2", "./mine.toml", "C:\\rov.toml", "sub folder/mine ü.toml"])
def test_the_vehicle_is_any_name_or_path(vehicle: str) -> None:
    raw = tomllib.loads(starter("mine", vehicle))
    assert raw["vehicles"]["rov"]["model"] == vehicle


def test_it_names_itself_in_the_commands_that_it_tells() -> None:
    text = starter("pool_3", "bluerov2")
    assert "#   uwserver check pool_3.toml " in text
    assert "#   uwserver run pool_3.toml " in text


def test_what_is_commented_out_is_right_too(tmp_path: Path, adapters) -> None:
    text = starter("mine", "bluerov2_heavy")
    text = text.replace("# [vehicles.rov.override.rigid_body]\n# mass", "[vehicles.rov.override.rigid_body]\nmass")
    (tmp_path / "mine.toml").write_text(text)
    vehicle = load(tmp_path / "mine.toml", adapters=adapters).vehicles["rov"].vehicle
    assert vehicle.rigid_body.mass_kg == 14.0


def test_lines_are_short_enough_to_read() -> None:
    assert max(map(len, starter("mine", "bluerov2").splitlines())) <= 120


BASE = """\
schema = 1
name = "old"
description = "another's"

# About the whole file.

# About its mass.
[rigid_body]
source = "a [bracket]"
mass_kg = 1.0

[damping.linear]
diagonal = [
  1.0,
]

# front
[thrusters.t1]
device = "t200"

# a figure
[[published]]
value = 1.5

# guess: the last
[sensors.imu]
kind = "imu"
"""
HULL = MeshHull(
    volume=0.02,
    size=(0.5, 0.3, 0.2),
    center_of_buoyancy=(0.0, 0.0, -0.02),
    box_center=(0.0, 0.0, -0.02),
    cad_origin=(1e-17, -0.1, 2.0),
    second_moments=np.diag([4e-4, 1e-4, 7e-5]),
    added_mass=np.array([10.0, 20.0, 30.0, 0.1, 0.2, 0.3]),
    quadratic=np.arange(1.0, 7.0),
    linear=np.arange(1.0, 7.0),
    lift=np.zeros(6),
)


def test_a_copy_keeps_tables_and_their_comments_but_the_figures_of_the_other() -> None:
    text = vehicle_starter("new", "old", BASE)
    assert tomllib.loads(text)["rigid_body"] == {"source": "a [bracket]", "mass_kg": 1.0}
    assert "# About its mass.\n[rigid_body]" in text
    assert "# guess: the last\n[sensors.imu]" in text
    assert "published" not in text
    assert "a figure" not in text


def test_a_hull_takes_the_place_of_the_other_s() -> None:
    text = vehicle_starter("new", "old", BASE, HULL, 'the "hull".stl', 20.0, "scale = 0.001\n")
    tables = tomllib.loads(text)
    assert "About its mass" not in text
    assert "# front\n[thrusters.t1]" in text
    assert tables["rigid_body"]["mass_kg"] == 20.0
    assert tables["collision"]["hull"] == {
        "kind": "hull", "file": 'the "hull".stl', "scale": 0.001, "center_frd_m": [0.0, -0.1, 2.0],
    }  # fmt: skip
    assert tables["damping"]["linear"]["diagonal"] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


def test_the_terms_that_are_taken_out_of_the_munk_moment_do_no_work() -> None:
    """Power of the terms at any velocity: nu^T tau = 0."""
    terms = tomllib.loads(vehicle_starter("new", "old", BASE, HULL, "hull.stl"))["hull"]["derivatives"]["terms"]
    axes = {**dict(zip("XYZKMN", range(6), strict=True)), **dict(zip("uvwpqr", range(6), strict=True))}
    for nu in np.random.default_rng(1).normal(size=(5, 6)):
        power = sum(value * nu[axes[key[1]]] * nu[axes[key[2]]] * nu[axes[key[0]]] for key, value in terms.items())
        assert abs(power) < 1e-12
    assert terms["Xwq"] == 27.0
