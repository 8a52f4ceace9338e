"""Recordings that clients begin and end: they replay bit for bit, reach no other folder, and end in order whatever ends them."""

from __future__ import annotations

import asyncio
import json
import shutil
import threading
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader

from uwserver.ports import Event, Refused, Reply, Sample
from uwserver.recording.reading import Reading
from uwserver.recording.recorder import Recorder
from uwserver.recording.replay import replay
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.load.tables import Server as ServerTable
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.server import recordings as module
from uwserver.server.context import Context
from uwserver.server.life_cycle import Options, Server
from uwserver.simulation.clock import Timing

PATIENCE_S = 60
FREE, STILL = Timing("freerun"), Timing("freerun", paused=True)


@pytest.fixture(scope="module")
def resolved() -> Resolved:
    vehicle = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 2.0))
    return load(Scenario(schema=1, seed=3, vehicles={"rov": vehicle}, server=ServerTable(metrics=False)), adapters={})


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the server is started."""
    monkeypatch.chdir(tmp_path)
    return tmp_path / "recordings"


class Client:
    """Asks a server in the same process, and keeps what is told."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self.context = Context(server.hub, "test", True)
        self.samples: list[Sample] = []
        self.events: list[Event] = []
        self.context.attach(self)

    def put_samples(self, samples: Any) -> None:
        self.samples += samples

    def put_event(self, event: Event) -> None:
        self.events.append(event)

    async def ask(self, service: str, **args: object) -> Any:
        """The result of a call. Raises Refused."""
        done: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()

        def answered(answer: object) -> None:
            if isinstance(answer, Reply) and not done.done():
                done.set_result(answer)

        self.context.call(service, args, "me", answered)
        reply = await done
        if reply.fault is not None:
            raise Refused(reply.fault.code, reply.fault.text, reply.fault.where)
        return reply.result

    async def reach(self, tick: int) -> None:
        """Wait until the world is at a tick."""
        await until(lambda: self.server.hub.simulation.world.tick >= tick)

    async def pass_ticks(self, ticks: int) -> None:
        """Let the world make some more ticks."""
        await self.reach(self.server.hub.simulation.world.tick + ticks)

    def told(self) -> list[str]:
        """Of recordings."""
        return [event.text for event in self.events if event.event == "recording"]


async def until(condition: Callable[[], object]) -> None:
    while not condition():
        await asyncio.sleep(0.01)


def serve(
    resolved: Resolved, script: Callable[[Client], Awaitable[None]], timing: Timing = FREE, **options: Any
) -> tuple[int, Server]:
    """Run a server beside a script, which ends it."""

    async def life() -> tuple[int, Server]:
        server = Server(resolved, Options(timing=timing, **options))

        async def beside() -> None:
            try:
                await script(Client(server))
            finally:
                server.shutdown("the test is over")

        task = asyncio.create_task(beside())
        async with asyncio.timeout(PATIENCE_S):
            status = await server.run()
            await task
        return status, server

    found = asyncio.run(life())
    assert "recorder" not in [thread.name for thread in threading.enumerate()]
    return found


def served_with(resolved: Resolved, **server: object) -> Resolved:
    table = msgspec.structs.replace(resolved.scenario.server, **server)
    return replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, server=table))


def samples_in(path: Path) -> list[tuple[str, int, int]]:
    """Port, number and time of each sample in a file."""
    with path.open("rb") as file:
        return [
            (channel.topic, json.loads(message.data)["seq"], message.publish_time)
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
            if channel.message_encoding == "json" and b'"seq"' in message.data[:8]
        ]


