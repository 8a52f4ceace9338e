"""From a resolved scenario to a world at t = 0: time, water, Earth, solid things, bodies at their places, and faults;
and the compiled kernels that it needs."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from uwserver.adapter import installed_adapters
from uwserver.scenario.build.world import build, kernels_of
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.load.scenario import load
from uwserver.units import rad
from uwserver.world.world import World

Built = Callable[..., World]
ALL = ("sensors", "autopilots")
"""What any vehicle of these needs."""


@pytest.fixture
def built(write, files, adapters) -> Built:
    """The tank with other text in the place of its vehicle's, and more for the vehicle file."""

    def make(scenario: str = "", vehicle: str = "", entry: str = "") -> World:
        text = files["tank"].replace("[adapters", f"{entry}\n{scenario}\n[adapters")
        return build(load(write(text, files["tiny"] + vehicle), adapters=adapters))

    return make


def test_time_and_name(built: Built) -> None:
    world = built("[world]\nrate_hz = 120\nepoch_utc = '2027-01-01T00:00:00Z'\n")
    assert (world.name, world.tick, world.t_ns) == ("tank", 0, 0)
    assert world.rate_hz == 120
    assert world.hydro.dt == 1.0 / 120.0
    assert world.epoch_utc == "2027-01-01T00:00:00Z"
    world.step(3)
    assert world.t_ns == 25_000_000


def test_a_rate_of_decimals_is_exact(built: Built) -> None:
    world = built("[world]\nrate_hz = 33.3\n", entry="override.sensors.imu.enabled = false")
    world.step(333)
    assert world.t_ns == 10_000_000_000


# -- bodies -----------------------------------------------------------------------------------------------------------------------------


def test_a_vehicle_begins_where_the_table_says(built: Built) -> None:
    place = "position_ned_m = [1, 2, 3]\nattitude_rpy_deg = [0, 0, 90]\nvelocity_frd_mps = [0.5, 0, 0]\nangular_velocity_frd_degps = [0, 0, 10]\n"
    vehicle = built(entry=place).vehicles["rov"]
    assert vehicle.p_NB == (1.0, 2.0, 3.0)
    assert vehicle.q_NB == pytest.approx((math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))
    assert vehicle.nu == pytest.approx((0.5, 0.0, 0.0, 0.0, 0.0, rad(10.0)))


def test_one_that_is_not_present_is_only_what_can_be_spawned(built: Built) -> None:
    world = built(entry="present = false")
    assert world.vehicles == {}
    assert [a.choices for a in world.services["world/spawn"].arguments if a.name == "like"] == [("rov",)]
    world.call("world/spawn", name="new", like="rov", p_NB=[0.0, 0.0, 5.0])
    assert list(world.vehicles) == ["new"]


def test_vehicles_and_objects_are_bodies_in_the_order_of_the_file(built: Built) -> None:
    ball = '[objects.ball]\nkind = "sphere"\nradius_m = 0.2\nmass_kg = 30\nposition_ned_m = [5, 0, 5]\n'
    world = built(ball + '[vehicles.two]\nmodel = "./tiny.toml"\nposition_ned_m = [0, 5, 0]\n')
    assert [(v.name, v.row) for v in world.vehicles.values()] == [("rov", 0), ("two", 1), ("ball", 2)]


# -- surroundings -----------------------------------------------------------------------------------------------------------------------


def test_the_water_is_the_scenario_s(built: Built) -> None:
    world = built("[environment]\ndensity_kgpm3 = 1000\ncurrent.velocity_ned_mps = [0.3, 0, 0]\n")
    assert (world.water.density, world.water.current) == (1000.0, (0.3, 0.0, 0.0))
    assert world.hydro.sea is None
    for _ in range(20):
        world.step(60)
    assert world.vehicles["rov"].p_NB[0] > 0.1, "it drifts with the current"


def test_a_sea_moves_the_bodies(built: Built) -> None:
    layers = (
        '[environment.currents.l]\nkind = "profile"\ndepth_m = [0, 10]\nvelocity_ned_mps = [[0, 1, 0], [0, 1, 0]]\n'
    )
    world = built(layers)
    assert world.hydro.sea is not None
    world.step(480)
    assert world.vehicles["rov"].p_NB[1] > 0.1


def test_nothing_solid_needs_no_engine(built: Built) -> None:
    assert built().scene is None
    assert built(vehicle='[collision.hull]\nkind = "sphere"\nradius_m = 0.2\n').scene is None


def test_a_seabed_is_there_for_bodies_and_rays(built: Built) -> None:
    world = built('[seabed]\nkind = "flat"\ndepth_m = 12\nmaterial = "mud"\n', entry="position_ned_m = [0, 0, 2]")
    assert world.scene is not None
    assert world.geometry is world.scene
    assert world.hydro.collider is world.scene


