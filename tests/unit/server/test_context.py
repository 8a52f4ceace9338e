"""What an adapter sees of a running server: what it may serve, who answers what, and calls that end whatever waits for the next tick."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Iterator

import pytest
from msgspec.structs import replace
from simulation_rig import PATIENCE_S, Rig, profiling_of, running

from uwserver.adapter import AdapterStats, Conversation, installed_adapters
from uwserver.ports import Call, Command, Event, Refused, Reply, Sample
from uwserver.ports.checks import bind
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.scene.scenery import Scenery
from uwserver.server import context as module
from uwserver.server.context import Context, Hub
from uwserver.server.state_files import StateFiles
from uwserver.simulation.clock import Timing
from uwserver.world.world import World

GOTO = {"position_ned_m": [90.0, 0.0, 3.0], "radius_m": 0.5}


def hub_of(rig: Rig) -> Hub:
    files = StateFiles(None, rig.simulation, rig.mailbox, lambda function: function())
    ended: list[str] = []
    return Hub(
        "pool",
        rig.simulation,
        rig.bus,
        rig.mailbox,
        ended.append,
        lambda: {"ended": list(ended)},
        files,
        profiling_of(rig),
        Scenery(rig.resolved, rig.world),
    )


class Heard:
    """Takes in answers, samples and events."""

    def __init__(self) -> None:
        self.answers: queue.Queue[Reply] = queue.Queue()
        self.samples: list[Sample] = []
        self.events: list[Event] = []

    def __call__(self, answer: object) -> None:
        if isinstance(answer, Reply):
            self.answers.put(answer)

    def put_samples(self, samples: list[Sample]) -> None:
        self.samples += samples

    def put_event(self, event: Event) -> None:
        self.events.append(event)

    def reply(self) -> Reply:
        return self.answers.get(timeout=PATIENCE_S)


class Notes:
    """An observer that keeps what was carried out."""

    def __init__(self) -> None:
        self.items: list[Command | Call] = []

    @classmethod
    def of(cls, rig: Rig) -> list[Command | Call]:
        notes = cls()
        rig.simulation.observe(notes)
        return notes.items

    def requested(self, item: Command | Call, tick: int, batch: int) -> None:
        self.items.append(item)

    def ticked(self, world: World) -> None: ...

    def next_tick(self, tick: int) -> int:
        return tick + 1


@pytest.fixture
def still(resolved: Resolved) -> Iterator[Rig]:
    with running(resolved, Timing(paused=True)) as rig:
        yield rig


def test_ground_truth_is_only_for_who_may_tell_it(still: Rig) -> None:
    hub = hub_of(still)
    open_, plain = Context(hub, "tool", True), Context(hub, "robot", False)
    everything, robots = Heard(), Heard()
    open_.attach(everything)
    detach = plain.attach(robots)
    still.call("world/step", n=24)
    still.call("world/step", n=1)  # its answer comes behind all samples of the ticks before
    hidden = [path for path in open_.ports if "/truth/" in path]
    assert hidden
    assert set(open_.ports) - set(plain.ports) == set(hidden)
    assert {sample.port for sample in everything.samples} - {sample.port for sample in robots.samples} <= set(hidden)
    assert any(sample.port in hidden for sample in everything.samples)
    assert not any(sample.port in hidden for sample in robots.samples)
    assert plain.last(hidden[0]) is None
    assert open_.last(hidden[0]) is not None
    assert [p["path"] for p in plain.describe("**/truth/**")["ports"]] == []
    with pytest.raises(Refused, match="no port"):
        plain.command(hidden[0], {}, "", None)
    detach()
    before = len(robots.samples)
    still.call("world/step", n=24)
    still.call("world/step", n=1)
    assert len(robots.samples) == before


def test_ground_truth_is_not_even_made_for_who_may_not_tell_it(still: Rig) -> None:
    still.subscriptions = ()
    context, other = Context(hub_of(still), "robot", False), Context(hub_of(still), "tool", True)
    heard = Heard()
    leave = context.attach(heard)  # it does not say what it wants, so it wants all that it may see
    wanted = [path in still.bus.subscriptions for path in still.world.ports if "/truth/" not in path]
    truth = [path for path in still.world.ports if "/truth/" in path]
    assert all(wanted)
    assert truth
    assert not any(path in still.bus.subscriptions for path in truth)
    heard.subscriptions = ("rov/imu", truth[0])
    context.subscriptions_changed()
    assert [path for path in still.world.ports if path in still.bus.subscriptions] == ["rov/imu"]
    leave()
    other.attach(heard)
    assert {path for path in still.world.ports if path in still.bus.subscriptions} == set(heard.subscriptions)


def test_what_nobody_reads_can_be_asked_for_and_no_truth_of_who_may_not_tell_it(still: Rig) -> None:
    still.subscriptions = ()
    hub = hub_of(still)
    still.bus.subscriptions_changed()
    still.call("world/step", n=48)
    told: queue.Queue[list[Sample]] = queue.Queue()
    for truth, ports in ((False, {"rov/depth"}), (True, {"rov/depth", "rov/truth/pose"})):
        context = Context(hub, "robot", truth)
        context.read(["rov/depth", "rov/truth/pose", "rov/thrusters", "no/port"], told.put)
        samples = told.get(timeout=PATIENCE_S)
        assert {sample.port for sample in samples} == ports
        assert all(sample == still.world.read(sample.port) for sample in samples)
        assert context.last("rov/depth") is None, "it is not kept"


def test_a_driver_is_heard_from_its_first_tick_until_it_leaves(resolved: Resolved) -> None:
    class Mute:
        subscriptions = ("rov/depth", "rov/truth/pose")

        def order(self, wait_s: float) -> None: ...

        answer = refuse = order

    with running(resolved, Timing(mode="lockstep", lockstep_clients=("fcu",))) as rig:
        rig.subscriptions = ()
        context = Context(hub_of(rig), "fcu", False)
        end = context.drive("fcu", Mute(), lambda reply: None)
        assert "rov/depth" in rig.bus.subscriptions
        assert "rov/truth/pose" not in rig.bus.subscriptions
        with pytest.raises(Refused):
            context.drive("fcu", Mute(), lambda reply: None)
        end()
        assert "rov/depth" not in rig.bus.subscriptions


def test_ports_are_those_of_the_samples_that_come(still: Rig) -> None:
    """The world is ahead of the loop: what an adapter opens by them reads the samples that still wait, and is told of others before theirs."""
    context = Context(hub_of(still), "robot", False)
    still.call("world/step", n=24)
    before = context.ports["rov/imu"]
    still.world.ports = {**still.world.ports, "rov/imu": replace(before, fields=before.fields[1:])}
    assert context.ports["rov/imu"] == before
    still.call("world/step", n=24)  # its answer comes with the ports
    assert context.ports["rov/imu"].fields == before.fields[1:]


def test_stats_of_an_adapter_outlive_a_restart(still: Rig) -> None:
    hub = hub_of(still)
    Context(hub, "robot", False).stats.restarts = 3
    assert Context(hub, "robot", False).stats.restarts == 3
    assert hub.stats == {"robot": AdapterStats(restarts=3)}


def test_what_a_port_looks_like_is_made_once(still: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a large world it would take longer than a tick may be kept waiting, however often somebody asks."""
    hub = hub_of(still)
    made: list[object] = []
    make = module.msgspec.to_builtins
    monkeypatch.setattr(module.msgspec, "to_builtins", lambda value: made.append(value) or make(value))
    context = Context(hub, "robot", False)
    described = context.describe("rov/**")
    assert made == []
    assert {entry["path"] for entry in described["ports"]} == {
        path for path in context.ports if path.startswith("rov/")
    }
    still.call("world/step", n=24)
    imu = still.world.ports["rov/imu"]
    for n in range(1000):
        faster = replace(imu, path=f"x/{n}", rate_hz=1.0 + n)
        assert hub.shown([faster]) == [make(faster)]
    assert len(hub._shown) <= 2 * (len(hub.ports) + len(context.services) + 1)


