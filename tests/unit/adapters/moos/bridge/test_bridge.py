"""What the world's samples become, and what variables do to the world; no socket."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from uwserver_adapters.moos.bridge import bridge as module
from uwserver_adapters.moos.bridge.bridge import Bridge
from uwserver_adapters.moos.config import BridgeTable, NavTable, Target

from uwserver.adapter import CannotServe
from uwserver.ports import Event, Fault, Field, Port, Reply, Sample
from uwserver.testing import FakeContext
from uwserver.testing.fake_context import IMU

POSE, VELOCITY, DEPTH, ALTIMETER = "auv/truth/pose", "auv/truth/velocity", "auv/depth", "auv/altimeter"
S = 1_000_000_000
LEVEL = (1.0, 0.0, 0.0, 0.0)
EAST = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
COMMANDS = {
    "DESIRED_THRUST": (Target(port="propeller", field="u", full=1.0),),
    "DESIRED_RUDDER": (Target(port="rudder", field="angle_rad", full_deg=-20.0),),
    "DESIRED_THRUST_L": (Target(port="thrusters", field="u", full=(1.0, 0.0)),),
    "DESIRED_THRUST_R": (Target(port="auv/thrusters", field="u", full=(0.0, 1.0)),),
}


def sample(port: str, *value: Any, t_ns: int = 0, valid: bool = True) -> Sample:
    return Sample(port, 0, t_ns, t_ns, valid, value)


class Bench:
    """A bridge and what it posted."""

    def __init__(self, context: FakeContext, **table: object) -> None:
        self.context = context
        self.posts: list[list[tuple[str, float | str]]] = []
        self.listened: list[str] = []
        self.now_s = 0.0
        self.bridge = Bridge(
            BridgeTable(**table),
            self.context,
            lambda pairs: self.posts.append(list(pairs)),
            self.listened.extend,
            "moos",
            lambda: self.now_s,
        )

    def put(self, *samples) -> dict[str, float | str]:
        """Variables that a tick becomes."""
        self.posts.clear()
        self.bridge.put_samples(samples)
        assert len(self.posts) <= 1, "variables of one tick leave together"
        return dict(self.posts[0]) if self.posts else {}

    def write(self, since: float = 0.0, time: float = 10.0, **values) -> None:
        self.bridge.take([(key, value, "pMarinePID", time) for key, value in values.items()], since)

    @property
    def commands(self) -> list[tuple[str, tuple]]:
        found = [(command.port, command.value) for command in self.context.commands]
        self.context.commands.clear()
        return found

    @property
    def calls(self) -> list[tuple[str, object]]:
        found = [(call.service, dict(call.args)) for call in self.context.calls if call.service != "world/status"]
        self.context.calls.clear()
        return found

    def posted(self, key: str) -> list:
        return [value for pairs in self.posts for name, value in pairs if name == key]

    @property
    def errors(self) -> list[dict]:
        return [json.loads(text) for text in self.posted(module.ERROR)]


@pytest.fixture
def make(make_auv: Callable[[], FakeContext]) -> Callable[..., Bench]:
    return lambda context=None, **table: Bench(context or make_auv(), **table)


async def settle(condition) -> None:
    for _ in range(30_000):
        if condition():
            return
        await asyncio.sleep(0.002)
    raise AssertionError("nothing came")


# -- out --------------------------------------------------------------------------------------------------------------------------------


def test_every_component_becomes_a_variable(make):
    bench = make()
    said = bench.put(
        sample(POSE, (1.0, 2.0, 3.0), (0.5, 0.25, 0.125, 0.0), t_ns=S // 2), sample(DEPTH, 3.25, t_ns=S // 2)
    )
    assert said == {
        "AUV_TRUTH_POSE_P_NB_X": 1.0, "AUV_TRUTH_POSE_P_NB_Y": 2.0, "AUV_TRUTH_POSE_P_NB_Z": 3.0,
        "AUV_TRUTH_POSE_Q_NB_W": 0.5, "AUV_TRUTH_POSE_Q_NB_X": 0.25, "AUV_TRUTH_POSE_Q_NB_Y": 0.125, "AUV_TRUTH_POSE_Q_NB_Z": 0.0,
        "AUV_DEPTH_DEPTH": 3.25, "UWSERVER_TIME": 0.5,
    }  # fmt: skip


def test_vectors_as_json(make):
    said = make(vectors="json").put(sample(POSE, (1.0, math.nan, 3.0), LEVEL))
    assert json.loads(said["AUV_TRUTH_POSE_P_NB"]) == [1.0, None, 3.0]


def test_long_fields_are_always_json(make, make_auv):
    sonar = Port("auv/sonar", "sensor", "sonar", (Field("bins", "1", "echo", shape=(300,)),), "Sonar.", 5.0)
    context = make_auv()
    context.ports = {**context.ports, sonar.path: sonar}
    said = make(context).put(sample(sonar.path, tuple(map(float, range(300)))))
    assert json.loads(said["AUV_SONAR_BINS"]) == list(range(300))


def test_texts_and_flags_are_strings_and_holes_are_left_out(make, make_auv):
    port = Port(
        "auv/gps", "sensor", "gps",
        (Field("fix", "1", "fix", type="bool"), Field("mode", "1", "mode", type="str"), Field("n", "1", "n", type="int"), Field("lat", "rad", "lat")),
        "GPS.", 1.0, message="NavSatFix",
    )  # fmt: skip
    context = make_auv()
    context.ports = {**context.ports, port.path: port}
    bench = make(context)
    assert bench.put(sample(port.path, True, "rtk", 7, math.inf)) == {
        "AUV_GPS_FIX": "true", "AUV_GPS_MODE": "rtk", "AUV_GPS_N": 7.0, "UWSERVER_TIME": 0.0,
    }  # fmt: skip
    assert bench.put(sample(port.path, None, None, None, None, valid=False)) == {
        "AUV_GPS_VALID": "false",
        "UWSERVER_TIME": 0.0,
    }
    assert bench.put(sample(port.path, False, None, None, 0.5))["AUV_GPS_VALID"] == "true"


def test_patterns_choose_what_is_published(make):
    bench = make(publish=("auv/depth",))
    assert bench.put(sample(POSE, (0.0,) * 3, LEVEL)) == {}
    assert "AUV_DEPTH_DEPTH" in bench.put(sample(DEPTH, 1.0))


def test_on_change_publishes_once(make):
    bench = make(on_change=True)
    assert bench.put(sample(DEPTH, 1.0))["AUV_DEPTH_DEPTH"] == 1.0
    assert bench.put(sample(DEPTH, 1.0)) == {}
    assert bench.put(sample(DEPTH, 2.0))["AUV_DEPTH_DEPTH"] == 2.0


@pytest.mark.parametrize(("rate_hz", "wanted"), [(10.0, 10), (3.0, 3), (7.0, 7), (50.0, 20), (20.0, 20)])
def test_rates_are_kept_in_simulation_time(make, rate_hz, wanted):
    bench = make(rate_hz=rate_hz)
    count = sum("AUV_DEPTH_DEPTH" in bench.put(sample(DEPTH, 1.0, t_ns=k * S // 20)) for k in range(200))
    assert count == wanted * 10


def test_after_a_reset_time_begins_anew(make):
    bench = make(rate_hz=1.0)
    bench.put(sample(DEPTH, 1.0, t_ns=100 * S))
    bench.bridge.put_event(Event("reset", 0, 0, "reset"))
    assert "AUV_DEPTH_DEPTH" in bench.put(sample(DEPTH, 1.0, t_ns=0))


def test_events_are_told(make):
    bench = make()
    bench.bridge.put_event(Event("paused", 3, 12, "why"))
    assert json.loads(bench.posted(module.EVENT)[0]) == {"event": "paused", "tick": 3, "t_ns": 12, "text": "why"}


def test_ports_may_change(make):
    bench = make()
    second = msgspec.structs.replace(bench.context.ports[DEPTH], path="auv/second")
    bench.context.set_ports([*bench.context.ports.values(), second])
    bench.bridge.put_event(Event("ports_changed", 0, 0, ""))
    assert bench.put(sample("auv/second", 1.0))["AUV_SECOND_DEPTH"] == 1.0


async def test_actuators_that_come_later_are_obeyed_too(make):
    bench = make()
    port = msgspec.structs.replace(bench.context.ports["auv/propeller"], path="rov/propeller")
    bench.context.set_ports([*bench.context.ports.values(), port])
    bench.bridge.put_event(Event("ports_changed", 0, 0, ""))
    assert bench.listened == ["ROV_PROPELLER_U"]
    bench.write(ROV_PROPELLER_U=0.5)
    assert bench.commands == [("rov/propeller", ((0.5,),))]


# -- the conventional set ---------------------------------------------------------------------------------------------------------------


def test_the_conventional_set_by_hand(make):
    """Heading 90 (east), surge 2 m/s, 10 m north, 20 m east, 5 m deep."""
    bench = make(publish=(), nav=NavTable(water_depth_m=30.0))
    assert bench.put(sample(VELOCITY, (2.0, 0.0, 0.0), (0.0,) * 3)) == {}
    said = bench.put(sample(POSE, (10.0, 20.0, 5.0), EAST))
    assert said == pytest.approx(
        {
            "NAV_X": 20.0, "NAV_Y": 10.0, "NAV_DEPTH": 5.0, "NAV_Z": -5.0, "NAV_HEADING": 90.0, "NAV_YAW": -math.pi / 2, "NAV_PITCH": 0.0,
            "NAV_ROLL": 0.0, "NAV_SPEED": 2.0, "NAV_SPEED_OVER_GROUND": 2.0, "NAV_HEADING_OVER_GROUND": 90.0, "NAV_ALTITUDE": 25.0,
            "TRUE_X": 20.0, "TRUE_Y": 10.0, "UWSERVER_TIME": 0.0,
        }, abs=1e-12,
    )  # fmt: skip


def test_speed_is_the_surge_and_the_course_is_over_ground(make):
    """Heading north with 1 m/s surge and 1 m/s sway: the course is north-east. (MORSE's NAV_SPEED was the sway.)"""
    bench = make(publish=(), nav=NavTable())
    bench.put(sample(VELOCITY, (1.0, 1.0, 0.5), (0.0,) * 3))
    said = bench.put(sample(POSE, (0.0, 0.0, 1.0), LEVEL))
    assert said["NAV_SPEED"] == 1.0
    assert said["NAV_SPEED_OVER_GROUND"] == pytest.approx(math.sqrt(2.0))
    assert said["NAV_HEADING_OVER_GROUND"] == pytest.approx(45.0)


FLOW = Port("auv/truth/flow", "sensor", "truth_flow", (Field("v_NW_B", "m/s", "water", "B", (3,)),), "Flow.", 20.0)
DVL = Port(
    "auv/dvl", "sensor", "dvl",
    (Field("v_S", "m/s", "over ground", "S", (3,)), Field("v_water_S", "m/s", "through the water", "S", (3,))), "DVL.", 5.0, message="Dvl",
)  # fmt: skip


@pytest.fixture
def in_a_current(make_auv) -> FakeContext:
    context = make_auv()
    context.set_ports([*context.ports.values(), FLOW, DVL])
    return context


def test_speed_is_through_the_water_and_never_negative(make, in_a_current):
    """In 0.5 m/s of following current 2 m/s over ground are 1.5 through the water; backwards is 0, as uSimMarine has it."""
    bench = make(in_a_current, publish=(), nav=NavTable())
    still = (0.0, 0.0, 0.0)
    bench.put(sample(FLOW.path, (0.5, 0.2, 0.0)), sample(VELOCITY, (2.0, 0.0, 0.0), still))
    said = bench.put(sample(POSE, (0.0, 0.0, 1.0), LEVEL))
    assert (said["NAV_SPEED"], said["NAV_SPEED_OVER_GROUND"]) == (1.5, 2.0)
    bench.put(sample(VELOCITY, (-1.0, 0.0, 0.0), still))
    assert bench.put(sample(POSE, (0.0, 0.0, 1.0), LEVEL))["NAV_SPEED"] == 0.0


def test_speed_can_be_that_of_a_water_track(make, in_a_current):
    bench = make(in_a_current, publish=(), nav=NavTable(velocity="dvl", flow="dvl"))
    bench.put(sample(DVL.path, (2.0, 0.0, 0.0), (1.25, 0.0, 0.0)))
    said = bench.put(sample(POSE, (0.0, 0.0, 1.0), LEVEL))
    assert (said["NAV_SPEED"], said["NAV_SPEED_OVER_GROUND"]) == (1.25, 2.0)


def test_the_ground_truth_stands_beside_what_sensors_say(make, in_a_current):
    bench = make(in_a_current, publish=(), nav=NavTable(depth="depth", ground_truth=True, water_depth_m=50.0))
    bench.put(sample(DEPTH, 2.5), sample(VELOCITY, (2.0, 0.0, 0.0), (0.0,) * 3), sample(FLOW.path, (0.5, 0.0, 0.0)))
    said = bench.put(sample(POSE, (10.0, 20.0, 3.0), EAST))
    assert (said["NAV_DEPTH"], said["NAV_GT_DEPTH"], said["NAV_GT_ALTITUDE"]) == (2.5, 3.0, 47.0)
    assert (said["NAV_GT_X"], said["NAV_GT_Y"], said["NAV_GT_SPEED"]) == (20.0, 10.0, 1.5)
    assert (said["TRUE_X"], said["TRUE_Y"]) == (20.0, 10.0)


def test_what_sensors_say_is_not_called_true(make, make_auv):
    context = make_auv()
    port = msgspec.structs.replace(context.ports[POSE], path="auv/mocap", kind="motion_capture")
    context.set_ports([*context.ports.values(), port])
    bench = make(context, publish=(), nav=NavTable(position="mocap", attitude="mocap", velocity=""))
    said = bench.put(sample("auv/mocap", (1.0, 2.0, 3.0), LEVEL))
    assert said["NAV_X"] == 2.0
    assert "TRUE_X" not in said


@pytest.mark.parametrize(("yaw_deg", "heading"), [(0, 0), (-90, 270), (-1e-15, 0.0), (179, 179), (-179, 181)])
def test_headings_lie_in_0_to_360(make, yaw_deg, heading):
    half = math.radians(yaw_deg) / 2
    said = make(publish=(), nav=NavTable()).put(sample(POSE, (0.0,) * 3, (math.cos(half), 0.0, 0.0, math.sin(half))))
    assert said["NAV_HEADING"] == pytest.approx(heading, abs=1e-9)
    assert 0.0 <= said["NAV_HEADING"] < 360.0


def test_pitch_is_nose_up(make):
    half = math.radians(10.0) / 2
    said = make(publish=(), nav=NavTable()).put(sample(POSE, (0.0,) * 3, (math.cos(half), 0.0, math.sin(half), 0.0)))
    assert said["NAV_PITCH"] == pytest.approx(math.radians(10.0))


def test_latitude_and_longitude(make):
    """One minute of latitude is 1852 m within half a percent; on the meridian of s1_alpha a degree of longitude is cos(lat) of that."""
    bench = make(publish=(), nav=NavTable(origin_deg=(43.825300, -70.330400)))
    said = bench.put(sample(POSE, (1852.0, 0.0, 0.0), LEVEL))
    assert said["NAV_LAT"] == pytest.approx(43.8253 + 1 / 60, abs=5e-5)
    assert said["NAV_LONG"] == pytest.approx(-70.3304)
    said = bench.put(sample(POSE, (0.0, 1852.0, 0.0), LEVEL))
    assert (said["NAV_LONG"] + 70.3304) * 60 * math.cos(math.radians(43.8253)) == pytest.approx(1.0, rel=5e-3)


def test_the_set_can_come_from_sensors(make):
    nav = NavTable(
        prefix="USM", position="", velocity="", attitude="truth/pose", depth="depth", altitude="auv/altimeter"
    )
    bench = make(publish=(), nav=nav)
    bench.put(sample(DEPTH, 7.0), sample(ALTIMETER, 12.0))
    said = bench.put(sample(POSE, (0.0, 0.0, 99.0), LEVEL))
    assert (said["USM_DEPTH"], said["USM_Z"], said["USM_ALTITUDE"]) == (7.0, -7.0, 12.0)
    assert not {"USM_X", "USM_SPEED"} & said.keys()


def test_the_world_is_told_what_becomes_a_variable(make):
    assert set(make().bridge.subscriptions) == {POSE, VELOCITY, DEPTH, ALTIMETER}
    assert set(make(publish=("auv/d*", "*/altimeter")).bridge.subscriptions) == {ALTIMETER}
    assert set(make(publish=()).bridge.subscriptions) == set()
    sensors = NavTable(position="", velocity="", attitude="", depth="depth", ground_truth=True)
    assert set(make(publish=(), nav=sensors).bridge.subscriptions) == {DEPTH, POSE, VELOCITY}
    bench = make(publish=(), nav=NavTable(depth="depth"))
    ports = bench.context.ports
    for there in (True, False, True):
        bench.context.set_ports([port for port in ports.values() if there or port.path != DEPTH])
        bench.bridge.put_event(Event("ports_changed", 0, 0, ""))
        assert (DEPTH in bench.bridge.subscriptions) == there


async def test_who_publishes_nothing_knows_the_time_all_the_same(make):
    bench = make(publish=())
    bench.context.tick = 500
    bench.bridge.attend()
    assert "Simulation time: 2.00 s" in bench.bridge._report()


def test_another_body_may_come_under_the_name_that_the_set_is_made_of(make):
    """Its fields may stand elsewhere, or not be there: nothing is read from the wrong place, and no sample ends the adapter."""
    bench = make(publish=(), nav=NavTable(depth="depth"))
    bench.put(sample(DEPTH, 7.0))
    old = bench.context.ports
    others = [port for port in old.values() if port.path != DEPTH]
    more = Field("temperature", "degC", "x")
    bench.context.set_ports([*others, msgspec.structs.replace(old[DEPTH], fields=(more, *old[DEPTH].fields))])
    bench.bridge.put_event(Event("ports_changed", 0, 0, ""))
    said = bench.put(sample(DEPTH, 12.5, 9.0), sample(POSE, (0.0, 0.0, 99.0), LEVEL))
    assert said["NAV_DEPTH"] == 9.0
    bench.context.set_ports([*others, msgspec.structs.replace(old[DEPTH], fields=(more,))])
    bench.bridge.put_event(Event("ports_changed", 0, 0, ""))
    assert "depth" in bench.context.stats.last_error
    said = bench.put(sample(DEPTH, 12.5), sample(POSE, (1.0, 0.0, 99.0), LEVEL))
    assert (said["NAV_DEPTH"], said["NAV_Y"]) == (9.0, 1.0), "what is not measured any more stands still"
    bench.context.set_ports(old.values())
    bench.bridge.put_event(Event("ports_changed", 0, 0, ""))
    assert bench.put(sample(DEPTH, 3.0), sample(POSE, (1.0, 0.0, 99.0), LEVEL))["NAV_DEPTH"] == 3.0


def test_invalid_samples_change_nothing(make):
    bench = make(publish=(), nav=NavTable())
    assert bench.put(sample(POSE, (None,) * 3, (None,) * 4, valid=False)) == {}
    assert "NAV_X" not in bench.put(sample(POSE, (None,) * 3, LEVEL))


def test_the_sets_rate(make):
    bench = make(publish=(), nav=NavTable(rate_hz=4.0))
    assert sum("NAV_X" in bench.put(sample(POSE, (0.0,) * 3, LEVEL, t_ns=k * S // 20)) for k in range(200)) == 40


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ({"nav": NavTable(position="gps")}, 'nav.position: no sensor "auv/gps"; there are: auv/altimeter'),
        ({"nav": NavTable(depth="propeller")}, 'nav.depth: no sensor "auv/propeller"'),
        ({"nav": NavTable(depth="altimeter")}, 'nav.depth: "auv/altimeter" has none of the fields depth'),
        ({"vehicle": "rov"}, 'no vehicle "rov"; there are: auv'),
        ({"commands": {"X": (Target(port="prop", field="u", full=1.0),)}}, 'commands.X: no actuator "auv/prop"; there are: auv/propeller'),
        ({"commands": {"X": (Target(port="propeller", field="v", full=1.0),)}}, 'has no field "v", it has: u'),
        ({"commands": {"X": (Target(port="propeller", field="u"),)}}, "give either `full` or `full_deg`"),
        ({"commands": {"X": (Target(port="propeller", field="u", full_deg=1.0),)}}, '"u" is in 1: give `full`'),
        ({"commands": {"X": (Target(port="thrusters", field="u", full=(1.0,) * 3),)}}, "3 numbers"),
        ({"commands": {"X": (Target(port="propeller", field="u", full=math.nan),)}}, "not finite"),
    ],
)  # fmt: skip
def test_what_is_not_there_is_named(make, table, text):
    with pytest.raises(CannotServe) as raised:
        make(**table)
    assert text in str(raised.value)


def test_truth_that_is_not_served_is_hinted_at(make, make_auv):
    context = make_auv()
    context.set_ports([port for port in context.ports.values() if not port.is_truth])
    with pytest.raises(CannotServe, match="set truth = true"):
        make(context, nav=NavTable())


def test_two_vehicles_need_a_name(make, make_auv):
    context = make_auv()
    context.ports = {**context.ports, IMU.path: IMU}
    with pytest.raises(CannotServe, match="vehicle = one of auv, rov"):
        make(context, nav=NavTable())
    assert make(context, nav=NavTable(), vehicle="auv").put(sample(POSE, (0.0,) * 3, LEVEL))["NAV_X"] == 0.0
    assert make(context).bridge.listens_to


# -- percentages ------------------------------------------------------------------------------------------------------------------------


async def test_a_percentage_becomes_a_command(make):
    bench = make(commands=COMMANDS)
    bench.write(DESIRED_THRUST=40.0)
    assert bench.commands == [("auv/propeller", ((0.4,),))]


async def test_what_comes_together_takes_effect_together(make):
    bench = make(commands=COMMANDS)
    bench.write(DESIRED_THRUST_L=50.0, DESIRED_THRUST_R=-100.0, DESIRED_RUDDER=50.0)
    assert bench.commands == [
        ("auv/thrusters", ((0.5, -1.0),)),
        ("auv/rudder", ((pytest.approx(-math.radians(10.0)),),)),
    ]


async def test_what_one_variable_said_holds_while_another_speaks(make):
    bench = make(commands=COMMANDS)
    bench.write(DESIRED_THRUST_L=50.0)
    bench.write(DESIRED_THRUST_R=25.0)
    assert bench.commands[-1] == ("auv/thrusters", ((0.5, 0.25),))


async def test_a_ballast_is_mapped_about_its_neutral_volume(make, make_auv):
    """As docs/how-to/moos.md maps BUOYANCY_RATE: 0.1 m/s pumps it full."""
    volume = Field("volume_m3", "m3", "volume", minimum=80e-6, maximum=955e-6)
    context = make_auv()
    context.set_ports([*context.ports.values(), Port("auv/engine", "actuator", "ballast", (volume,), "Engine.")])
    target = Target(port="engine", field="volume_m3", zero=500e-6, full=0.455, limit=0.1)
    bench = make(context, commands={"BUOYANCY_RATE": (target,)})
    said = []
    for written in (
        {"BUOYANCY_RATE": 0.05},
        {"BUOYANCY_RATE": 1.0},
        {"BUOYANCY_RATE": -1.0},
        {"MOOS_MANUAL_OVERRIDE": "true"},
    ):
        bench.write(**written)
        ((_, ((value,),)),) = bench.commands
        said.append(value)
    assert said == pytest.approx([727.5e-6, 955e-6, 80e-6, 500e-6], rel=1e-9)


async def test_percentages_and_actuators_are_limited(make):
    bench = make(commands=COMMANDS)
    bench.write(DESIRED_THRUST=1000.0, DESIRED_RUDDER=-100.0)
    assert bench.commands == [("auv/propeller", ((1.0,),)), ("auv/rudder", ((0.3,),))]


@pytest.mark.parametrize("value", [math.nan, math.inf, "40", b"40"])
async def test_nonsense_is_told_and_changes_nothing(make, value):
    bench = make(commands=COMMANDS)
    bench.write(DESIRED_THRUST=value)
    assert bench.commands == []
    (error,) = bench.errors
    assert (error["variable"], error["src"]) == ("DESIRED_THRUST", "pMarinePID")
    assert bench.context.stats.errors == 1


@pytest.mark.parametrize("name", ["DESIRED_THRUST", "AUV_PROPELLER_U", "USM_RESET", "DRIFT_VECTOR", "USM_SIM_PAUSED"])
async def test_text_that_is_no_utf_8_is_told_and_what_stands_beside_it_is_done(make, name):
    bench = make(commands=COMMANDS)
    bench.bridge.take([(name, "7\udcff/\udcfe", "\udcff", 10.0), ("DESIRED_RUDDER", 10.0, "helm", 10.0)])
    (error,) = bench.errors
    assert (error["variable"], error["value"], error["src"]) == (name, "7\ufffd/\ufffd", "\ufffd")
    assert [path for path, _ in bench.commands] == ["auv/rudder"]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(
            st.sampled_from(sorted({*COMMANDS, "AUV_PROPELLER_U", "AUV_THRUSTERS_U", "USM_RESET", "DRIFT_X", "DRIFT_VECTOR",
                             "DRIFT_VECTOR_ADD", "WATER_DEPTH", "USM_SIM_PAUSED", "MOOS_MANUAL_OVERRIDE", "UWSERVER_CALL", "ELSE"})),
            st.floats() | st.text(st.characters(exclude_categories=()), max_size=30) | st.binary(max_size=30)
            | st.sampled_from(["1 world/echo", "world/echo {\"value\":\"\udcff\"}", "x=1", "90,1", "[1,2]", "true"]),
            st.text(st.characters(exclude_categories=()), max_size=5),
            st.floats(),
        ),
        max_size=5,
    ),
    st.sampled_from([-math.inf, 0.0, math.inf]),
)  # fmt: skip
def test_whatever_is_written_never_raises(make, written, since):
    async def write() -> Bench:
        bench = make(commands=COMMANDS, nav=NavTable())
        bench.bridge.take(written, since)
        await asyncio.sleep(0)
        bench.bridge.close()
        return bench

    for error in asyncio.run(write()).errors:
        assert error["code"]


