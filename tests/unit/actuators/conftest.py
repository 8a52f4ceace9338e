"""Two vehicles in one world's arrays, so that an actuator that writes a wrong row is seen."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from scenario_rig import read_once

from uwserver.actuators import Body
from uwserver.physics.bodies import Hydrodynamics
from uwserver.scenario.build.world import build
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors.truth import Truth
from uwserver.world import World

MakeWorld = Callable[..., World]


@pytest.fixture
def make_world() -> MakeWorld:
    """`make_world(tow={"kind": "force_torque"})`: vehicles `first` and `rov`, both with these actuators beside their `thrusters`."""

    def make(**actuators: dict[str, object]) -> World:
        entries = {
            name: VehicleEntry(
                model="bluerov2_heavy",
                position_ned_m=(x, 0.0, 20.0),
                truth=Truth(rate_hz=240),
                override={"actuators": actuators},
            )
            for name, x in (("first", -9.0), ("rov", 0.0))
        }
        return build(read_once(Scenario(schema=1, vehicles=entries)))

    return make


@pytest.fixture
def hydro(make_world: MakeWorld) -> Hydrodynamics:
    return make_world().hydro


@pytest.fixture
def body(hydro: Hydrodynamics) -> Body:
    """The second vehicle, with the names a to h for its thrusters."""
    return Body(hydro, 1, {name: 8 + k for k, name in enumerate("abcdefgh")}, 1)
