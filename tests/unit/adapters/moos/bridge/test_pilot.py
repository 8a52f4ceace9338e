"""The autopilot within the adapter: by hand, and with the shipped hulls in the water."""

from __future__ import annotations

import asyncio
import math

import pytest
from uwserver_adapters.moos.bridge.bridge import Bridge
from uwserver_adapters.moos.bridge.pilot import Autopilot, DepthHold, DepthLoops, Loop, Pilot
from uwserver_adapters.moos.codec import Fix
from uwserver_adapters.moos.config import BridgeTable, NavTable, PidTable, Target

from uwserver.adapter import CannotServe
from uwserver.frames import Quat, quat_from_rpy
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors.truth import Truth
from uwserver.testing import FakeContext

LEVEL = (1.0, 0.0, 0.0, 0.0)
MISSION = PidTable(speed_factor=20.0, depth_control=False)


def heading(degrees: float, pitch_deg: float = 0.0) -> Quat:
    return quat_from_rpy(0.0, math.radians(pitch_deg), math.radians(degrees))


def fix(degrees: float = 0.0, speed: float = 1.0, depth: float = 0.0, pitch_deg: float = 0.0) -> Fix:
    return Fix(p_N=(0.0, 0.0, depth), q_NB=heading(degrees, pitch_deg), v_B=(speed, 0.0, 0.0))


def driving(table: PidTable = MISSION, **wanted: float) -> Autopilot:
    autopilot = Autopilot(table)
    autopilot.override(False)
    for name, value in {"DESIRED_HEADING": 0.0, "DESIRED_SPEED": 1.0, **wanted}.items():
        autopilot.hear(name, value, 0.0)
    return autopilot


# -- a loop by hand ---------------------------------------------------------------------------------------------------------------------


def test_a_loop_is_the_sum_of_its_three_parts():
    """Errors 1, 2, 4 at 0, 0.5, 1 s: the mean slope is 3/s, the integral 0.1 (2 + 4) / 2 = 0.3."""
    loop = Loop(2.0, 0.1, 0.5, 10.0, 100.0)
    assert [loop.output(error, t) for error, t in ((1.0, 0.0), (2.0, 0.5), (4.0, 1.0))] == pytest.approx(
        [2.0, 4.0 + 0.1 + 0.5 * 2.0, 8.0 + 0.3 + 0.5 * 3.0]
    )


def test_a_loops_integral_and_output_are_limited():
    loop = Loop(0.0, 1.0, 0.0, 0.5, 100.0)
    assert [loop.output(1.0, t) for t in (0.0, 10.0, 20.0)] == [0.0, 0.5, 0.5]
    assert Loop(10.0, 0.0, 0.0, 0.0, 3.0).output(-1.0, 0.0) == -3.0


def test_a_loop_asked_twice_at_one_time_says_the_same():
    loop = Loop(1.0, 1.0, 1.0, 10.0, 100.0)
    loop.output(1.0, 0.0)
    assert loop.output(2.0, 1.0) == loop.output(2.0, 1.0)


def test_the_slope_of_a_heading_knows_no_jump():
    """From 179 to -179 degrees of error it went on by 2."""
    loop = Loop(0.0, 0.0, 1.0, 0.0, 1e3, True)
    loop.output(179.0, 0.0)
    assert loop.output(-179.0, 1.0) == pytest.approx(2.0)


# -- the autopilot ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("now", "wanted", "rudder"), [(0, 20, 10), (350, 10, 10), (10, 350, -10), (0, 181, -89.5), (0, -90, -45)]
)
def test_it_turns_the_short_way_and_starboard_is_positive(now, wanted, rudder):
    said = driving(DESIRED_HEADING=wanted).outputs(fix(now), 0.0)
    assert said == pytest.approx({"DESIRED_THRUST": 20.0, "DESIRED_RUDDER": rudder})


def test_thrust_by_its_own_loop_is_added_up():
    autopilot = driving(PidTable(speed_pid_kp=2.0, depth_control=False), DESIRED_SPEED=2.0)
    assert [autopilot.outputs(fix(speed=1.0), t)["DESIRED_THRUST"] for t in (0.0, 0.1, 0.2)] == [2.0, 4.0, 6.0]


def test_without_thrust_nothing_moves():
    said = driving(DESIRED_SPEED=0.0, DESIRED_HEADING=90.0).outputs(fix(), 0.0)
    assert said == {"DESIRED_THRUST": 0.0, "DESIRED_RUDDER": 0.0}


def test_a_factor_may_come_from_the_mission():
    autopilot = driving()
    autopilot.hear("SPEED_FACTOR", 30.0, 0.0)
    assert autopilot.outputs(fix(), 0.0)["DESIRED_THRUST"] == 30.0
    for wrong in (-1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=r"finite|negative"):
            autopilot.hear("SPEED_FACTOR", wrong, 0.0)


