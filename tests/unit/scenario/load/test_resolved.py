"""What loading gives: when anything can touch anything."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from uwserver.physics.geometry.shapes import Placed, Solid, Sphere
from uwserver.scenario.load.resolved import Resolved, ResolvedObject, ResolvedVehicle
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.solids.objects import object_params
from uwserver.scenario.solids.tables import SphereObject
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import Environment

BALL = Solid("ball", (Placed(Sphere(0.5)),))
ENTRY = SphereObject(mass_kg=1.0, radius_m=0.5)


@pytest.fixture
def resolved(tiny, motor):
    """With so many static solids, objects, and vehicles with and without collision shapes."""

    def make(static: int = 0, objects: int = 0, solid: int = 0, ghosts: int = 0) -> Resolved:
        entry = VehicleEntry(model="x")
        shapes = [BALL] * solid + [None] * ghosts
        vehicles = {str(k): ResolvedVehicle(str(k), entry, tiny, {"left": motor}, s) for k, s in enumerate(shapes)}
        body = ResolvedObject("o", ENTRY, object_params(ENTRY, Environment()), BALL)
        things = {str(k): replace_name(body, str(k)) for k in range(objects)}
        return Resolved("x", Scenario(schema=1), vehicles, None, (), {str(k): BALL for k in range(static)}, things)

    return make


def replace_name(body: ResolvedObject, name: str) -> ResolvedObject:
    return ResolvedObject(name, body.entry, body.params, body.solid)


@pytest.mark.parametrize(
    ("things", "solid"),
    [
        ({}, False),
        ({"ghosts": 3}, False),
        ({"solid": 1, "ghosts": 3}, False),
        ({"objects": 1}, False),
        ({"solid": 2}, True),
        ({"solid": 1, "objects": 1}, True),
        ({"objects": 2}, True),
        ({"static": 1}, True),
        ({"static": 1, "ghosts": 1}, True),
    ],
)
def test_two_that_move_can_touch_and_one_only_what_stands(things: dict[str, int], solid: bool, resolved) -> None:
    assert resolved(**things).is_solid is solid


def test_what_is_not_given_is_empty() -> None:
    bare = Resolved("x", Scenario(schema=1), {}, None, ())
    assert (bare.static, bare.objects, bare.materials, bare.path) == ({}, {}, (), None)
    assert not bare.is_solid


def test_vehicles_of_one_file_share_it(write, files, adapters) -> None:
    """So that what is made of it is made once."""
    from uwserver.scenario.load.scenario import load

    text = files["tank"].replace("[adapters.tcp]", '[vehicles.two]\nmodel = "./tiny.toml"\n[adapters.tcp]')
    vehicles = load(write(text), adapters=adapters).vehicles
    assert list(vehicles) == ["rov", "two"]
    one, two = (vehicle.vehicle for vehicle in vehicles.values())
    assert one.rigid_body is two.rigid_body
    assert one.thrusters["left"] is two.thrusters["left"]
    assert vehicles["rov"].devices["left"] is vehicles["two"].devices["left"]
    assert replace(one) == two