def test_a_recording_from_the_midst_of_a_run_replays_bit_for_bit(resolved: Resolved, folder: Path) -> None:
    thrust = {"u": [0.3, -0.2, 0.1, 0.4, -0.3, 0.2, 0.5, -0.1]}

    async def script(client: Client) -> None:
        client.context.command("rov/thrusters", thrust, "me", None)
        await client.reach(500)
        began = await client.ask("recording/start", name="dive")
        assert began["name"] == "dive.mcap"
        assert began["t_ns"] >= client.server.hub.simulation.world.ticks.time_of(500)
        await client.pass_ticks(300)
        client.context.command("rov/thrusters", {"u": [-u for u in thrust["u"]]}, "me", None)
        await client.pass_ticks(600)  # from here on: the command is carried out in one of them
        status = await client.ask("recording/stop")
        assert status["path"] == str(folder / "dive.mcap")
        assert (status["recording"], status["error"], status["dropped"]) == (False, "", 0)
        assert status["since_ns"] == began["t_ns"]
        assert status["bytes"] == (folder / "dive.mcap").stat().st_size
        heard = {(each.port, each.seq, each.t_ns) for each in client.samples}
        kept = samples_in(folder / "dive.mcap")
        assert status["samples"] == len(kept) == len(set(kept))
        assert set(kept) <= heard
        first, last = (end([t for port, _, t in kept if port == "rov/depth"]) for end in (min, max))
        assert {each for each in heard if each[0] == "rov/depth" and first <= each[2] <= last} <= set(kept)

    assert serve(resolved, script)[0] == 0
    found = replay(folder / "dive.mcap")
    assert found.difference is None
    assert not found.truncated
    assert found.ticks >= 900
    assert found.requests == 1
    assert found.hashes >= 4


def test_a_reset_and_bodies_that_came_before_are_in_it(resolved: Resolved, folder: Path) -> None:
    async def script(client: Client) -> None:
        await client.ask("world/spawn", name="second", like="rov", p_NB=[3.0, 0.0, 2.0])
        await client.reach(100)
        await client.ask("world/reset")
        await client.ask("world/spawn", name="third", like="rov", p_NB=[6.0, 0.0, 2.0])
        await client.ask("recording/start", name="one")
        await client.ask("world/remove", name="third")
        await client.pass_ticks(300)
        await client.ask("world/reset")
        await client.reach(260)
        await client.ask("recording/stop")

    serve(resolved, script)
    found = replay(folder / "one.mcap")
    assert found.difference is None
    assert found.requests == 2
    assert found.hashes >= 2


def test_a_paused_world_is_recorded_too_and_the_usual_name_tells_scenario_and_time(
    resolved: Resolved, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "utc_text", lambda: "20260131T235959Z")
    resolved = replace(resolved, name="../a pool")

    async def script(client: Client) -> None:
        for expected in ("a_pool-20260131T235959Z.mcap", "a_pool-20260131T235959Z-2.mcap"):
            assert (await client.ask("recording/start"))["name"] == expected
            await client.ask("world/step", n=5)
            await client.ask("recording/stop")
            assert replay(folder / expected).ticks == 5
        state = await client.ask("recording/state")
        assert [each["name"] for each in state["files"]] == sorted(path.name for path in folder.iterdir())
        assert state["folder"] == str(folder)
        assert state["bytes_left"] == 10_000_000_000 - sum(path.stat().st_size for path in folder.iterdir())
        assert state["recorder"] == (await client.ask("world/status"))["recorder"]
        with Reading(folder / "a_pool-20260131T235959Z-2.mcap") as reading:
            assert reading.state
        began, ended, *_ = client.told()
        assert "recording to" in began
        assert "asked for by test:me" in began
        assert "has ended: recording/stop by test:me" in ended

    serve(resolved, script, STILL)


@pytest.mark.parametrize(
    "name",
    ["../x", "/x", "a/b", "a\\b", "..", ".hidden", "-x", " ", "x" * 101, "x\n", "x\0", "ü", "a b", "~x", "$HOME"],
)
def test_a_name_leads_to_no_other_folder(resolved: Resolved, folder: Path, name: str) -> None:
    async def script(client: Client) -> None:
        with pytest.raises(Refused, match="cannot name a recording") as refused:
            await client.ask("recording/start", name=name)
        assert refused.value.fault.where == "name"

    serve(resolved, script, STILL)
    assert list(folder.parent.iterdir()) == []


def test_an_old_file_is_never_overwritten_nor_a_link_followed(resolved: Resolved, folder: Path) -> None:
    folder.mkdir()
    (folder / "old.mcap").write_text("precious")
    (folder.parent / "victim").write_text("mine")
    (folder / "link.mcap").symlink_to(folder.parent / "victim")
    (folder / "nowhere.mcap").symlink_to(folder.parent / "new")

    async def script(client: Client) -> None:
        for name in ("old", "old.mcap", "link", "nowhere"):
            with pytest.raises(Refused, match="there already") as refused:
                await client.ask("recording/start", name=name)
            assert refused.value.fault.where == "name"

    serve(resolved, script, STILL)
    assert (folder / "old.mcap").read_text() == "precious"
    assert (folder.parent / "victim").read_text() == "mine"
    assert not (folder.parent / "new").exists()