async def test_history_is_no_command(make):
    """A database keeps the last DESIRED_THRUST of yesterday's mission."""
    bench = make(commands=COMMANDS)
    bench.write(
        since=20.0, time=10.0, DESIRED_THRUST=40.0, USM_RESET="x=1", AUV_PROPELLER_U=1.0, UWSERVER_CALL="world/pause"
    )
    assert bench.commands == []
    assert bench.calls == []


async def test_commands_by_a_clock_that_is_behind_are_told_once(make):
    """A program with another MOOSTimeWarp would else be ignored without a word."""
    bench = make(commands=COMMANDS)
    for time in (10.0, 10.0, 1e9 - 0.2, 1e9 - 0.1):  # kept, asked for twice, and two that were under way
        bench.write(since=1e9, time=time, DESIRED_THRUST=40.0)
    assert bench.errors == []
    for time in (11.0, 12.0, 13.0):
        bench.write(since=1e9, time=time, DESIRED_THRUST=40.0)
    assert bench.commands == []
    (error,) = bench.errors
    assert "MOOSTimeWarp" in error["message"]
    bench.bridge.begin()
    bench.posts.clear()
    bench.write(since=1e9, time=14.0, DESIRED_THRUST=40.0)
    assert bench.errors == []


async def test_states_of_before_hold_once(make):
    bench = make()
    bench.write(since=20.0, time=10.0, DRIFT_X=0.5)
    assert [service for service, _ in bench.calls] == ["world/set_current"]
    bench.write(since=30.0, time=10.0, DRIFT_X=0.5)
    assert bench.calls == []


