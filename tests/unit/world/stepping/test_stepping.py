"""Many ticks in one go are those that are made one by one, bit for bit, whatever happens in them and between them; and where steps stop.

Also of uwserver.step.tick, uwserver.step.bodies, uwserver.step.rows, uwserver.physics.contact.carrying,
uwserver.world.sensing.python_readings and uwserver.world.stepping.step_table.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import numpy as np
import pytest
import uwserver_scenarios

from uwserver.adapter import installed_adapters
from uwserver.physics.contact.touching import ROOM
from uwserver.physics.kernel.places import FUTEX
from uwserver.ports import Call, Command, Refused, Sample
from uwserver.ports.decimation import Decimation
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.sensors.compiled import CompiledSensor
from uwserver.simulation.mailbox import Wake
from uwserver.step import rows
from uwserver.world import Diverged, World
from uwserver.world.parts.part import Part, State
from uwserver.world.parts.profile import Profile
from uwserver.world.state import snapshot as snapshots
from uwserver.world.stepping.step_table import LONGEST

WORLD = """
schema = 1
title = "ticks in one go"
seed = 3
[world]
rate_hz = {rate}
threads = {threads}
origin_lat_deg = 63.4410
origin_lon_deg = 10.3950
[seabed]
kind = "flat"
depth_m = {bottom}
{more}
[vehicles.rov]
model = "bluerov2_heavy"
{copies}
position_ned_m = [0.0, 0.0, {depth}]
[vehicles.rov.autopilot]
[vehicles.rov.sensors]
ahrs = {{ kind = "attitude", profile = "mems_ahrs", rate_hz = 60 }}
dvl = {{ kind = "dvl", profile = "a50", rate_hz = 8, position_frd_m = [-0.1, 0.0, 0.1] }}
echosounder = {{ kind = "altimeter", profile = "ping1d", rate_hz = 10, position_frd_m = [0.2, 0.0, 0.1] }}
battery = {{ kind = "battery", profile = "lipo_4s_18ah", rate_hz = 2 }}
leak = {{ kind = "leak", rate_hz = 2 }}
"""
LATE_DEPTH = """
[vehicles.rov.override.sensors.depth.modifiers]
late = { kind = "delay", latency_s = 0.13, jitter_s = 0.05 }
lost = { kind = "dropout", probability = 0.2 }
"""


def twice(scenario: str | Path) -> tuple[World, World]:
    """The same world twice, of files that are read once."""
    resolved = load(scenario, adapters=installed_adapters())
    return build(resolved), build(resolved)


class Twins:
    """The same world twice: one makes its ticks one by one, the other as many as it can in one go."""

    def __init__(self, folder: Path, **values: Any) -> None:
        given = {"rate": 240, "threads": 1, "more": "", "copies": "", "depth": 5.0, "bottom": 20.0} | values
        file = folder / "world.toml"
        file.write_text(WORLD.format(**given) + given.get("last", ""), encoding="utf-8")
        self.one, self.other = twice(file)
        self.made = 0

    @property
    def stops(self) -> dict[str, int]:
        """Why the other needed Python within its ticks, and how often."""
        return {reason: count for reason, count in self.other.stops.items() if count and reason != "room"}

    @property
    def ticks(self) -> int:
        """Of the other that needed nothing of Python."""
        return self.made - sum(self.stops.values())

    def do(self, act: Callable[[World], object]) -> None:
        """In both; the answers are the same."""
        assert act(self.one) == act(self.other)

    def step(self, n: int) -> list[Sample]:
        """Both, and compare all that they say and are."""
        samples: list[Sample] = []
        for _ in range(n):
            samples += self.one.advance().samples
        assert self.other.step(n) == samples
        self.made += n
        assert self.one.tick == self.other.tick
        assert self.one.t_ns == self.other.t_ns
        self.compare()
        return samples

    def compare(self) -> None:
        ours, theirs = (world.call("world/state_hash") for world in (self.one, self.other))
        assert ours == theirs
        for path in self.one.sensors:
            assert self.one.sensing.newest(path) == self.other.sensing.newest(path), path


@pytest.fixture
def twins(tmp_path: Path) -> Twins:
    return Twins(tmp_path)


def fly(world: World) -> None:
    for name in world.vehicles:
        world.call(f"{name}/autopilot/arm")
        world.call(f"{name}/autopilot/set_mode", mode="depth_hold")


def test_all_samples_and_states_are_the_same(twins: Twins) -> None:
    twins.step(480)
    twins.do(fly)
    twins.step(1003)
    assert not twins.stops, "none of its sensors needs Python"


def test_texts_of_an_autopilot_are_those_of_their_sample(twins: Twins) -> None:
    twins.step(480)
    twins.do(fly)
    found = [sample.value[0] for sample in twins.step(48) if sample.port == "rov/autopilot/state"]
    assert found == ["depth_hold"] * 2
    twins.do(lambda world: world.call("rov/autopilot/set_mode", mode="stabilise"))
    found = [sample.value[0] for sample in twins.step(48) if sample.port == "rov/autopilot/state"]
    assert found == ["stabilise"] * 2
    assert twins.other.read("rov/autopilot/state").mode == "stabilise"  # type: ignore[union-attr]


def test_a_mission_ends_where_it_ends(twins: Twins) -> None:
    """Its items need Python, in the midst of ticks that do not."""
    twins.step(480)
    items = [
        {"kind": "speed", "speed_mps": 0.8},
        {"kind": "waypoint", "position_ned_m": [0.5, 0.0, 5.0]},
        {"kind": "waypoint", "position_ned_m": [0.5, 0.5, 5.5]},
    ]
    twins.do(lambda world: world.call("rov/autopilot/set_mission", items=items))
    twins.do(lambda world: world.call("rov/autopilot/arm"))
    twins.do(lambda world: world.call("rov/autopilot/start_mission"))
    for _ in range(12):
        twins.step(240)
    assert twins.other.read("rov/autopilot/state").reached >= 2  # type: ignore[union-attr]
    assert twins.ticks > 3000


def test_bodies_that_touch_the_bottom_or_each_other(tmp_path: Path) -> None:
    copies = "copies = { count = 6, columns = 3, spacing_m = [0.6, 0.5] }"
    twins = Twins(tmp_path, copies=copies, depth=19.82)
    twins.step(40)
    assert len(twins.one.hydro.touched.impulse)
    before = twins.ticks
    for k, name in enumerate(twins.one.vehicles):
        u = (0.0, 0.0, 0.0, 0.0, *([-0.2 - 0.1 * k] * 4))
        twins.do(lambda world, name=name, u=u: world.call(f"{name}/thrusters/set", timeout_s=10.0))  # type: ignore[misc]
        twins.do(lambda world, name=name, u=u: world.command(f"{name}/thrusters", u=u))  # type: ignore[misc]
    for _ in range(30):
        twins.step(40)
    assert not len(twins.one.hydro.touched.impulse)
    assert twins.ticks > before + 200


def test_several_threads(tmp_path: Path) -> None:
    if not FUTEX:
        pytest.skip("threads wait in compiled code on Linux alone")
    twins = Twins(tmp_path, copies="copies = { count = 40, columns = 8, spacing_m = [5.0, 5.0] }", threads=2)
    twins.do(lambda world: world.subscribe(()))
    twins.step(480)
    twins.do(fly)
    twins.step(200)
    assert twins.ticks > 600


@pytest.mark.parametrize("rate", ["240", "119.88", "1000", "142.85714285714286"])
def test_rates_that_divide_nothing(tmp_path: Path, rate: str) -> None:
    """Of the last, times are no whole numbers of 64 bits soon; after a reset they are again."""
    sensors = WORLD.partition("[vehicles.rov.sensors]")
    file = tmp_path / "plain.toml"
    text = (
        sensors[0]
        .format(rate=rate, threads=1, more="", copies="", depth=5.0, bottom=20.0)
        .replace("[vehicles.rov.autopilot]", "")
    )
    for sensor in ("imu", "pressure", "depth"):
        text += f"[vehicles.rov.override.sensors.{sensor}]\nrate_hz = {rate}\n"
    file.write_text(text, encoding="utf-8")
    one, other = twice(file)
    for _ in range(2):
        samples = [sample for _ in range(700) for sample in one.advance().samples]
        assert other.step(700) == samples
        assert one.t_ns == other.t_ns == other.ticks.time_of(700)
        assert one.call("world/state_hash") == other.call("world/state_hash")
        for world in (one, other):
            world.call("world/reset")


def test_what_is_late_or_lost(tmp_path: Path) -> None:
    """Samples on their way have their time, and those that nobody reads too."""
    twins = Twins(tmp_path, last=LATE_DEPTH)
    twins.step(300)
    twins.do(lambda world: world.subscribe({"rov/imu"}))
    twins.step(300)
    twins.do(lambda world: world.subscribe(None))
    assert any(sample.port == "rov/depth" for sample in twins.step(60))
    assert twins.ticks > 600


def test_only_the_samples_that_are_wanted(twins: Twins) -> None:
    wanted = {"rov/imu": [Decimation(10.0, 0)], "rov/depth": [Decimation(7.0, 3)]}
    twins.do(lambda world: world.subscribe(set(wanted), wanted))
    samples = twins.step(480)
    assert 0 < sum(sample.port == "rov/imu" for sample in samples) < 30
    twins.do(lambda world: world.subscribe(()))
    assert twins.step(480) == []
    assert twins.ticks > 900


def test_logs_and_places_for_samples_are_renewed(tmp_path: Path) -> None:
    """A log holds some thousand samples: others follow it in the midst of a run."""
    twins = Twins(tmp_path, copies="copies = { count = 12, columns = 4, spacing_m = [5.0, 5.0] }")
    logs = set()
    for _ in range(6):
        twins.step(240)
        logs.add(id(twins.other.sensor_arrays.log))
        kept = twins.other.sensor_arrays.log
        assert kept is not None
    assert len(logs) > 1
    assert twins.ticks > 1300


def test_commands_watchdogs_and_switches(twins: Twins) -> None:
    u = (0.3, 0.3, -0.3, -0.3, 0.1, 0.1, 0.1, 0.1)
    twins.step(50)
    twins.do(lambda world: world.command("rov/thrusters", u=u))
    twins.step(33)
    twins.do(lambda world: world.call("rov/thrusters/set", timeout_s=0.25))
    twins.do(lambda world: world.command("rov/thrusters", u=u))
    twins.step(200)
    assert twins.other.actuators["rov/thrusters"].timeouts == 1
    twins.do(lambda world: world.call("rov/imu/set", rate_hz=60))
    twins.do(lambda world: world.call("rov/leak/deactivate"))
    twins.step(200)
    twins.do(lambda world: world.call("rov/leak/activate"))
    twins.do(fly)
    twins.do(lambda world: world.call("rov/thrusters/deactivate"))
    twins.step(200)
    assert twins.ticks > 500


def test_a_reset_a_restore_and_a_load(twins: Twins) -> None:
    twins.step(107)
    states = [snapshots.take(world) for world in (twins.one, twins.other)]
    assert states[0] == states[1]
    twins.step(150)
    for world, state in zip((twins.one, twins.other), states, strict=True):
        snapshots.restore(world, state)
    assert twins.other.tick == 107
    twins.step(90)
    twins.do(lambda world: world.submit(Call("world/reset", {})))
    twins.step(250)
    assert twins.other.tick == 249 + 1
    assert twins.ticks > 500


def test_what_is_on_its_way_in_a_state_comes_in_its_time(tmp_path: Path) -> None:
    """When the next one would have come in the state that was left does not count: here it is far later."""
    twins = Twins(tmp_path, rate=480)
    twins.do(lambda world: world.call("rov/imu/deactivate"))
    twins.step(482)
    states = [snapshots.take(world) for world in (twins.one, twins.other)]
    twins.step(53)
    for world, state in zip((twins.one, twins.other), states, strict=True):
        snapshots.restore(world, state)
    for _ in range(10):
        twins.step(1)
    assert twins.ticks > 500


@pytest.mark.parametrize("seed", [1, 2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, *range(3, 12)))])
def test_whatever_happens(tmp_path: Path, seed: int) -> None:
    """Commands, modes, missions, switches, rates, faults, bodies, states and readers, at any time and in any order."""
    rng = np.random.default_rng(seed)
    copies = ["", "copies = { count = 3, columns = 3, spacing_m = [0.8, 0.9] }"][seed % 2]
    twins = Twins(tmp_path, copies=copies, depth=[5.0, 19.6][seed // 2 % 2], rate=[240, 480][seed % 2], last=LATE_DEPTH)
    (first, *_), saved, name = twins.one.vehicles, [snapshots.take(w) for w in (twins.one, twins.other)], "f"

    def restore(_: World) -> None:
        for world, state in zip((twins.one, twins.other), saved, strict=True):
            snapshots.restore(world, state)

    happens: list[Callable[[World, Any], object]] = [
        lambda world, r: world.call(f"{first}/autopilot/arm"),
        lambda world, r: world.call(f"{first}/autopilot/set_mode", mode=["manual", "depth_hold", "stabilise"][r[0] % 3]),
        lambda world, r: world.command(f"{first}/thrusters", u=[(each % 200) / 100 - 1 for each in r[:8]]),
        lambda world, r: world.call(f"{first}/{SENSORS[r[0] % 5]}/set", rate_hz=[2, 5, 10, 60][r[1] % 4]),
        lambda world, r: world.call(f"{first}/{SENSORS[r[0] % 5]}/{['activate', 'deactivate'][r[1] % 2]}"),
        lambda world, r: world.call(f"{first}/thrusters/set", timeout_s=[0.02, 0.1, 1.0][r[0] % 3]),
        lambda world, r: world.call(
            "world/set_fault", name=name, kind=["sensor_silent", "sensor_frozen"][r[0] % 2],
            target=f"{first}/{['imu', 'dvl', 'autopilot/state'][r[1] % 3]}", parameters={},
        ),
        lambda world, r: world.call("world/clear_fault", name=name),
        lambda world, r: world.call("world/spawn", name=f"s{r[0]}", like=first, p_NB=[r[1] % 9, r[2] % 9, 2 + r[3] % 15]),
        lambda world, r: world.call("world/remove", name=[*world.vehicles][-1]) if len(world.vehicles) > 1 else None,
        lambda world, r: world.subscribe([None, (), {f"{first}/imu", f"{first}/depth"}][r[0] % 3]),
        lambda world, r: world.subscribe({f"{first}/imu"}, {f"{first}/imu": [Decimation(10.0, 0)]}),
        lambda world, r: restore(world) if world is twins.other else None,
    ]  # fmt: skip

    def answer(world: World, act: Callable[[World, Any], object], r: list[int]) -> object:
        try:
            return act(world, r)
        except Refused as refused:
            return str(refused)

    for _ in range(60):
        act, r = happens[int(rng.integers(len(happens)))], rng.integers(1000, size=8).tolist()
        twins.do(lambda world, act=act, r=r: answer(world, act, r))  # type: ignore[misc]
        twins.step(int(rng.integers(1, 90)))
    assert twins.ticks > 300


SENSORS = ("imu", "dvl", "echosounder", "leak", "autopilot/state")


def test_vehicles_that_come_and_go(twins: Twins) -> None:
    twins.step(60)
    before = twins.ticks
    twins.do(lambda world: world.call("world/spawn", name="two", like="rov", p_NB=[4.0, 0.0, 6.0]))
    twins.step(120)
    twins.do(lambda world: world.call("world/remove", name="two"))
    twins.step(120)
    assert twins.ticks > before + 200


@pytest.mark.parametrize("kind", ["silent", "frozen"])
def test_faults_of_sensors(twins: Twins, kind: str) -> None:
    twins.step(300)
    names = {"imu": "rov/imu", "state": "rov/autopilot/state"}
    for name, target in names.items():
        fault = {"name": name, "kind": f"sensor_{kind}", "target": target, "parameters": {}}
        twins.do(lambda world, fault=fault: world.call("world/set_fault", **fault))  # type: ignore[misc]
    twins.do(lambda world: world.call("rov/autopilot/set_mode", mode="depth_hold"))
    twins.step(300)
    told = twins.other.read("rov/autopilot/state")
    assert told is not None
    assert told.mode != "depth_hold", "nobody was told of it"
    for name in names:
        twins.do(lambda world, name=name: world.call("world/clear_fault", name=name))  # type: ignore[misc]
    twins.step(300)
    assert twins.ticks > 600


def test_a_body_that_diverges_is_named_with_its_tick(twins: Twins) -> None:
    twins.step(30)
    for world in (twins.one, twins.other):
        world.hydro.external[0] = np.inf
    with pytest.raises(Diverged) as one:
        twins.one.advance()
    with pytest.raises(Diverged) as other:
        twins.other.step(50)
    assert str(one.value) == str(other.value)
    assert twins.one.tick == twins.other.tick == 31


def test_samples_of_the_ticks_before_are_not_lost_with_it(tmp_path: Path) -> None:
    """It flies away, and so fast after some ticks that it cannot be."""
    twins = Twins(tmp_path)
    twins.step(30)
    for world in (twins.one, twins.other):
        world.hydro.bodies["weight"][0] *= -1e5
    fallen = []
    for step in (twins.one.advance, lambda: twins.other.advance(most=100)):
        samples: list[Sample] = []
        with pytest.raises(Diverged) as diverged:
            fall(step, samples)
        fallen.append(([*samples, *diverged.value.output.samples], str(diverged.value)))
    assert fallen[0] == fallen[1]
    assert diverged.value.output.samples, "the last ones came in one go"
    assert twins.other.tick == twins.one.tick > 33


def fall(step: Callable[[], Any], samples: list[Sample]) -> None:
    while True:
        samples += step().samples


SHIPPED = sorted(path.stem for path in Path(uwserver_scenarios.__file__).parent.glob("*.toml"))
UNLIKE = ("filter_review", "follow_the_pipe", "one_of_everything", "remus_survey", "slope", "swarm_100")
"""Those in which something is that is in no other of them; the others are alike."""


@pytest.mark.parametrize(
    "name", [name if name in UNLIKE else pytest.param(name, marks=pytest.mark.slow) for name in SHIPPED]
)
def test_every_world_that_ships_is_the_same(name: str) -> None:
    one, other = twice(name)
    samples = [sample for _ in range(150) for sample in one.advance().samples]
    assert _plain(other.step(150)) == _plain(samples)
    assert one.call("world/state_hash") == other.call("world/state_hash")
    for world in (one, other):
        world.end("it was enough")


def _plain(samples: list[Sample]) -> list[tuple[str, int, int, int, str]]:
    """As texts: pictures are equal where their bytes are."""
    return [(s.port, s.seq, s.t_ns, s.t_sent_ns, repr(s.value)) for s in samples]


# -- where steps stop ------------------------------------------------------------------------------------------------------------------


def test_ticks_that_are_measured_are_made_one_by_one_and_watchdogs_have_theirs(twins: Twins) -> None:
    world = twins.other
    world.step(3)
    world.submit(Command("rov/thrusters", ((0.0,) * 8,), "me"))
    world.watch(Profile(perf_counter_ns))
    assert world.advance(most=5).ticks == 1
    world.watch(None)
    world.step(9)
    commanded = world.tick
    world.actuators["rov/thrusters"].set_timeout(3)
    world.command("rov/thrusters", u=(0.1,) * 8)
    world.step(1)
    assert world.advance(most=50).tick == commanded + 3, "up to where a watchdog may expire"
    assert [event.event for event in world.advance(most=50).events] == ["watchdog"]


def test_kinds_read_in_the_order_in_which_the_first_of_each_is_due(tmp_path: Path) -> None:
    """Also where several intervals end in one tick: what one of them changes, as a battery the voltage, others see or do not see."""
    world = Twins(tmp_path).other
    tick = 120  # all are due
    world.step(tick)
    rows, timetable = world.stepping.given.rows, world.stepping.given.timetable
    turns = rows["turn"][: int(rows["run"]["kinds"][0])].tolist()
    read = [(timetable.kernels[kind], rows["turns"][first : first + count]) for kind, first, count in turns]
    slots = [slot for group in world.sensing.groups if tick % group.divisor == 0 for slot in group.slots]
    kernels = [slot.sensor.kernel for slot in slots if isinstance(slot.sensor, CompiledSensor)]
    assert [id(kernel) for kernel, _ in read] == list(dict.fromkeys(map(id, kernels)))
    for kernel, due in read:
        of_kind = [s.head for s in slots if isinstance(s.sensor, CompiledSensor) and s.sensor.kernel is kernel]
        assert due.tolist() == of_kind


def test_a_force_that_a_part_gives_is_given_once_a_tick(twins: Twins) -> None:
    """Behind the autopilots, before the bodies move; where nothing is due, no step stops for it."""
    twins.step(10)

    class Push(Part):
        path, state_type, next_tick = "world/push", State, 12

        def __init__(self, world: World) -> None:
            self.world, self.ticks = world, list[int]()

        def before(self, tick: int, t_ns: int) -> None:
            self.ticks.append(tick)
            self.world.hydro.external[0, 2] += 50.0
            self.next_tick = None if tick >= 20 else tick + 2

        def save(self) -> State:
            return State()

        def load(self, state: Any) -> None: ...

    pushes = [Push(world) for world in (twins.one, twins.other)]
    for push in pushes:
        push.world.add(push)
    twins.step(40)
    assert pushes[0].ticks == pushes[1].ticks == [12, 14, 16, 18, 20]
    assert twins.stops == {"forces": 5}


@pytest.mark.parametrize("name", ["slope", "push_the_crate", "pool_inspection"])
def test_contacts_and_rays_need_no_python(name: str) -> None:
    """Of bodies at rest on a mesh, of one that is pushed, and of walls."""
    world = build(load(name, adapters=installed_adapters()))
    world.subscribe(())
    world.step(480)
    assert not any(world.stops.values())


def test_python_looks_for_contacts_where_an_engine_has_to_be_asked(tmp_path: Path) -> None:
    """Bodies within each other are pushed apart by the shortest way out, which an engine tells."""
    copies = "copies = { count = 2, columns = 2, spacing_m = [0.05, 0.05] }"
    twins = Twins(tmp_path, copies=copies)
    twins.step(60)
    assert twins.stops["contacts"] > 0
    assert set(twins.stops) == {"contacts"}


def test_python_looks_for_contacts_where_there_are_more_than_there_is_room_for(tmp_path: Path) -> None:
    """Once: then there is."""
    twins = Twins(tmp_path, copies="copies = { count = 24, columns = 6, spacing_m = [2.0, 2.0] }", depth=19.88)
    twins.step(3)
    assert len(twins.one.hydro.touched.impulse) > ROOM
    assert twins.stops == {"contacts": 1}


@pytest.mark.parametrize(
    "more",
    [
        '[environment.waves]\nspectrum = "jonswap"\nsignificant_height_m = 0.5\npeak_period_s = 5.0\n',
        '[environment.currents.eddies]\nkind = "gauss_markov"\nsigma_ned_mps = [0.05, 0.05, 0.01]\ntau_s = 60.0\n',
    ],
)
def test_a_sea_needs_python_where_a_current_is_drawn_anew(tmp_path: Path, more: str) -> None:
    """Every 0.6 s; waves never."""
    twins = Twins(tmp_path, more=more)
    twins.step(300)
    assert twins.stops == ({} if "waves" in more else {"drifting currents": 2})


# -- the loop that has the interpreter meanwhile ---------------------------------------------------------------------------------------


def test_a_step_in_a_server_ends_for_the_samples_to_be_handed_over(tmp_path: Path) -> None:
    """After so many ticks that they take about as long however many bodies there are."""
    twins = Twins(tmp_path, copies="copies = { count = 16, columns = 4, spacing_m = [5.0, 5.0] }")
    world = twins.other
    world.subscribe(())
    world.step(240)
    assert world.advance(most=1000, posted=rows.NOTHING_POSTED).tick == 240 + 5120 // 16
    assert world.advance(most=7, posted=rows.NOTHING_POSTED).tick == 240 + 5120 // 16 + 7


def test_what_was_posted_before_a_step_ends_it_after_one_tick(twins: Twins) -> None:
    twins.other.step(2)
    assert twins.other.advance(most=1000, posted=np.ones(1, np.int64)).tick == 3


def test_what_another_thread_posts_ends_a_step(tmp_path: Path) -> None:
    """Long before its last tick: who has asked waits for the present tick alone."""
    twins = Twins(tmp_path, copies="copies = { count = 32, columns = 8, spacing_m = [5.0, 5.0] }")
    world, wake = twins.other, Wake()
    world.subscribe(())
    world.step(240)
    for turn in range(100):  # until the other thread has come in time, on a machine with other work
        before = world.tick
        wake.clear()
        timer = threading.Timer(0.0001 * (turn % 8), wake.set)
        timer.start()
        world.advance(most=1000, posted=wake.posted)
        timer.join()
        done = world.tick - before
        if 0 < done < 80:
            break
    assert 0 < done < 80, "half as many as a step makes that nothing ends"


def test_other_threads_run_python_while_a_step_goes_on(tmp_path: Path) -> None:
    """A step releases the interpreter lock: a thread that needs it for each of its turns makes many of them meanwhile."""
    twins = Twins(tmp_path, copies="copies = { count = 64, columns = 8, spacing_m = [5.0, 5.0] }")
    world, turns = twins.other, 0
    world.subscribe(())
    world.step(240)
    wake = Wake()

    def count() -> None:
        nonlocal turns
        while turns < 1000:
            turns += 1
        wake.set()

    interval, steps = sys.getswitchinterval(), 0
    sys.setswitchinterval(60.0)  # no thread is made to give the lock away
    thread = threading.Thread(target=count)
    try:
        thread.start()
        while not turns and steps < 100:
            world.advance(most=1000, posted=wake.posted)
            steps += 1
        assert turns, "the thread has never run"
    finally:
        sys.setswitchinterval(interval)
        thread.join()


def test_who_is_alone_makes_many_ticks_in_one_go(tmp_path: Path) -> None:
    """Nobody waits for their end; of many bodies there are fewer, as who breaks off a program waits."""
    twins = Twins(tmp_path, copies="copies = { count = 16, columns = 4, spacing_m = [5.0, 5.0] }")
    world = twins.other
    world.subscribe(())
    world.step(240)
    assert world.advance(most=2000).tick == 240 + LONGEST
