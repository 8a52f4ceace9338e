"""The numbers of a vehicle, and the outline of its shapes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from manoeuvre_rig import GUESS, ROV, TORPEDO, vehicle, written

from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, HalfSpace, Placed, Shape, Solid, Sphere
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.world.tables import Environment
from uwserver.validation.manoeuvres.helm import Helm
from uwserver.validation.manoeuvres.particulars import Particular, guesses, outline, particulars
from uwserver.validation.manoeuvres.report import resolve


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        (Box((0.5, 0.2, 0.1)), (1.0, 0.4, 0.2)),
        (Sphere(0.3), (0.6, 0.6, 0.6)),
        (Cylinder(0.2, 0.5), (1.0, 0.4, 0.4)),
        (Capsule(0.2, 0.5), (1.4, 0.4, 0.4)),
        (ConvexHull(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])), (1.0, 1.0, 1.0)),
    ],
)  # fmt: skip
def test_the_size_of_each_shape(shape: Shape, size: tuple[float, float, float]) -> None:
    (points,) = outline(Solid("one", (Placed(shape),)))
    assert np.ptp(points, axis=0) == pytest.approx(size, rel=1e-6)


def test_a_shape_is_where_it_is_put() -> None:
    placed = Placed(Cylinder(0.2, 0.5), (1.0, 2.0, 3.0), quat_from_rpy(0.0, 0.0, math.pi / 2.0))
    (points,) = outline(Solid("one", (placed,)))
    assert points.mean(axis=0) == pytest.approx((1.0, 2.0, 3.0))
    assert np.ptp(points, axis=0) == pytest.approx((0.4, 1.0, 0.4), rel=1e-6)


def test_no_vehicle_is_a_seabed() -> None:
    with pytest.raises(TypeError, match="HalfSpace"):
        outline(Solid("one", (Placed(HalfSpace()),)))


def found(folder: Path, raw: dict[str, object]) -> dict[str, Particular]:
    environment = Environment()
    resolved = resolve(str(written(folder, raw)), environment)
    body = body_params(resolved.vehicle, resolved.devices, environment)
    return {one.name: one for one in particulars(resolved, body, Helm(resolved.vehicle, body))}


def test_numbers_of_a_rov(tmp_path: Path) -> None:
    numbers = found(tmp_path, ROV)
    assert numbers["mass"] == Particular("mass", "kg", (102.5,), "guess")
    assert numbers["weight in the water"].values == pytest.approx((0.0,), abs=1e-9)
    assert numbers["length, width, height of its collision shapes"].values == pytest.approx((1.0, 0.5, 0.2))
    assert numbers["righting arm"].values == pytest.approx((0.05,))
    assert numbers["added mass, diagonal"].values == pytest.approx((50.0, 50.0, 50.0, 5.0, 5.0, 5.0))
    assert numbers["thrust ahead"].values == pytest.approx((4.0 * 50.0 * math.sqrt(0.5),), rel=1e-6)
    assert numbers["thrust down"].values == pytest.approx((100.0,), rel=1e-6)
    assert numbers["moment of thrust"].unit == "N m"


def test_a_torpedo_has_thrust_along_its_axis_alone(tmp_path: Path) -> None:
    numbers = found(tmp_path, TORPEDO)
    thrust = 1025.0 * 0.2**4 * (100.0 / (2.0 * math.pi)) ** 2 * 0.4
    assert numbers["thrust ahead"].values == pytest.approx((thrust,), rel=1e-6)
    assert not {"thrust down", "thrust up", "thrust to starboard", "moment of thrust"} & numbers.keys()


def test_statuses_of_several_tables_are_all_told(tmp_path: Path) -> None:
    raw = vehicle()
    raw["rigid_body"] = {**raw["rigid_body"], "status": "paper"}  # type: ignore[dict-item]
    assert found(tmp_path, raw)["righting arm"].status == "paper, guess"


def test_a_vessel_of_the_surface_has_no_righting_arm_under_water(tmp_path: Path) -> None:
    raw = vehicle()
    raw["rigid_body"] = {**raw["rigid_body"], "mass_kg": 51.25}  # type: ignore[dict-item]
    assert "righting arm" not in found(tmp_path, raw)


def test_guesses_are_counted_without_what_is_published(tmp_path: Path) -> None:
    raw = vehicle(published=[{**GUESS, "quantity": "ahead_speed_mps", "value": 1.0}])
    raw["rigid_body"] = {**raw["rigid_body"], "status": "paper"}  # type: ignore[dict-item]
    assert guesses(resolve(str(written(tmp_path, raw)), Environment())) == (4, 5)