def test_who_answers_which_service(still: Rig) -> None:
    hub, heard = hub_of(still), Heard()
    context = Context(hub, "robot", False)

    def ask(service: str, **args: object) -> Reply:
        context.call(service, args, "7", heard)
        return heard.reply()

    assert ask("world/status").result == {"ended": []}
    described = ask("world/describe").result
    assert {entry["path"] for entry in described["services"]} == set(context.services)
    assert ask("world/step", n=3).tick == 3  # of the clock
    assert ask("world/state_hash").tick == 3  # of the world
    assert ask("world/shutdown").fault is None
    assert ask("world/status").result == {"ended": ["world/shutdown by robot:7"]}
    with pytest.raises(Refused, match="state_folder"):
        ask("world/save", name="mine")
    with pytest.raises(Refused, match=r'did you mean "world/pause"'):
        ask("world/paus")
    with pytest.raises(Refused, match="has no argument"):
        ask("world/step", m=3)


def test_a_conflict_that_an_adapter_sees_is_told_to_all(still: Rig) -> None:
    hub, heard = hub_of(still), Heard()
    Context(hub, "other", False).attach(heard)
    Context(hub, "sil", False).tell_conflict("two autopilots")
    still.call("world/step", n=1)
    assert [(event.event, event.text) for event in heard.events] == [("conflict", "sil: two autopilots")]


