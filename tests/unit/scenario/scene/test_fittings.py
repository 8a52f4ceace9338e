"""Actuators, as viewers get them."""

from __future__ import annotations

import pytest

from uwserver.adapter import installed_adapters
from uwserver.ports import ActuatorView
from uwserver.scenario.load.scenario import load
from uwserver.scenario.scene.fittings import actuator_views
from uwserver.scenario.vehicle.body import body_params
from uwserver.units import rad


def of(scenario: str, name: str) -> dict[str, ActuatorView]:
    resolved = load(scenario, adapters=installed_adapters())
    vehicle = resolved.vehicles[name]
    params = body_params(vehicle.vehicle, vehicle.devices, resolved.scenario.environment)
    return {view.name: view for view in actuator_views("it", vehicle, params)}


def test_thrusters_have_place_axis_disc_and_their_element_of_the_command() -> None:
    vehicle = load("bluerov2_pool", adapters=installed_adapters()).vehicles["bluerov2"]
    views = of("bluerov2_pool", "bluerov2")
    for k, (name, table) in enumerate(vehicle.vehicle.thrusters.items()):
        view = views[name]
        assert (view.kind, view.p, view.port, view.index) == ("thruster", table.position_frd_m, "it/thrusters", k)
        assert view.axis is not None
        assert sum(c * c for c in view.axis) == pytest.approx(1.0)
        assert view.diameter == vehicle.devices[name].propeller.diameter_m
        assert view.low < 0.0 < view.high
        assert view.unit == "N"


def test_fins_and_propellers_have_their_limits() -> None:
    vehicle = load("remus_survey", adapters=installed_adapters()).vehicles
    name, resolved = next(iter(vehicle.items()))
    views = of("remus_survey", name)
    fins = [view for view in views.values() if view.kind == "fin"]
    assert len(fins) == len(resolved.vehicle.fins) > 0
    for view in fins:
        limit = rad(resolved.vehicle.fins[view.name].limit_deg)
        assert (view.low, view.high, view.unit) == (-limit, limit, "rad")
        assert view.chord is not None
        assert view.span is not None
        assert view.span > 0.0
    (screw,) = (view for view in views.values() if view.kind == "propeller")
    assert (screw.unit, screw.low) == ("rad/s", -screw.high)