def test_what_is_stale_stops_it_and_is_named():
    autopilot = driving()
    assert autopilot.outputs(fix(), 2.0)["DESIRED_THRUST"] == 20.0
    autopilot.hear("DESIRED_SPEED", 1.0, 2.0)
    assert autopilot.outputs(fix(), 2.1) == {"DESIRED_THRUST": 0.0, "DESIRED_RUDDER": 0.0}
    assert autopilot.stale == "DESIRED_HEADING"
    autopilot.hear("DESIRED_HEADING", 0.0, 2.1)
    assert autopilot.outputs(fix(), 2.2)["DESIRED_THRUST"] == 20.0


def test_a_person_drives_until_the_override_is_lifted_and_wishes_come_anew():
    autopilot = Autopilot(MISSION)
    autopilot.hear("DESIRED_HEADING", 0.0, 0.0)
    autopilot.hear("DESIRED_SPEED", 1.0, 0.0)
    assert autopilot.outputs(fix(), 0.0) == {}
    autopilot.override(False)
    assert autopilot.outputs(fix(), 0.0) == {}
    autopilot.hear("DESIRED_HEADING", 0.0, 0.0)
    assert autopilot.outputs(fix(), 0.0) == {}
    autopilot.hear("DESIRED_SPEED", 1.0, 0.0)
    assert autopilot.outputs(fix(), 0.0) != {}
    autopilot.override(True)
    assert autopilot.outputs(fix(), 0.0) == {}


def test_with_depth_it_waits_for_a_depth():
    table = PidTable(speed_factor=20.0)
    assert driving(table).outputs(fix(), 0.0) == {}
    assert set(driving(table, DESIRED_DEPTH=5.0).outputs(fix(), 0.0)) == {
        "DESIRED_THRUST",
        "DESIRED_RUDDER",
        "DESIRED_ELEVATOR",
    }


@pytest.mark.parametrize(
    ("depth", "pitch_deg", "elevator"), [(0.0, 0.0, 1), (10.0, 0.0, -1), (5.0, 5.0, 1), (5.0, -5.0, -1)]
)
def test_a_positive_elevator_goes_deeper(depth, pitch_deg, elevator):
    said = DepthLoops(PidTable()).elevator(5.0, depth, math.radians(pitch_deg), 0.0)
    assert math.copysign(1.0, said) == elevator
    assert abs(said) <= 13.0 + 1e-9


# -- a depth that is held ---------------------------------------------------------------------------------------------------------------


def test_a_depth_is_held_only_while_somebody_drives():
    """Else its commands would keep the rudder of the same fins from its watchdog."""
    hold = DepthHold(5.0, PidTable())
    assert hold.outputs(fix(), 0.0) == {}
    assert hold.hear("BUOYANCY_RATE", 0.1, 1.0)
    assert hold.outputs(fix(), 1.0) == {}
    assert hold.hear("DESIRED_THRUST_L", 50.0, 1.0)
    assert hold.outputs(fix(), 3.0)["DESIRED_ELEVATOR"] > 0.0
    assert hold.outputs(fix(), 3.1) == {}
    hold.hear("DESIRED_RUDDER", 0.0, 4.0)
    hold.rest()
    assert hold.outputs(fix(), 4.0) == {}


def test_a_mission_with_a_depth_is_left_to_it():
    hold = DepthHold(5.0, PidTable())
    hold.hear("DESIRED_THRUST", 50.0, 0.0)
    assert not hold.hear("DESIRED_ELEVATOR", 0.0, 0.0), "what a mission without depth says"
    assert hold.outputs(fix(), 0.1)
    assert hold.hear("DESIRED_ELEVATOR", -3.0, 0.2)
    assert hold.outputs(fix(), 0.3) == {}
    assert hold.hear("DESIRED_ELEVATOR", 0.0, 0.4)
    hold.reset()
    hold.hear("DESIRED_THRUST", 50.0, 0.5)
    assert hold.outputs(fix(), 0.6)


def test_an_autopilot_with_a_depth_needs_no_other():
    assert "hold" not in " ".join(Pilot(PidTable(), 5.0).report())
    assert Pilot(MISSION, 5.0).drives == ("DESIRED_THRUST", "DESIRED_RUDDER", "DESIRED_ELEVATOR")


# -- in a bridge ------------------------------------------------------------------------------------------------------------------------

LAUV = {  # as docs/how-to/moos.md has it
    "DESIRED_THRUST": (Target(port="propeller", field="speed_radps", full=395.0),),
    "DESIRED_RUDDER": (Target(port="fins", field="angle_rad", full_deg=(100.0, 0.0, 100.0, 0.0), limit=20.0),),
    "DESIRED_ELEVATOR": (Target(port="fins", field="angle_rad", full_deg=(0.0, 100.0, 0.0, 100.0), limit=20.0),),
}
REMUS = {
    "DESIRED_THRUST": (Target(port="propeller", field="speed_radps", full=312.0),),
    "DESIRED_RUDDER": (Target(port="rudder", field="angle_rad", full_deg=100.0),),
    "DESIRED_ELEVATOR": (Target(port="stern_planes", field="angle_rad", full_deg=100.0),),
}
HULLS = {"lauv": LAUV, "remus100": REMUS}