def test_a_command_says_who_sent_it(still: Rig) -> None:
    heard, context = Heard(), Context(hub_of(still), "robot", False)
    posted = Notes.of(still)
    context.command("rov/thrusters", {"u": [0.1] * 8}, "7", heard)
    assert heard.reply().fault is None
    assert [(item.port, item.source) for item in posted] == [("rov/thrusters", "robot:7")]
    with pytest.raises(Refused, match="u"):
        context.command("rov/thrusters", {"u": [2.0] * 8}, "7", heard)


class Held:
    """The simulation thread waits, as in a very long tick, until it is let go."""

    def __init__(self, rig: Rig) -> None:
        self._gate, reached = threading.Event(), threading.Event()
        rig.simulation.steer(lambda: (reached.set(), self._gate.wait(PATIENCE_S)))
        assert reached.wait(PATIENCE_S)

    def let_go(self) -> None:
        self._gate.set()


class Loop(Rig):
    """A rig whose loop the test plays itself: what the world says is delivered while it waits for an answer, and not beside it."""

    def start(self) -> None:
        self._thread.start()

    def end(self) -> None:
        self.simulation.stop()
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()

    def reply(self, heard: Heard) -> Reply:
        while heard.answers.empty():
            work = self._work.get(timeout=PATIENCE_S)
            assert work is not None
            work()
        return heard.answers.get()

    def second(self) -> None:
        """A second of simulation time; its samples are delivered."""
        for ticks in (int(self.world.rate_hz) - 1, 1):  # samples of a tick come behind its answers
            heard = Heard()
            self.simulation.call("world/step", {"n": ticks}, "", heard)
            assert self.reply(heard).fault is None


def bound_for(context: Context) -> object:
    """Where the autopilot wants to be, m north, as it says itself."""
    sample = context.last("rov/autopilot/state")
    assert sample is not None
    place = sample.value[bind(sample.port, context.ports[sample.port].fields, "p_ref_N")[0]]
    assert isinstance(place, tuple)
    return place[0]