# -- Earth ------------------------------------------------------------------------------------------------------------------------------

ORIGIN = "[world]\norigin_lat_deg = 63.43\norigin_lon_deg = 10.40\n"


def test_no_tick_makes_the_arrays_of_what_is_solid(built: Built, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are there when the world is."""
    world = built("[seabed]\nkind = 'flat'\ndepth_m = 40.0\n")
    assert world.scene is not None
    made: list[object] = []
    monkeypatch.setattr(type(world.scene._solids), "_rebuild", made.append)
    world.step(3)
    assert not made


def test_without_an_origin_the_clock_still_knows_the_time(built: Built) -> None:
    earth = built("[world]\nepoch_utc = '1970-01-01T00:00:01Z'\n").earth
    assert earth.epoch_ns == 10**9
    assert (earth.latitude, earth.longitude) == (0.0, 0.0)


def test_the_origin_is_in_radians(built: Built) -> None:
    earth = built(ORIGIN).earth
    assert (earth.latitude, earth.longitude) == pytest.approx((rad(63.43), rad(10.40)))
    assert earth.epoch_ns == 1_767_225_600 * 10**9


@pytest.mark.parametrize(
    ("sensor", "magnetic"),
    [
        ('kind = "magnetometer"', True),
        ('kind = "attitude"\nnorth = "magnetic"', True),
        ('kind = "attitude"', False),
        ('kind = "gps"', False),
    ],
)
def test_the_magnetic_field_is_worked_out_where_something_asks_for_it(
    sensor: str, magnetic: bool, built: Built
) -> None:
    earth = built(f"{ORIGIN}[vehicles.rov.sensors.s]\n{sensor}\nrate_hz = 10\n").earth
    assert any(earth.magnetic[0]) is magnetic
    if magnetic:
        assert 4e-5 < math.hypot(*earth.magnetic[0]) < 6e-5


# -- faults and services ----------------------------------------------------------------------------------------------------------------


def test_faults_of_the_scenario_begin_with_it(built: Built) -> None:
    fault = '[faults.f]\nkind = "thruster_weak"\ntarget = "rov/thrusters"\nfactor = 0.5\n'
    world = built(fault + '[faults.later]\nkind = "thruster_dead"\ntarget = "rov/thrusters"\nat_s = 0.5\n')
    assert [(f["name"], f["state"]) for f in world.call("world/faults")] == [("f", "active"), ("later", "waiting")]  # type: ignore[union-attr, index, call-overload]
    world.step(121)
    assert [f["state"] for f in world.call("world/faults")] == ["active", "active"]  # type: ignore[union-attr, index, call-overload]


def test_a_reset_comes_back_to_the_start_of_the_scenario(built: Built) -> None:
    world = built(entry="position_ned_m = [0, 0, 2]\nvelocity_frd_mps = [1, 0, 0]")
    start = world.call("world/state_hash")
    first = world.step(50)
    assert world.call("world/state_hash") != start
    world.call("world/reset")
    assert world.call("world/state_hash") == start
    assert world.step(50) == first


def test_a_scenario_without_bodies_is_a_world_too(write, adapters) -> None:
    world = build(load(write("schema = 1\n"), adapters=adapters))
    assert world.step(10) == []
    assert world.ports == {}
    assert "world/spawn" not in world.services


@pytest.mark.parametrize(
    ("scenario", "sea", "needs"),
    [
        ("bluerov2_open_sea", False, {"fins", *ALL}),
        ("bluerov2_open_sea", True, {"fins", "sea", *ALL}),
        (
            "one_of_everything",
            True,
            {
                "fins",
                "sea",
                "solids",
                "contact",
                "fins in contact",
                "echoes",
                "pictures",
                "soundings",
                "sonars",
                "sound",
                "cameras",
                *ALL,
            },
        ),
        ("push_the_crate", False, {"fins", "solids", "contact", "fins in contact", *ALL}),
    ],
)
def test_what_shipped_scenarios_need(scenario: str, sea: bool, needs: set[str]) -> None:
    assert kernels_of(load(scenario, adapters=installed_adapters()), sea) == needs


@pytest.mark.parametrize("kind", ["adcp", "altimeter", "dvl", "range_array"])
def test_each_kind_that_casts_rays_in_compiled_code_needs_those_of_soundings(kind: str) -> None:
    """Else its loops would be compiled where the world waits for them."""
    scenario = ScenarioBuilder("rays").vehicle("rov", "bluerov2_heavy").sensor("rov", "own", kind, rate_hz=1).build()
    assert kernels_of(load(scenario, adapters={}), False) == {"fins", "soundings", *ALL}