async def test_actuators_can_be_written_directly(make):
    bench = make()
    bench.write(AUV_PROPELLER_U=0.25, AUV_THRUSTERS_U="[0.5, -0.5]")
    assert bench.commands == [("auv/propeller", ((0.25,),)), ("auv/thrusters", ((0.5, -0.5),))]
    bench.write(AUV_THRUSTERS_U="[0.5]")
    bench.write(AUV_THRUSTERS_U="nonsense")
    bench.write(AUV_PROPELLER_U=2.0)
    assert bench.commands == []
    assert [error["code"] for error in bench.errors] == ["bad_shape", "bad_argument", "out_of_range"]


# -- uSimMarine's other inputs ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["MOOS_MANUAL_OVERRIDE", "MOOS_MANUAL_OVERIDE"])
async def test_override_puts_to_neutral_once(make, name):
    bench = make(commands=COMMANDS)
    bench.write(DESIRED_THRUST=40.0, DESIRED_THRUST_L=10.0)
    assert bench.commands
    bench.write(**{name: "true"})
    assert sorted(bench.commands) == [
        ("auv/propeller", ((0.0,),)),
        ("auv/rudder", ((0.0,),)),
        ("auv/thrusters", ((0.0, 0.0),)),
    ]
    bench.write(DESIRED_THRUST=20.0)  # by hand
    assert bench.commands == [("auv/propeller", ((0.2,),))]
    bench.write(**{name: "false"})
    assert bench.commands == []


