"""Lamps and camera mount follow the payload: commanded when it changes, within their limits, and only where the vehicle has them."""

from __future__ import annotations

import math

import pytest
from uwserver_adapters.mavlink.vehicle.outputs import Payload

from uwserver.ports import Field, Port
from uwserver.testing import FakeContext


def context(*ports: Port) -> FakeContext:
    return FakeContext(ports={port.path: port for port in ports})


LAMPS = Port("rov/lights", "actuator", "lamps", (Field("levels", "1", "x", shape=(2,), minimum=0.0, maximum=1.0),), "x")
TILT = Port("rov/tilt", "actuator", "camera_mount", (Field("tilt", "rad", "x", minimum=-0.5, maximum=0.6),), "x")
OTHER = Port("rov2/lights", "actuator", "lamps", LAMPS.fields, "x")


def test_they_are_commanded_when_something_changes_and_not_before() -> None:
    world = context(LAMPS, TILT, OTHER)
    payload = Payload(world, "rov")
    payload.tick()
    assert world.commands == []
    payload.lights[1] = 0.5
    payload.point(20.0, 0.0)
    payload.tick()
    payload.tick()
    assert [(c.port, c.value) for c in world.commands] == [
        ("rov/lights", ((0.5, 0.5),)),
        ("rov/tilt", ((pytest.approx(math.radians(20.0)),),)),
    ]
    payload.point(-45.0, 0.0)  # farther than it goes
    payload.tick()
    assert world.commands[-1].value == ((-0.5,),)


def test_a_vehicle_without_any_is_left_alone() -> None:
    world = context(OTHER)
    payload = Payload(world, "rov")
    payload.lights[0] = 1.0
    payload.point(10.0, 0.0)
    payload.tick()
    assert world.commands == []
    assert world.stats.errors == 0