def test_one_at_a_time_and_there_must_be_one_to_stop(resolved: Resolved) -> None:
    async def script(client: Client) -> None:
        with pytest.raises(Refused, match="nothing is being recorded"):
            await client.ask("recording/stop")
        both = await asyncio.gather(
            client.ask("recording/start", name="a"), client.ask("recording/start", name="b"), return_exceptions=True
        )
        assert both[0]["name"] == "a.mcap"
        assert isinstance(both[1], Refused)
        assert both[1].fault.code == "busy"
        assert (await client.ask("world/status"))["recorder"]["recording"] is True
        await client.ask("recording/stop")
        await client.ask("recording/start", name="b")

    serve(resolved, script, STILL)


def test_who_begins_and_ends_all_the_time_is_bounded(
    resolved: Resolved, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_WAITING", 8)

    async def script(client: Client) -> None:
        asked = [client.ask(f"recording/{'stop' if k % 2 else 'start'}") for k in range(3 * module.MAX_WAITING)]
        answers = await asyncio.gather(*asked, return_exceptions=True)
        refused = [each for each in answers if isinstance(each, Refused) and "wait to be answered" in each.fault.text]
        assert len(refused) == 2 * module.MAX_WAITING
        assert {each.fault.code for each in refused} == {"busy"}
        assert (await client.ask("recording/state"))["recorder"]["recording"] is False

    assert serve(resolved, script)[0] == 0
    assert len(list(folder.iterdir())) == module.MAX_WAITING // 2


def test_what_still_waits_at_the_end_makes_no_files(
    resolved: Resolved, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One may be just being made when the end comes: it is taken away again."""
    opened: list[bool] = []
    plain = Recorder.open

    async def script(client: Client) -> None:
        recordings = client.server.hub.recordings
        assert recordings is not None

        def counted(recorder: Recorder, timing: Timing) -> None:
            opened.append(recordings._is_over)
            plain(recorder, timing)

        monkeypatch.setattr(Recorder, "open", counted)
        for k in range(40):
            client.context.call(f"recording/{'stop' if k % 2 else 'start'}", {}, "me", lambda answer: None)

    assert serve(resolved, script)[0] == 0
    assert opened.count(True) <= 1
    assert len(list(folder.glob("*"))) <= opened.count(False)


def test_what_the_command_line_asked_for_is_not_ended_by_a_client(resolved: Resolved, tmp_path: Path) -> None:
    async def script(client: Client) -> None:
        with pytest.raises(Refused, match="ends with the server"):
            await client.ask("recording/start")
        with pytest.raises(Refused, match="command line"):
            await client.ask("recording/stop")

    status, server = serve(resolved, script, record=tmp_path / "run.mcap")
    assert status == 0
    assert server.hub.status()["recorder"]["path"] == str(tmp_path / "run.mcap")  # type: ignore[call-overload,index]
    assert replay(tmp_path / "run.mcap").difference is None


def test_the_end_of_the_server_closes_the_file(resolved: Resolved, folder: Path) -> None:
    async def script(client: Client) -> None:
        await client.reach(10)
        await client.ask("recording/start", name="run")
        await client.pass_ticks(300)

    assert serve(resolved, script)[0] == 0
    found = replay(folder / "run.mcap")
    assert (found.truncated, found.difference) == (False, None)


def test_a_run_to_its_end_time_closes_the_file_too(resolved: Resolved, folder: Path) -> None:
    async def script(client: Client) -> None:
        await client.ask("recording/start", name="run")
        await client.ask("world/resume")
        await asyncio.sleep(PATIENCE_S)

    async def life() -> int:
        server = Server(resolved, Options(timing=STILL, until_s=1.0))
        task = asyncio.create_task(script(Client(server)))
        async with asyncio.timeout(PATIENCE_S):
            status = await server.run()
        task.cancel()
        return status

    assert asyncio.run(life()) == 0
    found = replay(folder / "run.mcap")
    assert (found.truncated, found.difference, found.ticks) == (False, None, 240)


def test_nothing_is_recorded_where_the_scenario_says_so(resolved: Resolved, folder: Path) -> None:
    async def script(client: Client) -> None:
        with pytest.raises(Refused, match=r"set \[server\] recordings"):
            await client.ask("recording/start")
        assert (await client.ask("recording/state"))["folder"] is None
        assert (await client.ask("world/status"))["recorder"] is None

    serve(served_with(resolved, recordings=""), script, STILL)
    assert not folder.exists()


def test_a_full_folder_and_a_full_disk_are_told(
    resolved: Resolved, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def script(client: Client) -> None:
        await client.ask("recording/start", name="a")
        await client.ask("recording/stop")
        monkeypatch.setattr(module, "MAX_FILES", 1)
        with pytest.raises(Refused, match="at most 1 ") as refused:
            await client.ask("recording/start", name="b")
        assert refused.value.fault.code == "busy"
        monkeypatch.setattr(module, "MAX_FILES", 9)
        monkeypatch.setattr(module, "RESERVE_BYTES", 2**62)
        with pytest.raises(Refused, match="is full"):
            await client.ask("recording/start", name="b")

    serve(resolved, script, STILL)
    assert [path.name for path in folder.iterdir()] == ["a.mcap"]


def test_a_folder_that_cannot_be_made_is_told(resolved: Resolved, folder: Path) -> None:
    folder.write_text("a file")

    async def script(client: Client) -> None:
        with pytest.raises(Refused, match="nothing can be recorded to") as refused:
            await client.ask("recording/start")
        assert refused.value.fault.code == "denied"
        assert (await client.ask("world/status"))["recorder"] is None

    serve(resolved, script, STILL)


def test_a_recording_that_has_grown_to_the_limit_ends_whole(
    resolved: Resolved, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "POLL_S", 0.01)

    async def script(client: Client) -> None:
        await client.ask("recording/start", name="run")
        await until(lambda: len(client.told()) == 2)
        assert "1 MB together" in client.told()[1]
        status = (await client.ask("world/status"))["recorder"]
        assert (status["recording"], status["error"]) == (False, "")
        with pytest.raises(Refused, match="recordings_mb"):
            await client.ask("recording/start", name="more")

    serve(served_with(resolved, recordings_mb=1), script)
    found = replay(folder / "run.mcap")
    assert (found.truncated, found.difference) == (False, None)
    assert (folder / "run.mcap").stat().st_size >= 1_000_000


def test_a_disk_that_becomes_full_ends_the_recording_and_not_the_world(
    resolved: Resolved, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "POLL_S", 0.01)

    async def script(client: Client) -> None:
        await client.ask("recording/start", name="run")
        monkeypatch.setattr(module, "RESERVE_BYTES", 2**62)
        await until(lambda: len(client.told()) == 2)
        assert "the disk is full" in client.told()[1]
        await client.pass_ticks(10)

    assert serve(resolved, script)[0] == 0
    assert replay(folder / "run.mcap").truncated is False


def test_a_file_that_cannot_be_written_any_more_is_told_and_another_can_begin(
    resolved: Resolved, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "POLL_S", 0.01)

    async def script(client: Client) -> None:
        await client.ask("recording/start", name="run")
        with monkeypatch.context() as patch:
            patch.setattr("uwserver.recording.output.Output.flush", _full)
            await until(lambda: len(client.told()) == 2)
        assert "No space left" in client.told()[1]
        assert (await client.ask("world/status"))["recorder"]["error"] == "No space left on device"
        await client.ask("recording/start", name="next")
        await client.pass_ticks(10)

    assert serve(resolved, script)[0] == 0
    assert replay(folder / "next.mcap").difference is None


@pytest.mark.parametrize("is_watched", [True, False], ids=["while_it_goes_on", "at_its_end"])
def test_a_file_that_somebody_took_away_ends_the_recording_and_is_told(
    resolved: Resolved, folder: Path, monkeypatch: pytest.MonkeyPatch, is_watched: bool
) -> None:
    monkeypatch.setattr(module, "POLL_S", 0.01 if is_watched else 3600.0)

    async def script(client: Client) -> None:
        await client.ask("recording/start", name="run")
        (folder / "run.mcap").unlink()
        folder.rmdir()
        if not is_watched:
            assert "deleted" in (await client.ask("recording/stop"))["error"]
        await until(lambda: len(client.told()) == 2)
        assert "the file was moved or deleted" in client.told()[1]
        status = (await client.ask("world/status"))["recorder"]
        assert status["recording"] is False
        assert "deleted" in status["error"]
        await client.ask("recording/start", name="next")
        await client.pass_ticks(10)

    assert serve(resolved, script)[0] == 0
    assert replay(folder / "next.mcap").difference is None


def test_a_file_that_goes_while_the_folder_is_read_is_left_out(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir()
    (folder / "there.mcap").write_bytes(b"123")
    (folder / "gone.mcap").symlink_to(folder / "nowhere")
    monkeypatch.setattr(Path, "is_file", lambda path: True)  # as it was when it was asked
    assert module.sizes_in(folder) == {"there.mcap": 3}


def _full(_: object) -> None:
    raise OSError(28, "No space left on device")


def test_a_state_that_cannot_be_written_leaves_no_file_and_no_recording(
    resolved: Resolved, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_large(*_: object) -> bytes:
        raise Refused("too_large", "the state has too many bytes")

    async def script(client: Client) -> None:
        with monkeypatch.context() as patch:
            patch.setattr("uwserver.world.state.snapshot.to_bytes", too_large)
            with pytest.raises(Refused, match="too many bytes"):
                await client.ask("recording/start", name="run")
        assert list(folder.iterdir()) == []
        await client.ask("recording/start", name="run")
        await client.pass_ticks(10)

    assert serve(resolved, script)[0] == 0
    assert replay(folder / "run.mcap").difference is None


def test_a_world_that_has_diverged_is_not_recorded(resolved: Resolved) -> None:
    async def script(client: Client) -> None:
        assert client.server.live is not None
        client.server.live.failure = "the body rov has diverged"
        with pytest.raises(Refused, match="Call world/reset"):
            await client.ask("recording/start")

    serve(resolved, script, STILL)


def test_only_the_question_how_it_stands_is_for_pages_that_may_only_watch() -> None:
    assert [service.reads_only for service in module.SERVICES.values()] == [False, False, True]


def test_a_fault_of_ours_is_answered(resolved: Resolved, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("oh")

    monkeypatch.setattr(Recorder, "open", fails)

    async def script(client: Client) -> None:
        with pytest.raises(Refused, match="internal fault: oh"):
            await client.ask("recording/start")

    serve(resolved, script, STILL)


def test_a_fault_of_ours_as_it_begins_leaves_no_file_and_nobody_who_follows(
    resolved: Resolved, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The observer leaves on the simulation thread: another one could take it away in the midst of a tick."""
    threads: list[str] = []
    end = Recorder.end

    def ended(recorder: Recorder) -> None:
        if recorder._open:
            threads.append(threading.current_thread().name)
        end(recorder)

    def fails(*_: object) -> bytes:
        raise ZeroDivisionError("oh")

    monkeypatch.setattr(Recorder, "end", ended)

    async def script(client: Client) -> None:
        with monkeypatch.context() as patch:
            patch.setattr("uwserver.world.state.snapshot.to_bytes", fails)
            with pytest.raises(Refused, match="internal fault: oh"):
                await client.ask("recording/start", name="run")
        assert list(folder.iterdir()) == []
        assert threads == ["simulation"]
        await client.pass_ticks(10)

    assert serve(resolved, script)[0] == 0


def test_a_recording_whose_folder_has_gone_ends(
    resolved: Resolved, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody could say any more how full the disk is."""
    monkeypatch.setattr(module, "POLL_S", 0.01)

    async def script(client: Client) -> None:
        await client.ask("recording/start", name="run")
        shutil.rmtree(folder)
        await until(lambda: len(client.told()) == 2)
        assert client.told()[1].endswith("has ended: the file was moved or deleted")
        await client.ask("recording/start", name="run")

    assert serve(resolved, script)[0] == 0
    assert replay(folder / "run.mcap").difference is None
