from __future__ import annotations

import sys

import numpy as np

from uwserver.scenario.authoring.hull import MeshHull
from uwserver.scenario.authoring.vehicle_starter import vehicle_starter

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

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
