"""From a vehicle's tables to its built-in autopilot: how often it steps, what it hears, what it holds, and its ports."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import msgspec
import pytest
from msgspec import UNSET
from msgspec.structs import replace

from uwserver.autopilot.config import AutopilotConfig, Gains
from uwserver.autopilot.vehicle_spec import FIELDS
from uwserver.scenario.build.autopilot import divisor_of, gains_of
from uwserver.scenario.build.world import build
from uwserver.scenario.files.convert import kinds_of
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.tables import Autopilot
from uwserver.sensors import SensorConfig
from uwserver.world.world import World

Built = Callable[..., World]


@pytest.fixture
def built() -> Built:
    """A shipped vehicle with an autopilot."""

    def make(model: str = "bluerov2_heavy", override: dict[str, Any] | None = None, **keys: Any) -> World:
        config = msgspec.convert(keys, AutopilotConfig)
        entry = VehicleEntry(model=model, position_ned_m=(0.0, 0.0, 5.0), autopilot=config, override=override or {})
        return build(load(Scenario(schema=1, vehicles={"rov": entry}), adapters={}))

    return make


def test_the_estimator_listens_to_messages_of_shipped_kinds_only() -> None:
    assert set(FIELDS) <= {kind.message for kind in kinds_of(SensorConfig).values()}


# -- steps ------------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("physics", "wanted", "most", "ticks"),
    [
        (Fraction(240), UNSET, 60, 4),
        (Fraction(240), UNSET, 10, 24),
        (Fraction(200), UNSET, 60, 4),
        (Fraction(50), UNSET, 60, 1),
        (Fraction(10), UNSET, 60, 1),
        (Fraction(333, 10), UNSET, 10, 4),
        (Fraction(240), 240.0, 60, 1),
        (Fraction(240), 0.5, 60, 480),
        (Fraction(333, 10), 11.1, 60, 3),
    ],
)
def test_a_step_is_the_fewest_ticks_that_keep_the_rate(physics: Fraction, wanted: Any, most: int, ticks: int) -> None:
    assert divisor_of(physics, wanted, most) == ticks
    if wanted is UNSET:
        assert physics / ticks <= most
        assert ticks == 1 or physics / (ticks - 1) > most


# -- gains ------------------------------------------------------------------------------------------------------------------------------


def test_gains_of_the_scenario_stand_before_those_of_the_file(tiny) -> None:
    own = Autopilot(source="x", status="guess", gains=Gains(rate_p=2.0, rate_i=0.7))
    file = replace(tiny, autopilot=own)
    gains = gains_of(file, AutopilotConfig(gains={"rate_p": 3.0}))
    assert (gains.rate_p, gains.rate_i) == (3.0, 0.7)
    assert gains_of(file, AutopilotConfig()) == own.gains


def test_without_a_table_in_the_file_the_defaults_hold(tiny) -> None:
    assert tiny.autopilot is UNSET
    assert gains_of(tiny, AutopilotConfig()) == Gains()


@pytest.mark.parametrize("gains", [{"rate_p": -1.0}, {"rate_p": 1e9}])
def test_gains_out_of_their_limits_are_refused(gains: dict[str, float], tiny) -> None:
    with pytest.raises(msgspec.ValidationError):
        gains_of(tiny, AutopilotConfig(gains=gains))


# -- ports ------------------------------------------------------------------------------------------------------------------------------


def test_a_vehicle_without_one_has_none_of_its_ports() -> None:
    scenario = Scenario(schema=1, vehicles={"rov": VehicleEntry(model="bluerov2_heavy")})
    world = build(load(scenario, adapters={}))
    assert not [path for path in [*world.ports, *world.services] if "autopilot" in path]


def test_ports_and_services_of_one(built: Built) -> None:
    world = built()
    state = world.ports["rov/autopilot/state"]
    assert (state.direction, state.kind, state.rate_hz) == ("sensor", "autopilot", 10.0)
    points = {path.rsplit("/", 1)[1]: port for path, port in world.ports.items() if path.startswith("rov/autopilot/")}
    assert {"pilot", "velocity", "attitude", "test"} <= set(points)
    assert points["pilot"].timeout_s == points["velocity"].timeout_s == 1.0
    assert [path for path in world.services if path.startswith("rov/autopilot/")]


def test_time_outs_and_rates_of_the_table(built: Built) -> None:
    world = built(pilot_timeout_s=0, setpoint_timeout_s=2.5, state_rate_hz=60, rate_hz=120)
    ports = world.ports
    assert ports["rov/autopilot/pilot"].timeout_s is None
    assert ports["rov/autopilot/velocity"].timeout_s == ports["rov/autopilot/attitude"].timeout_s == 2.5
    assert ports["rov/autopilot/state"].rate_hz == 60.0


def test_the_state_comes_at_its_rate(built: Built) -> None:
    samples = [s for s in built(state_rate_hz=20).step(120) if s.port == "rov/autopilot/state"]
    assert [s.t_ns for s in samples] == [k * 50_000_000 for k in range(1, 11)]


# -- what it holds ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("armed", [False, True])
def test_armed_it_keeps_others_from_its_actuators(armed: bool, built: Built) -> None:
    refusal = built(armed=armed).actuators["rov/thrusters"].refusal
    assert bool(refusal) is armed
    assert not armed or refusal.endswith("call rov/autopilot/disarm first, or steer by rov/autopilot/pilot")


def test_single_thrusters_beside_the_vector_are_kept_too(built: Built) -> None:
    override = {"actuators": {"one": {"kind": "thruster", "member": "t1"}}}
    world = built(override=override, armed=True)
    assert world.actuators["rov/one"].refusal == world.actuators["rov/thrusters"].refusal != ""


def test_set_points_that_the_mode_does_not_follow_say_which_does(built: Built) -> None:
    world = built(mode="depth_hold")
    assert world.actuators["rov/autopilot/depth"].refusal == ""
    assert "set_mode with position_hold or guided first" in world.actuators["rov/autopilot/position"].refusal


@pytest.mark.parametrize(
    "model",
    [
        "bluerov2",
        "bluerov2_heavy",
        "remus100",
        "lauv",
        "rexrov",
        "minerva",
        "lbv150",
        "videoray_pro4",
        "girona500",
        "eca_a9",
        "otter",
    ],
)
def test_shipped_vehicles_are_steered(model: str, built: Built) -> None:
    world = built(model, armed=True)
    world.step(24)
    assert world.read("rov/autopilot/state") is not None


@pytest.mark.parametrize(("axis", "sign"), [(0, 1.0), (0, -1.0), (1, 1.0), (2, 1.0), (5, 1.0), (5, -1.0)])
def test_manual_sticks_move_the_vehicle_where_they_point(axis: int, sign: float, built: Built) -> None:
    """Surge, sway, heave or yaw alone, whatever order and axes its thrusters have."""
    still, moved = built(armed=True), built(armed=True)
    sticks = [0.0] * 6
    sticks[axis] = 0.5 * sign
    for _ in range(30):
        moved.command("rov/autopilot/pilot", u=sticks)
        moved.step(4)
        still.step(4)
    gained = [a - b for a, b in zip(moved.vehicles["rov"].nu, still.vehicles["rov"].nu, strict=True)]
    assert gained[axis] * sign > 0.02
    assert all(abs(gained[k]) < abs(gained[axis]) for k in (0, 1, 2, 5) if k != axis)


def test_a_vehicle_with_a_wrench_alone_is_steered_by_it(built: Built) -> None:
    entry = VehicleEntry(model="bluerov2_heavy")
    own = load(Scenario(schema=1, vehicles={"rov": entry}), adapters={}).vehicles["rov"].vehicle.actuators
    taken_out = {name: {"enabled": False} for name in own}
    world = built(override={"actuators": {**taken_out, "push": {"kind": "force_torque"}}}, armed=True)
    for _ in range(10):
        world.command("rov/autopilot/pilot", u=[0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
        world.step(4)
    assert world.hydro.wrenches["bias"][0][0] > 1.0
    assert world.vehicles["rov"].nu[0] > 0.01