@pytest.fixture
def piloted() -> Iterator[Loop]:
    """A paused world with an autopilot that knows where it is, and is armed."""
    rig = Loop(load("rov_autopilot", adapters=installed_adapters()), Timing(paused=True))
    rig.start()
    try:
        for _ in range(3):
            rig.second()
        heard = Heard()
        rig.mailbox.post(Call("rov/autopilot/arm", {"force": True}), heard)
        assert rig.reply(heard).fault is None
        yield rig
    finally:
        rig.end()


def fill(rig: Rig) -> None:
    """Post as much as there is room for, a crowd and the peers alike."""
    for source in ("crowd1", "crowd2", "crowd3", "crowd4", "robots:1", "robots:2"):
        with contextlib.suppress(Refused):
            while True:
                rig.mailbox.post(Call("world/faults", {}, source), None)


def test_who_leaves_while_too_much_waits_leaves_nothing_behind(piloted: Loop) -> None:
    """A peer with a goto, a run, a command and a subscription goes while no more can be posted: all of it ends, others are served in the tick in
    which they would have been, and what it is still answered reaches nobody."""
    rig = piloted
    context, leaver, other = Context(hub_of(rig), "robots", False), Heard(), Heard()
    detach = context.attach(leaver)
    gone, stays = Conversation(context, "1"), Conversation(context, "2")
    gone.call("rov/autopilot/goto", GOTO, leaver, key="goto")
    stays.call("world/state_hash", {}, other)
    assert rig.reply(other).fault is None  # it was carried out behind the goto
    rig.second()
    assert bound_for(context) == pytest.approx(90.0)
    leaver.samples.clear()
    tick = rig.world.tick
    held = Held(rig)
    gone.call("world/run_until", {"t_s": 3600.0}, leaver, key="run")
    gone.command("rov/autopilot/depth", {"depth": 3.0}, leaver)
    stays.call("world/state_hash", {}, other)
    fill(rig)
    with pytest.raises(Refused, match="wait for their tick"):
        stays.command("rov/autopilot/depth", {"depth": 2.0}, other)
    detach()
    gone.close()
    held.let_go()
    assert rig.reply(other).tick == tick
    rig.second()  # the run of the one who left has ended: it keeps nobody from stepping
    assert bound_for(context) == pytest.approx(0.0, abs=5.0), "the goto has ended, and the vehicle holds where it is"
    assert (gone.in_flight.count, gone.is_running("goto"), gone.is_running("run"), stays.in_flight.count) == (
        0,
        False,
        False,
        0,
    )
    assert leaver.answers.empty()
    assert leaver.samples == []


def test_peers_that_share_a_source_take_turns(piloted: Loop) -> None:
    """All ground stations are one commander; still, who floods keeps only itself waiting."""
    context, flood, other = Context(hub_of(piloted), "mavlink", False), Heard(), Heard()
    held, carried_out = Held(piloted), Notes.of(piloted)
    many, one = (Conversation(context, "ground station", queue=queue) for queue in ("1", "2"))
    for _ in range(1000):
        many.call("world/faults", {}, flood)
    for _ in range(2):
        one.call("world/state_hash", {}, other)
    held.let_go()
    assert piloted.reply(other).fault is None
    paths = [item.service for item in carried_out if isinstance(item, Call)]
    assert paths[:4] == ["world/faults", "world/state_hash"] * 2
    assert {item.source for item in carried_out} == {"mavlink:ground station"}


def test_one_cancel_for_each_call_goes_past_a_full_mailbox(piloted: Loop) -> None:
    heard, context = Heard(), Context(hub_of(piloted), "robots", False)
    held, carried_out = Held(piloted), Notes.of(piloted)
    cancel = context.call("rov/autopilot/goto", GOTO, "1", heard)
    fill(piloted)
    assert all(cancel() for _ in range(1000)), "it is still under way"
    held.let_go()
    answer = piloted.reply(heard).fault
    assert answer is not None
    assert answer.code == "preempted", answer.text
    assert not cancel(), "it is over"
    of_the_client = [item.service for item in carried_out if item.source == "robots:1"]
    assert (of_the_client[0], of_the_client[-1]) == ("rov/autopilot/goto", "rov/autopilot/cancel_goto"), "in its order"
    assert of_the_client.count("rov/autopilot/cancel_goto") == 1