class Sea:
    """A hull in the water behind a bridge, without a server: what the bridge commands is applied with the next tick."""

    def __init__(self, hull: str, depth: float, **table: object) -> None:
        entry = VehicleEntry(model=hull, position_ned_m=(0.0, 0.0, depth), truth=Truth(rate_hz=20))
        self.world = build(load(Scenario(schema=1, vehicles={"auv": entry}), adapters={}))
        self.context = FakeContext(ports=dict(self.world.ports))
        self.said: dict[str, float | str] = {}
        table = {"publish": (), "nav": NavTable(), "commands": HULLS[hull], **table}
        self.bridge = Bridge(BridgeTable(**table), self.context, self.said.update, lambda _: None, "moos", self.seconds)

    def seconds(self) -> float:
        return self.world.t_ns / 1e9

    async def sail(self, seconds: int, **written: float) -> list[float]:
        """Write 20 times a second, as an autopilot does; returns the depths."""
        depths = []
        for _ in range(20 * seconds):
            self.bridge.take([(name, value, "helm", 10.0) for name, value in written.items()])
            await asyncio.sleep(0)  # answers
            for command in self.context.commands:
                fields = zip(self.world.ports[command.port].fields, command.value, strict=True)
                self.world.command(
                    command.port,
                    **{field.name: list(value) if field.shape else value[0] for field, value in fields},
                )
            self.context.commands.clear()
            self.bridge.put_samples(self.world.step(round(float(self.world.rate_hz) / 20)))  # one of the truth
            depths.append(float(self.said["NAV_DEPTH"]))
        return depths


@pytest.mark.parametrize(
    ("hull", "wanted"),
    [
        ("lauv", 0.0),
        ("remus100", 5.0),
        pytest.param("lauv", 5.0, marks=pytest.mark.slow),
        pytest.param("remus100", 0.0, marks=pytest.mark.slow),
    ],
)
async def test_a_hull_in_a_mission_without_depth_stays_where_it_shall(hull, wanted):
    """At 2 m/s, with turns."""
    sea = Sea(hull, wanted, hold_depth_m=wanted)
    straight = await sea.sail(40, DESIRED_THRUST=40.0, DESIRED_RUDDER=0.0, DESIRED_ELEVATOR=0.0)
    turning = await sea.sail(40, DESIRED_THRUST=40.0, DESIRED_RUDDER=8.0)
    assert max(abs(depth - wanted) for depth in straight + turning) < 1.0
    assert float(sea.said["NAV_SPEED"]) > 1.0


async def test_without_it_a_hull_leaves_its_depth():
    sea = Sea("remus100", 5.0)
    for _ in range(12):
        if max(abs(depth - 5.0) for depth in await sea.sail(10, DESIRED_THRUST=40.0, DESIRED_RUDDER=20.0)) > 1.0:
            return
    raise AssertionError("it stays in two minutes")


async def test_the_autopilot_within_the_adapter_drives_a_hull():
    """With the gains of s10_juliet, in degrees: heading, speed and depth are what a helm asks for."""
    sea = Sea("remus100", 5.0, pid=PidTable(speed_factor=20.0))
    sea.bridge.take([("MOOS_MANUAL_OVERRIDE", "false", "helm", 10.0)])
    depths = await sea.sail(90, DESIRED_HEADING=60.0, DESIRED_SPEED=1.5, DESIRED_DEPTH=8.0)
    assert abs(float(sea.said["NAV_HEADING"]) - 60.0) < 3.0
    assert abs(float(sea.said["NAV_SPEED"]) - 1.5) < 0.2
    assert max(abs(depth - 8.0) for depth in depths[-400:]) < 1.0
    assert sea.said["DESIRED_THRUST"] == 30.0
    sea.context.commands.clear()
    # Who else writes these is told that they are taken, and not obeyed.
    sea.bridge.take([("DESIRED_RUDDER", 20.0, "pMarinePIDV22", 10.0)])
    assert sea.context.commands == []
    assert "the autopilot of this adapter writes DESIRED_RUDDER" in str(sea.said["UWSERVER_ERROR"])


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ({"hold_depth_m": 5.0, "nav": None}, "give a `nav` table too"),
        (
            {"hold_depth_m": 5.0, "commands": {"DESIRED_THRUST": LAUV["DESIRED_THRUST"]}},
            "`commands` lacks DESIRED_ELEVATOR",
        ),
        ({"pid": MISSION, "commands": {}}, "`commands` lacks DESIRED_THRUST, DESIRED_RUDDER"),
    ],
)
def test_what_an_autopilot_needs_is_named(table, text):
    with pytest.raises(CannotServe, match=text):
        Sea("lauv", 5.0, **table)
