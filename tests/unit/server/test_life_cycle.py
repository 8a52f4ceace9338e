"""Life cycle inside one process: supervision of adapters, health, orderly end. Adapters of the test, through the real loader."""

from __future__ import annotations

import asyncio
import itertools
import threading
from dataclasses import replace
from typing import ClassVar

import msgspec
import pytest

from uwserver.adapter import AdapterNotFound, AdapterTable
from uwserver.ports import Event, Refused, Reply
from uwserver.server import adapters as adapters_module
from uwserver.server.adapters import StartFailed
from uwserver.server.life_cycle import Options, Server
from uwserver.simulation.thread import Timing

PATIENCE_S = 120


class TestAdapter:
    """Fails as its scenario tells it to; keeps what it saw."""

    __test__ = False
    instances: ClassVar[list[TestAdapter]] = []

    class Config(AdapterTable, tag="test", frozen=True, kw_only=True):
        fail_first: int = 0
        fail_always: bool = False
        die_after_start: bool = False
        hang: bool = False

    def __init__(self, config, context) -> None:
        self.config, self.context = config, context
        self.events: list[Event] = []
        self.samples = 0
        TestAdapter.instances.append(self)

    def put_samples(self, samples) -> None:
        self.samples += len(samples)

    def put_event(self, event) -> None:
        self.events.append(event)

    async def run(self, ready: asyncio.Event) -> None:
        if self.config.hang:
            await asyncio.sleep(3600)
        if self.config.fail_always or len(TestAdapter.instances) <= self.config.fail_first:
            raise OSError("port 1 is taken")
        detach = self.context.attach(self)
        try:
            ready.set()
            await asyncio.sleep(0.05)
            if self.config.die_after_start and len(TestAdapter.instances) == 1:
                raise ValueError("lost its peer")
            await asyncio.sleep(3600)
        finally:
            detach()


@pytest.fixture(autouse=True)
def _loader(monkeypatch):
    TestAdapter.instances = []
    monkeypatch.setattr(adapters_module, "load_adapter", lambda kind: TestAdapter)
    monkeypatch.setattr(adapters_module, "_FIRST_BACKOFF_S", 0.01)


def with_adapter(resolved, **config):
    table = TestAdapter.Config(**config)
    return replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, adapters={"it": table}))


def serve(resolved, script, options: Options | None = None) -> int:
    """Run a server; `script(server)` runs beside it and the server ends after it."""

    async def life() -> int:
        server = Server(resolved, options or Options())

        async def beside() -> None:
            try:
                await script(server)
            finally:
                server.shutdown("the test is over")

        task = asyncio.create_task(beside())
        async with asyncio.timeout(PATIENCE_S):
            status = await server.run()
            await task
        return status

    status = asyncio.run(life())
    assert "simulation" not in [t.name for t in threading.enumerate()]
    return status


async def until(condition) -> None:
    while not condition():
        await asyncio.sleep(0.01)


def test_an_adapter_that_fails_later_is_reported_and_started_again(resolved):
    async def script(server):
        await until(lambda: len(TestAdapter.instances) == 2 and TestAdapter.instances[1].samples > 10)
        stats = server.hub.stats["it"]
        assert stats.restarts == 1
        assert stats.state == "running"
        assert "lost its peer" in stats.last_error
        assert server.hub.simulation.world.tick > 0

    assert serve(with_adapter(resolved, die_after_start=True), script) == 0


def test_an_adapter_knows_the_facts_of_its_world(resolved):
    async def script(server):
        await until(lambda: TestAdapter.instances)
        (adapter,) = TestAdapter.instances
        facts, world = adapter.context.world, server.hub.simulation.world
        described = adapter.context.describe("nothing")
        assert facts.server == described["server"]["name"]
        assert facts.scenario == described["world"]["scenario"]
        assert facts.rate_hz == described["world"]["rate_hz"]
        assert facts.epoch_utc == described["world"]["epoch_utc"]
        assert [vehicle.name for vehicle in facts.vehicles] == described["world"]["vehicles"]
        assert facts.vehicles[0].model == next(iter(world.vehicles.values())).model != ""
        assert (facts.mode, facts.speed) == ("realtime", 3.0)
        server.hub.simulation.pace.speed = 2.0
        assert adapter.context.world.speed == 2.0, "they are those of the moment"

    assert serve(with_adapter(resolved), script, Options(timing=Timing(speed=3.0))) == 0