def test_a_client_is_there_until_it_leaves(resolved: Resolved) -> None:
    timing = Timing(mode="lockstep", lockstep_clients=("a", "b"), lockstep_timeout_s=0.0)
    with running(resolved, timing) as rig:
        context, barrier = Context(hub_of(rig), "robots", False), rig.simulation.lockstep.barrier
        assert context.world.mode == "lockstep"
        leave = context.join("a")
        assert barrier.absent() == ["b"]
        leave()
        assert barrier.absent() == ["a", "b"]


def test_who_stops_a_vehicle_does_not_wait_until_a_crowd_has_been_served(piloted: Loop) -> None:
    heard, context = Heard(), Context(hub_of(piloted), "robots", False)
    held, carried_out = Held(piloted), Notes.of(piloted)
    fill(piloted)
    context.call("rov/thrusters/deactivate", {}, "3", heard)
    context.call("rov/autopilot/disarm", {}, "4", heard)
    held.let_go()
    assert piloted.reply(heard).fault is None
    assert piloted.reply(heard).fault is None
    assert [item.source for item in carried_out[:2]] == ["robots:4", "robots:3"]


def test_a_stop_overtakes_what_its_own_client_asked_and_nothing_of_that_moves_the_vehicle_afterwards(
    piloted: Loop,
) -> None:
    context, held, carried_out = Context(hub_of(piloted), "robots", False), Held(piloted), Notes.of(piloted)
    older, stop, later = Heard(), Heard(), Heard()
    context.command("rov/thrusters", {"u": [1.0] * 8}, "1", older)
    context.call("rov/autopilot/arm", {"force": True}, "1 (name)", older)
    for _ in range(20):
        context.call("world/state_hash", {}, "1", later)
    context.call("rov/autopilot/disarm", {}, "1 (name)", stop)
    context.command("rov/thrusters", {"u": [0.1] * 8}, "1", later)
    held.let_go()
    faults = [piloted.reply(older).fault for _ in range(2)]
    assert [fault and fault.code for fault in faults] == ["preempted"] * 2
    assert piloted.reply(stop).fault is None
    for _ in range(21):
        assert piloted.reply(later).fault is None
    services = [item.service if isinstance(item, Call) else item.value for item in carried_out]
    assert services[0] == "rov/autopilot/disarm"
    assert "rov/autopilot/arm" not in services
    assert services[-1] == ((0.1,) * 8,), "what was sent after the stop acts"
    assert len(services) == 22


def test_where_nobody_waits_for_the_wall_clock_a_stop_keeps_the_order_of_its_client(resolved: Resolved) -> None:
    with running(resolved, Timing(mode="lockstep", lockstep_clients=("a",), lockstep_timeout_s=0.0)) as rig:
        context, heard = Context(hub_of(rig), "robots", False), Heard()
        held, carried_out = Held(rig), Notes.of(rig)
        context.command("rov/thrusters", {"u": [1.0] * 8}, "1", heard)
        context.call("rov/thrusters/deactivate", {}, "1", heard)
        held.let_go()
        assert [heard.reply().fault for _ in range(2)] == [None, None]
        assert isinstance(carried_out[0], Command)


def test_the_names_are_whole_while_a_tick_fills_them_anew(still: Rig) -> None:
    hub = hub_of(still)
    context = Context(hub, "tool", True)
    before = context.world.vehicles, context.describe("**")["world"]
    assert before[0]
    still.world.vehicles.clear()  # as in `World.bind`, which fills them again
    assert (context.world.vehicles, context.describe("**")["world"]) == before
