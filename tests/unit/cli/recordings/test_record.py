"""`uwserver record` against a server that the test plays: what is written, lost connections, refusals, and how it ends."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader

from uwserver.cli.recordings import record as record_module
from uwserver.cli.recordings.plot import plot
from uwserver.cli.recordings.record import Attached, Failed, record
from uwserver.ports import Field, Port
from uwserver.recording.format import EVENTS
from uwserver.recording.player.chunks import NotOurs
from uwserver.recording.player.track import Track
from uwserver.recording.reading import NotReplayable, Reading, head_record
from uwserver.recording.replay import replay
from uwserver.recording.writer import RecordingWriter

DEPTH = Port(
    "rov/depth",
    "sensor",
    "pressure",
    (Field("depth", "m", "below"), Field("p_N", "m", "place", "N", (3,))),
    "Depth.",
    10.0,
)
ARM = Port("rov/arm", "sensor", "arm", (Field("angle", "rad", "of it"),), "Arm.", 10.0)


def line(**message: Any) -> bytes:
    return json.dumps({"jsonrpc": "2.0", **message}).encode() + b"\n"


def sample(seq: int, t_ns: int, port: str = "rov/depth", **value: Any) -> bytes:
    value = value or {"depth": float(seq), "p_N": [1.0, None, 3.0]}
    return line(
        method="sample",
        params={"port": port, "seq": seq, "t_ns": t_ns, "t_sent_ns": t_ns + 5, "valid": True, "value": value},
    )


def event(kind: str) -> bytes:
    return line(method="event", params={"event": kind, "tick": 1, "t_ns": 10, "text": kind})


Talk = Callable[[asyncio.StreamWriter], Awaitable[None]]


class Played:
    """A server: answers `hello` and `describe`, and then says what each connection in turn is to hear."""

    def __init__(self, *talks: Talk, ports: tuple[Port, ...] = (DEPTH,)) -> None:
        self.talks, self.ports = list(talks), ports
        self.asked: list[dict[str, Any]] = []

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        talk = self.talks.pop(0)
        while asked := await reader.readline():
            message = json.loads(asked)
            self.asked.append(message)
            if message["method"] == "describe":
                ports = [msgspec.to_builtins(port) for port in self.ports]
                result: Any = {"server": {}, "world": {"scenario": "tank"}, "ports": ports, "services": []}
            else:
                result = {}
            writer.write(line(id=message["id"], result=result))
            if message["method"] == "subscribe":
                await talk(writer)
                break
        with_rest = await reader.read()  # until the other side has closed
        self.asked += [json.loads(each) for each in with_rest.splitlines()]
        writer.close()


def recorded(out: Path, played: Played, patterns: tuple[str, ...] = ("**",)) -> tuple[Attached, str]:
    async def work() -> tuple[Attached, str]:
        server = await asyncio.start_server(played.serve, "127.0.0.1", 0)
        async with server:
            attached = Attached(server.sockets[0].getsockname()[:2], out, patterns, "sesame")
            try:
                why = await asyncio.wait_for(attached.run(), 20.0)
            except BaseException:
                attached.give_up()
                raise
            attached.finish()
            return attached, why

    return asyncio.run(work())


def bodies(path: Path, topic: str) -> list[Any]:
    with path.open("rb") as file:
        return [json.loads(m.data) for _, _, m in make_reader(file).iter_messages(topics=[topic], log_time_order=False)]


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record_module, "FIRST_BACKOFF_S", 0.01)


def say(*lines: bytes, ends: bool = False) -> Talk:
    async def talk(writer: asyncio.StreamWriter) -> None:
        for each in lines:
            writer.write(each)
        await writer.drain()
        if ends:
            writer.close()

    return talk


def test_samples_and_events_are_written_as_they_were_served(tmp_path: Path):
    played = Played(say(sample(0, 10), sample(1, 20), event("paused"), event("shutdown")))
    attached, why = recorded(tmp_path / "a.mcap", played, ("rov/*", "x/*"))
    assert (attached.samples, attached.lost, why) == (2, 0, "the server has shut down")
    assert bodies(tmp_path / "a.mcap", "rov/depth")[1] == {
        "seq": 1, "t_ns": 20, "t_sent_ns": 25, "valid": True, "value": {"depth": 1.0, "p_N": [1.0, None, 3.0]},
    }  # fmt: skip
    assert [each["event"] for each in bodies(tmp_path / "a.mcap", EVENTS)] == ["paused", "shutdown"]
    assert [each["method"] for each in played.asked] == ["hello", "describe", "subscribe", "subscribe"]
    assert played.asked[0]["params"]["token"] == "sesame"
    assert [each["params"]["pattern"] for each in played.asked[2:]] == ["rov/*", "x/*"]
    head = head_record(tmp_path / "a.mcap")
    assert json.loads(head["describe"])["ports"][0]["path"] == "rov/depth"


def test_it_cannot_be_replayed_and_says_so(tmp_path: Path):
    recorded(tmp_path / "a.mcap", Played(say(sample(0, 10), event("shutdown"))))
    with pytest.raises(NotReplayable, match="`uwserver record` recorded it from outside"):
        replay(tmp_path / "a.mcap")


def test_it_has_a_report_of_its_ports_alone(tmp_path: Path):
    recorded(tmp_path / "a.mcap", Played(say(sample(0, 10), sample(1, 10**9), event("shutdown"))))
    done = CliRunner().invoke(plot, [str(tmp_path / "a.mcap")])
    assert done.exit_code == 0, done.output
    assert "its scenario is not in the file" in done.output
    assert "2 on 1 ports" in (tmp_path / "a.html").read_text(encoding="utf-8")


def test_it_is_no_recording_of_a_world_and_says_so(tmp_path: Path):
    recorded(tmp_path / "a.mcap", Played(say(sample(0, 10), event("shutdown"))))
    with pytest.raises(NotOurs, match=r"`uwserver record` took it .* `uwserver play` reads it as a log"):
        Track(tmp_path / "a.mcap")


def test_a_lost_connection_is_made_again_and_what_was_missed_is_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    played = Played(say(sample(0, 10), sample(1, 20), ends=True), say(sample(5, 60), event("shutdown")))
    attached, _ = recorded(tmp_path / "a.mcap", played)
    assert (attached.samples, attached.lost) == (3, 3)
    assert [each["seq"] for each in bodies(tmp_path / "a.mcap", "rov/depth")] == [0, 1, 5]
    assert "is lost: trying again" in capsys.readouterr().err


def test_another_run_is_not_mixed_in(tmp_path: Path):
    played = Played(say(sample(900, 90 * 10**9), ends=True), say(sample(0, 0)))
    attached, why = recorded(tmp_path / "a.mcap", played)
    assert attached.samples == 1
    assert "another run" in why


def test_ports_that_come_later_are_described_and_nothing_of_them_is_lost(tmp_path: Path):
    played = Played()

    async def talk(writer: asyncio.StreamWriter) -> None:
        writer.write(sample(0, 10) + sample(0, 20, "rov/arm", angle=0.5) + event("ports_changed"))
        ports = [msgspec.to_builtins(port) for port in (DEPTH, ARM)]
        writer.write(line(id="describe", result={"world": {"scenario": "tank"}, "ports": ports}))
        writer.write(sample(1, 30, "rov/arm", angle=0.6) + event("shutdown"))

    played.talks.append(talk)
    attached, _ = recorded(tmp_path / "a.mcap", played)
    assert (attached.samples, attached.lost) == (3, 0)
    assert [each["value"] for each in bodies(tmp_path / "a.mcap", "rov/arm")] == [{"angle": 0.5}, {"angle": 0.6}]


def test_a_recorder_that_is_killed_leaves_a_readable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """What stands in the file while it is written is whole up to its last chunk."""
    monkeypatch.setattr(record_module, "FLUSH_S", 0.02)
    path, copy = tmp_path / "a.mcap", tmp_path / "killed.mcap"

    async def talk(writer: asyncio.StreamWriter) -> None:
        before = path.stat().st_size
        writer.write(sample(0, 10) + sample(1, 20))
        while path.stat().st_size == before:
            await asyncio.sleep(0.005)
        copy.write_bytes(path.read_bytes())
        writer.write(event("shutdown"))

    recorded(path, Played(talk))
    with Reading(copy) as reading:
        assert [json.loads(message.data)["seq"] for _, message in reading.messages({"rov/depth": None})] == [0, 1]
        assert reading.truncated


def test_a_full_disk_ends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RecordingWriter, "sample", full)
    with pytest.raises(OSError, match="No space left"):
        recorded(tmp_path / "a.mcap", Played(say(sample(0, 10))))


@pytest.mark.parametrize(
    ("told", "text"),
    [
        (line(id="hello", error={"code": -32000, "message": "show a token", "data": {}}), "hello: show a token"),
        (b"220 smtp.example.org\n", "an answer that cannot be read"),
        (b"3\n", "an answer that cannot be read"),
        (line(method="sample", params={}), "an answer that cannot be read"),
    ],
)
def test_a_server_that_refuses_or_is_none_is_told(tmp_path: Path, told: bytes, text: str):
    with pytest.raises(Failed, match=text):
        recorded(tmp_path / "a.mcap", Played(say(told)))


@pytest.mark.parametrize("told", [[], [line(id="subscribe", result={}), sample(0, 10)]])
def test_ports_that_are_refused_leave_no_file(tmp_path: Path, told: list[bytes]):
    refusal = line(id="subscribe", error={"code": -32001, "message": "no port x/*", "data": {}})

    async def answers(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        await reader.readline()
        described = {"server": {}, "world": {"scenario": "tank"}, "ports": [msgspec.to_builtins(DEPTH)], "services": []}
        writer.writelines([line(id="hello", result={}), line(id="describe", result=described), *told, refusal])
        await reader.read()
        writer.close()

    played = Played()
    played.serve = answers  # type: ignore[method-assign]
    with pytest.raises(Failed, match="no port x"):
        recorded(tmp_path / "a.mcap", played, ("rov/*", "x/*"))
    assert not list(tmp_path.iterdir())


def test_a_fault_after_the_server_agreed_keeps_what_was_recorded(tmp_path: Path):
    with pytest.raises(Failed):
        recorded(tmp_path / "a.mcap", Played(say(sample(0, 10), b"3\n")))
    assert (tmp_path / "a.mcap").stat().st_size > 0


def test_the_command_line(tmp_path: Path):
    out = str(tmp_path / "a.mcap")
    for args, text in (
        (("nowhere", out), "is no HOST:PORT"),
        (("1", "2", "3"), "and one file"),
        (("127.0.0.1:1", out), "no server answers at 127.0.0.1:1"),
    ):
        done = CliRunner().invoke(record, args)
        assert done.exit_code != 0
        assert text in done.output
    assert not (tmp_path / "a.mcap").exists()


def test_an_old_file_is_not_overwritten(tmp_path: Path):
    (tmp_path / "a.mcap").write_text("dive")
    with pytest.raises(FileExistsError, match="exists already"):
        recorded(tmp_path / "a.mcap", Played(say(sample(0, 10))))
    assert (tmp_path / "a.mcap").read_text() == "dive"


@pytest.mark.parametrize("later", range(6))
def test_an_end_that_comes_together_with_data_is_not_lost(later: int, tmp_path: Path) -> None:
    """With `--seconds 2` it sometimes went on for ever."""

    async def scene() -> None:
        attached, reader = Attached(("127.0.0.1", 1), tmp_path / "x.mcap", ("**",), ""), asyncio.StreamReader()

        async def listen() -> None:
            while await attached._chunk(reader):
                pass

        task = asyncio.ensure_future(listen())
        await asyncio.sleep(0.01)
        reader.feed_data(b"x")
        for _ in range(later):
            await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait({task}, timeout=1.0)
        assert task.cancelled()

    asyncio.run(scene())