def test_a_required_adapter_that_cannot_start_ends_the_server_with_the_reason(resolved):
    async def script(server):
        await until(lambda: server.hub.stats["it"].restarts)

    with pytest.raises(StartFailed, match='"it" did not start: port 1 is taken'):
        serve(with_adapter(resolved, fail_always=True), script)


def test_an_adapter_that_cannot_be_loaded_is_told_like_any_other_failure(resolved, monkeypatch):
    def absent(kind):
        raise AdapterNotFound("its module is broken")

    async def script(server):
        await until(lambda: server.hub.stats["it"].restarts > 1)
        assert server.hub.stats["it"].last_error == "its module is broken"

    monkeypatch.setattr(adapters_module, "load_adapter", absent)
    with pytest.raises(StartFailed, match='"it" did not start: its module is broken'):
        serve(with_adapter(resolved), script)
    assert serve(with_adapter(resolved, required=False), script) == 0


def test_one_that_is_not_required_is_tried_again_while_the_world_runs(resolved):
    async def script(server):
        await until(lambda: server.hub.stats["it"].state == "running")
        assert server.hub.stats["it"].restarts == 2

    assert serve(with_adapter(resolved, fail_first=2, required=False), script) == 0


def test_one_that_nobody_needs_tells_the_same_failure_once(resolved, caplog):
    async def script(server):
        await until(lambda: server.hub.stats["it"].restarts >= 3)

    assert serve(with_adapter(resolved, fail_always=True, required=False), script) == 0
    assert sum("port 1 is taken" in record.message for record in caplog.records) == 1


def test_the_address_that_is_said_first_is_waited_for_but_not_for_ever(resolved):
    async def script(server):
        await until(lambda: said)

    for table, state in (({}, "running"), ({"fail_always": True}, "retrying")):
        said = []

        def announce(addresses, said=said):
            said.append(TestAdapter.instances[-1].context.stats.state)

        options = Options(shown="it", announce=announce)
        assert serve(with_adapter(resolved, required=False, **table), script, options) == 0
        assert said == [state]


def test_events_of_an_adapter_failure_and_of_the_end_reach_the_others(resolved):
    async def script(server):
        await until(lambda: len(TestAdapter.instances) == 2 and TestAdapter.instances[1].samples > 0)

    serve(with_adapter(resolved, die_after_start=True), script)
    assert [e.event for e in TestAdapter.instances[1].events][-1] == "shutdown"


def test_a_context_without_truth_has_none_of_it(resolved):
    async def script(server):
        await until(lambda: TestAdapter.instances and TestAdapter.instances[0].samples > 100)
        context = TestAdapter.instances[0].context
        assert not [p for p in context.ports if "/truth/" in p]
        assert not [s for s in context.services if "/truth/" in s]
        assert "truth" not in str(context.describe())
        assert context.last("rov/truth/pose") is None
        with pytest.raises(Refused, match="no port"):
            context.command("rov/truth/pose", {"p_NB": [0, 0, 0]}, "me", None)

    serve(with_adapter(resolved), script)


def test_a_context_with_truth_has_it(resolved):
    async def script(server):
        await until(lambda: TestAdapter.instances and TestAdapter.instances[0].context.last("rov/truth/pose"))

    serve(with_adapter(resolved, truth=True), script)


def test_status_and_describe_answer_at_once(resolved):
    async def script(server):
        await until(lambda: TestAdapter.instances and TestAdapter.instances[0].samples > 0)
        context, answers = TestAdapter.instances[0].context, []
        context.call("world/status", {}, "me", answers.append)
        context.call("world/describe", {}, "me", answers.append)
        status, description = (a.result for a in answers)
        assert status["scenario"] == "scenario"
        assert status["adapters"]["it"]["state"] == "running"
        assert status["recorder"] is None
        assert msgspec.json.decode(msgspec.json.encode(status))["mode"] == "realtime"
        assert {p["path"] for p in description["ports"]} == set(context.ports)
        paths = {s["path"] for s in description["services"]}
        assert {"world/status", "world/step", "world/reset", "rov/imu/set"} <= paths

    serve(with_adapter(resolved), script)