async def test_reset_moves_the_vehicle(make):
    bench = make(nav=NavTable())
    bench.put(sample(POSE, (1.0, 2.0, 3.0), EAST))
    bench.write(USM_RESET="x=10, y=-20, heading=180, speed=1.5, depth=4")
    assert bench.commands == [
        ("auv/teleport", ((-20.0, 10.0, 4.0), pytest.approx((0.0, 0.0, 0.0, 1.0), abs=1e-12), (1.5, 0.0, 0.0), (0.0, 0.0, 0.0)))
    ]  # fmt: skip
    await asyncio.sleep(0)  # the answer
    bench.put(sample(POSE, (1.0, 2.0, 3.0), EAST, t_ns=S))
    bench.write(USM_RESET="depth=9")
    ((_, (p, q, v, _)),) = bench.commands
    assert (p, q, v) == ((1.0, 2.0, 9.0), pytest.approx(EAST), (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "text", ["x=10,y=-20,hdg=180,spd=1.5,dep=4", " X = 10, Y=-20, deg=180, speed=1.5, DEP=4,", "10,-20,180,1.5,4"]
)
async def test_a_reset_may_be_short_or_a_list(make, text):
    bench = make()
    bench.write(USM_RESET=text)
    ((_, (p, q, v, _)),) = bench.commands
    assert (p, q, v) == ((-20.0, 10.0, 4.0), pytest.approx((0.0, 0.0, 0.0, 1.0), abs=1e-12), (1.5, 0.0, 0.0))


async def test_two_partial_resets_in_one_packet_both_count(make):
    """The second stands on the first, of which no position has told yet; so does one that comes before a position does."""
    bench = make(nav=NavTable())
    bench.put(sample(POSE, (1.0, 2.0, 3.0), EAST, t_ns=5 * S))
    bench.context.tick = 1_000_000  # of the answers: later than all positions here
    texts = ("x=10,spd=2", "hdg=0,y=7")
    bench.bridge.take([("USM_RESET", text, "uPokeDB", 10.0) for text in texts])
    (_, last) = bench.commands
    assert last == ("auv/teleport", ((7.0, 10.0, 3.0), LEVEL, (2.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    await settle(lambda: bench.posted("USM_RESET_COUNT")[-1:] == [2.0])
    bench.put(sample(POSE, (1.0, 2.0, 3.0), EAST, t_ns=0))  # from before
    bench.write(USM_RESET="dep=9")
    ((_, (p, *_)),) = bench.commands
    assert p == (7.0, 10.0, 9.0)


async def test_a_reset_that_the_world_refuses_is_no_base_for_the_next(make):
    bench = make(nav=NavTable())
    bench.put(sample(POSE, (1.0, 2.0, 3.0), EAST, t_ns=5 * S))
    bench.context.held.add("auv/teleport")
    bench.write(USM_RESET="x=10")
    (held,) = (call for call in bench.context.calls if call.service == "auv/teleport")
    held.finish(Reply(0, 0, fault=Fault("busy", "not now")))
    assert bench.errors
    bench.context.commands.clear()
    bench.write(USM_RESET="y=7")
    ((_, (p, *_)),) = bench.commands
    assert p == (7.0, 2.0, 3.0)


@pytest.mark.parametrize(
    "text", ["", "x", "x=", "x=nan", "z=3", "x=1;y=2", "x=1e999", 5.0, "1,2,3,4,5,6", "x=1,x=2", "y=1,2", "1,,3"]
)
async def test_a_reset_that_cannot_be_read_is_told_and_stops_nothing(make, text):
    bench = make(commands=COMMANDS)
    bench.write(USM_RESET=text)
    assert bench.commands == []
    assert len(bench.errors) == 1


async def test_without_teleport_there_is_no_reset(make, make_auv):
    context = make_auv()
    context.set_ports([port for port in context.ports.values() if port.kind != "teleport"])
    bench = make(context)
    bench.write(USM_RESET="x=1")
    assert "teleport" in bench.errors[0]["message"]


async def test_pause(make):
    bench = make()
    bench.write(USM_SIM_PAUSED="true")
    bench.write(USM_SIM_PAUSED="FALSE")
    bench.write(USM_SIM_PAUSED="perhaps")
    assert bench.calls == [("world/pause", {}), ("world/resume", {})]
    assert "neither true nor false" in bench.errors[0]["message"]


async def test_water_flows_as_it_is_said(make):
    bench = make()
    flows = []
    for written in (
        {"DRIFT_X": 0.5},
        {"DRIFT_Y": "0.25"},
        {"CURRENT_X": -1.0},
        {"DRIFT_VECTOR": "90,2"},
        {"DRIFT_VECTOR_ADD": "0,1"},
        {"DRIFT_VECTOR_MULT": 0.5},
    ):
        bench.write(**written)
        flows += [args["velocity_N"] for service, args in bench.calls if service == "world/set_current"]
    assert [tuple(flow) for flow in flows] == [
        pytest.approx(flow, abs=1e-12)
        for flow in ((0, 0.5, 0), (0.25, 0.5, 0), (0.25, -1, 0), (0, 2, 0), (1, 2, 0), (0.5, 1, 0))
    ]
    bench.write(DRIFT_VECTOR="north")
    bench.write(DRIFT_X=1e9)
    assert [error["code"] for error in bench.errors] == ["bad_argument", "out_of_range"]


async def test_water_depth_gives_the_altitude(make):
    bench = make(nav=NavTable())
    bench.write(WATER_DEPTH=50.0)
    assert bench.put(sample(POSE, (0.0, 0.0, 10.0), LEVEL))["NAV_ALTITUDE"] == 40.0


@pytest.mark.parametrize("depth", [-1.0, "-0.5", math.nan, math.inf, "deep"])
async def test_a_water_depth_that_is_none_is_told(make, depth):
    bench = make(nav=NavTable(water_depth_m=50.0))
    bench.write(WATER_DEPTH=depth)
    (error,) = bench.errors
    assert error["variable"] == "WATER_DEPTH"
    assert bench.put(sample(POSE, (0.0, 0.0, 10.0), LEVEL))["NAV_ALTITUDE"] == 40.0
    bench.write(WATER_DEPTH=0.0)  # not known, as in uSimMarine
    assert "NAV_ALTITUDE" not in bench.put(sample(POSE, (0.0, 0.0, 10.0), LEVEL))
    bench.write(WATER_DEPTH=5.0)
    assert bench.put(sample(POSE, (0.0, 0.0, 10.0), LEVEL))["NAV_ALTITUDE"] == 0.0


async def test_a_current_is_told_back(make):
    bench = make()
    bench.write(DRIFT_VECTOR="90,2")
    await settle(lambda: bench.posted("USM_DRIFT_SUMMARY"))
    assert bench.posted("USM_DRIFT_SUMMARY") == ["ang=90.00, mag=2.00, xmag=2.000, ymag=0.000"]


async def test_switched_off_it_leaves_the_vehicle_to_another_simulator(make):
    """No NAV_*, no commands; switched on again it goes on where the other one says that the vehicle is."""
    bench = make(commands=COMMANDS, nav=NavTable(), publish=())
    bench.put(sample(POSE, (1.0, 2.0, 3.0), EAST, t_ns=S))
    bench.write(DESIRED_THRUST=40.0)
    assert bench.commands
    bench.write(USM_ENABLED="false")
    assert bench.listened == ["NAV_X", "NAV_Y", "NAV_HEADING"]
    assert dict(bench.commands)["auv/propeller"] == ((0.0,),)
    bench.write(DESIRED_THRUST=40.0, NAV_X=100.0, NAV_Y=50.0, NAV_HEADING=180.0)
    assert bench.commands == []
    assert bench.put(sample(POSE, (1.0, 2.0, 3.5), EAST, t_ns=2 * S)) == {}
    bench.write(USM_ENABLED="true")
    moved = dict(bench.commands)["auv/teleport"]
    assert moved[:2] == ((50.0, 100.0, 3.5), pytest.approx((0.0, 0.0, 0.0, 1.0), abs=1e-12))
    bench.write(NAV_X=0.0, DESIRED_THRUST=40.0)
    assert bench.commands == [("auv/propeller", ((0.4,),))]
    assert "NAV_X" in bench.put(sample(POSE, (50.0, 100.0, 3.5), EAST, t_ns=3 * S))


# -- floods -----------------------------------------------------------------------------------------------------------------------------


async def test_a_flood_of_resets_is_bounded_and_told_once_a_second(make):
    bench = make(nav=NavTable())
    for number in range(2000):
        bench.write(USM_RESET=f"x={number}")
    assert sum(path == "auv/teleport" for path, _ in bench.commands) == module.STATES_PER_S
    (error,) = bench.errors
    assert (error["code"], error["src"]) == ("overload", "pMarinePID")
    bench.now_s = 1.1
    bench.write(USM_RESET="x=7")
    assert bench.commands == [("auv/teleport", ((0.0, 7.0, 0.0), LEVEL, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))]


async def test_a_flood_of_calls_is_bounded_answered_once_and_delays_no_other_client(make):
    bench = make()
    for number in range(2000):
        bench.bridge.take([("UWSERVER_CALL", f"{number} world/echo", "flood", 10.0)])
    bench.bridge.take([("UWSERVER_CALL", "mine world/echo", "helm", 10.0)])
    await settle(lambda: len(bench.posted(module.REPLY)) == module.CALLS_PER_S + 2)
    replies = [json.loads(text) for text in bench.posted(module.REPLY)]
    (refused,) = [reply for reply in replies if "error" in reply]
    assert (refused["id"], refused["error"]["code"]) == (str(module.CALLS_PER_S), "overload")
    assert [reply["id"] for reply in replies if reply["src"] == "helm"] == ["mine"]
    assert len(bench.calls) == module.CALLS_PER_S + 1
    assert bench.errors == []


async def test_many_names_of_one_flood_share_a_limit(make):
    bench = make()
    for number in range(5000):
        bench.bridge.take([("UWSERVER_CALL", "world/echo", f"flood{number}", 10.0)])
    assert len(bench.calls) <= 4 * module.CALLS_PER_S


async def test_faults_are_told_sparingly_and_counted(make):
    """Of 500 a second 20 are told, and then how many were not; another writer's is told all the same."""
    bench = make(commands=COMMANDS)
    for _ in range(500):
        bench.write(DESIRED_THRUST="fast")
    bench.bridge.take([("DESIRED_THRUST", "slow", "helm", 10.0)])
    assert [error["src"] for error in bench.errors] == ["pMarinePID"] * 20 + ["helm"]
    assert bench.context.stats.errors == 501
    bench.posts.clear()
    bench.bridge.attend()
    (error,) = bench.errors
    assert error["message"].startswith("480 more")
    bench.posts.clear()
    bench.bridge.attend()
    assert bench.errors == []


# -- the world's pace, appcasts ---------------------------------------------------------------------------------------------------------


def seconds_go_by(bench: Bench, speed: float, count: int, **status: object) -> None:
    """Seconds of wall time in which the world advances by `speed`."""
    for _ in range(count):
        bench.now_s += 1.0
        bench.t_ns = getattr(bench, "t_ns", 0) + round(speed * S)
        said = {"mode": "realtime", "speed": 20.0, "paused": False, "t_ns": bench.t_ns, **status}
        bench.context.scripts["world/status"] = lambda _, said=said: said
        bench.bridge.attend()


def test_a_world_that_cannot_keep_the_warp_says_so(make, caplog):
    bench = make()
    seconds_go_by(bench, 20.0, 5)
    assert bench.posted("UWSERVER_RTF") == [pytest.approx(20.0)] * 4
    seconds_go_by(bench, 12.5, 2)  # a hiccup is none
    assert bench.posted("UWSERVER_WARNING") == []
    seconds_go_by(bench, 12.5, 5)
    (warning,) = bench.posted("UWSERVER_WARNING")
    assert "12.5 of the wanted 20" in warning
    assert "MOOSTimeWarp" in warning
    assert len([r for r in caplog.records if "12.5 of the wanted" in r.getMessage()]) == 1
    seconds_go_by(bench, 20.0, 2)
    assert bench.posted("UWSERVER_WARNING") == [warning, ""]


@pytest.mark.parametrize("status", [{"paused": True}, {"mode": "freerun"}, {"mode": "lockstep"}])
def test_a_world_that_is_not_paced_has_no_warp_to_keep(make, status):
    bench = make()
    seconds_go_by(bench, 0.0, 6, **status)
    assert bench.posted("UWSERVER_RTF") == [0.0] * 5
    assert bench.posted("UWSERVER_WARNING") == []


def test_an_appcast_comes_while_it_is_asked_for(make):
    bench = make(nav=NavTable())
    bench.bridge.begin("alpha")
    bench.put(sample(POSE, (1.0, 2.0, 3.0), EAST, t_ns=S))
    for other in (
        "node=bravo,app=all,duration=3,key=a",
        "node=alpha,app=pHelmIvP,duration=3,key=a",
        "node=alpha,app=all,duration=3",
    ):
        bench.write(APPCAST_REQ=other)
    seconds_go_by(bench, 20.0, 1)
    assert bench.posted("APPCAST") == []
    bench.write(APPCAST_REQ="node=alpha,app=uwserver,duration=3.0,key=uMAC_77,thresh=any")
    seconds_go_by(bench, 20.0, 6)
    casts = bench.posted("APPCAST")
    assert len(casts) == 3
    parts = dict(part.split("=", 1) for part in casts[-1].split("!@#"))
    assert (parts["proc"], parts["node"], parts["run_warning_total"]) == ("uwserver", "alpha", "0")
    assert "NAV_X: 2" in parts["messages"].split("!@")
    bench.write(APPCAST_REQ="node=all,app=all,duration=30,key=uMAC_77")
    seconds_go_by(bench, 10.0, 4)
    parts = dict(part.split("=", 1) for part in bench.posted("APPCAST")[-1].split("!@#"))
    assert "10 of the wanted 20" in parts["run_warnings"]


async def test_usm_can_be_off(make):
    bench = make(usm=False, services=False)
    assert not {"USM_RESET", "DRIFT_X", module.CALL} & set(bench.bridge.listens_to)


# -- services ---------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "id", "args"),
    [
        ('7 world/echo {"value": [1]}', "7", {"value": [1]}),
        ('world/echo {"value": "a b"}', None, {"value": "a b"}),
        ("world/echo", None, {"value": None}),
        ('{"id": 3, "service": "world/echo", "args": {"value": 0}}', 3, {"value": 0}),
    ],
)
async def test_a_call_is_answered(make, text, id, args):
    bench = make()
    bench.write(UWSERVER_CALL=text)
    assert bench.calls == [("world/echo", args)]
    await settle(lambda: bench.posted(module.REPLY))
    (reply,) = map(json.loads, bench.posted(module.REPLY))
    assert (reply["id"], reply["value"], reply["src"]) == (id, args["value"], "pMarinePID")


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "invalid_request"), ("7", "invalid_request"), ("world/nothing", "unknown_service"), ("world/echo {", "parse_error"),
        ("world/echo [1]", "parse_error"), ('{"id": 1}', "parse_error"), ('world/run_until {"t_s": "soon"}', "bad_shape"),
        ("x" * 100_000, "too_large"), ('{"service":"world/echo","timeout_s":-1}', "bad_argument"), ("{" * 5000, "invalid_request"),
        ("world/echo " + "[" + "1e300," * 4000 + "1]", "too_large"), ('world/echo {"value": NaN}', "parse_error"),
    ],
)  # fmt: skip
async def test_a_call_that_cannot_be_is_told_why(make, text, code):
    bench = make()
    bench.write(UWSERVER_CALL=text)
    (reply,) = map(json.loads, bench.posted(module.REPLY))
    assert reply["error"]["code"] == code


