"""Numbers of a vehicle with their status, its thrust held fast, and the share of guesses."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from manoeuvre_rig import GUESS, ROV, TORPEDO, vehicle, written

from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.world.tables import Environment
from uwserver.validation.manoeuvres.helm import Helm
from uwserver.validation.manoeuvres.particulars import Particular, guesses, particulars
from uwserver.validation.manoeuvres.report import resolve


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