def test_shutdown_is_answered_first(resolved):
    answers: list[Reply] = []

    async def script(server):
        await until(lambda: TestAdapter.instances and TestAdapter.instances[0].samples > 0)
        TestAdapter.instances[0].context.call("world/shutdown", {}, "me", answers.append)
        await asyncio.sleep(3600)

    async def life() -> int:
        server = Server(with_adapter(resolved), Options())
        task = asyncio.create_task(script(server))
        async with asyncio.timeout(PATIENCE_S):
            status = await server.run()
        task.cancel()
        return status

    assert asyncio.run(life()) == 0
    assert answers[0].fault is None


def test_until_ends_at_that_time(resolved):
    async def life() -> tuple[int, int]:
        server = Server(resolved, Options(timing=Timing(mode="freerun"), until_s=1.0))
        async with asyncio.timeout(PATIENCE_S):
            return await server.run(), server.hub.simulation.world.tick

    status, tick = asyncio.run(life())
    assert status == 0
    assert tick == 240


def test_a_world_that_diverges_stays_for_questions_and_the_exit_status_tells(resolved):
    async def script(server):
        simulation = server.hub.simulation
        await until(lambda: simulation.world.tick > 0)
        simulation.steer(lambda: simulation.world.hydro.state.__setitem__((0, 7), float("nan")))
        await until(lambda: simulation.failure)
        assert '"rov" diverged' in server.hub.status()["failure"]

    assert serve(resolved, script) == 1


def test_a_server_whose_task_is_cancelled_leaves_no_simulation_behind(resolved):
    async def life() -> None:
        server = Server(with_adapter(resolved), Options())
        task = asyncio.create_task(server.run())
        await until(lambda: server.hub.simulation.world.tick > 0)
        task.cancel()
        await asyncio.wait([task], timeout=PATIENCE_S)
        assert task.cancelled()

    asyncio.run(life())
    assert "simulation" not in [t.name for t in threading.enumerate()]


def test_a_pause_does_not_end_a_server_with_an_end(resolved):
    async def script(server):
        replies: list[Reply] = []
        await until(lambda: server.hub.simulation.world.tick > 0)
        for service in ("world/pause", "world/reset", "world/resume"):
            context = TestAdapter.instances[0].context
            context.call(service, {}, "me", replies.append)
        await until(lambda: len(replies) == 3)
        await until(lambda: server.hub.simulation.world.tick >= 480)

    assert serve(with_adapter(resolved), script, Options(until_s=2.0, timing=Timing(speed=100.0))) == 0


async def nothing(server) -> None:
    await asyncio.sleep(3600)


def test_an_adapter_that_waits_for_something_outside_is_named_when_nothing_proceeds(resolved, monkeypatch):
    monkeypatch.setattr(adapters_module, "START_TIMEOUT_S", 0.0)
    monkeypatch.setattr(adapters_module, "processor_ns", lambda: 0)
    with pytest.raises(StartFailed, match='adapter "it" did not start: no answer, and no work in this process'):
        serve(with_adapter(resolved, hang=True), nothing)


def test_a_slow_start_is_waited_for_as_long_as_this_process_works(resolved, monkeypatch):
    """A machine so busy that no wall time is enough."""
    work = itertools.count(0, adapters_module.START_WORK_NS)
    monkeypatch.setattr(adapters_module, "START_TIMEOUT_S", 0.0)
    monkeypatch.setattr(adapters_module, "_POLL_S", 0.001)
    monkeypatch.setattr(adapters_module, "processor_ns", lambda: next(work))

    async def slow_run(self, ready: asyncio.Event) -> None:
        while next(work) < 100 * adapters_module.START_WORK_NS:
            await asyncio.sleep(0.001)
        ready.set()
        await asyncio.sleep(3600)

    async def script(server) -> None:
        await until(lambda: server.hub.simulation.world.tick > 0)

    monkeypatch.setattr(TestAdapter, "run", slow_run)
    assert serve(with_adapter(resolved), script) == 0


def test_a_server_that_is_told_to_end_while_it_starts_ends(resolved):
    async def script(server) -> None:
        await until(lambda: TestAdapter.instances)

    assert serve(with_adapter(resolved, hang=True), script) == 0


def test_a_run_tells_what_its_ticks_take_meanwhile_and_at_the_end(resolved):
    told: list[str] = []

    async def script(server):
        await until(lambda: len(told) >= 2)

    assert serve(resolved, script, Options(profile_s=0.02, tell=told.append)) == 0
    assert all(table.startswith("profile") for table in told[:-1])
    assert told[-1].startswith("the whole run: profile of ")
    assert "\nphysics " in told[-1]