@pytest.mark.parametrize(
    ("text", "id"),
    [
        ('7 world/echo {"value": NaN}', "7"),
        ('{"id": 3, "service": "world/echo", "args": NaN}', 3),
        ("7", "7"),
        ("", None),
    ],
)
async def test_the_refusal_of_what_cannot_be_read_has_the_id(make, text, id):
    bench = make()
    bench.write(UWSERVER_CALL=text)
    (reply,) = map(json.loads, bench.posted(module.REPLY))
    assert reply["id"] == id


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("USM_RESET", "x=1," * 16_384), ("DRIFT_VECTOR", "1" * 100_000), ("CURRENT_X", "1" * 100_000), ("USM_SIM_PAUSED", "true" * 10_000),
        ("UWSERVER_CALL", b"\xff" * 100_000), ("CURRENT_X", b"\xff" * 100_000),
    ],
)  # fmt: skip
async def test_endless_texts_are_refused_unread(make, name, value):
    bench = make()
    bench.write(**{name: value})
    assert bench.posted(module.ERROR) or bench.posted(module.REPLY)
    assert bench.calls == []


async def test_a_call_that_takes_too_long_is_cancelled(make):
    bench = make()
    bench.context.held.add("world/run_until")
    bench.write(UWSERVER_CALL='{"id":1,"service":"world/run_until","args":{"t_s":5.0},"timeout_s":0.01}')
    await settle(lambda: bench.posted(module.REPLY))
    (reply,) = map(json.loads, bench.posted(module.REPLY))
    assert (reply["id"], reply["error"]["code"]) == (1, "timeout")


async def test_calls_are_bounded_and_cancelled_at_the_end(make, monkeypatch):
    from uwserver_adapters.moos.bridge import calls

    monkeypatch.setattr(calls, "OPEN", 2)
    bench = make()
    bench.context.held.add("world/run_until")
    for id in range(3):
        bench.write(time=10.0 + id, UWSERVER_CALL=f'{id} world/run_until {{"t_s": 5}}')
    (reply,) = map(json.loads, bench.posted(module.REPLY))
    assert (reply["id"], reply["error"]["code"]) == ("2", "overload")
    held = [call for call in bench.context.calls if call.service == "world/run_until"]
    bench.bridge.close()
    assert [call.is_done for call in held] == [True, True]
