"""A player by hand: what it says on the bus, how it is steered, and where it ends. Also of uwserver.recording.player.deck."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playback_rig import Deck, Dive, recorded

from uwserver.ports import Call, Command, Progress, Reply, Sample, SceneState
from uwserver.recording import writer as writer_module
from uwserver.recording.player.chunks import Chunks, NotPlayable
from uwserver.recording.player.track import Track
from uwserver.recording.player.world import SERVICES, Range, objection
from uwserver.simulation.clock import Timing
from uwserver.simulation.thread import CLOCK_SERVICES


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Dive]:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    return path, recorded(path)


@pytest.fixture
def deck(run: tuple[Path, Dive]) -> Iterator[Deck]:
    found = Deck(run[0])
    yield found
    found.close()


def test_all_samples_come_in_ticks_of_their_time_and_it_pauses_at_the_end(run: tuple[Path, Dive], deck: Deck) -> None:
    deck.play()
    assert deck.samples == run[1].samples[0]
    assert deck.player.world.t_ns == 2_000_000_000
    assert deck.player.world.tick == 480
    assert [event.event for event in deck.events] == ["watchdog", "paused"]
    assert "end" in deck.events[1].text


def test_real_time_is_kept(run: tuple[Path, Dive]) -> None:
    deck = Deck(run[0], Timing("realtime", 4.0))
    began = deck.time.now_ns()
    deck.play()
    assert abs((deck.time.now_ns() - began) - 500_000_000) < 10_000_000
    assert deck.samples == run[1].samples[0]
    deck.close()


def test_who_wants_one_port_gets_one_and_reads_the_others(run: tuple[Path, Dive]) -> None:
    deck = Deck(run[0])
    deck.subscriptions = ["rov/depth"]  # type: ignore[attr-defined]
    deck.bus.subscriptions_changed()
    deck.play()
    assert deck.samples == [s for s in run[1].samples[0] if s.port == "rov/depth"]
    found: list[Sample] = []
    deck.player.read(["rov/imu", "rov/nobody"], found.extend)
    deck.turn()
    assert found == [[s for s in run[1].samples[0] if s.port == "rov/imu"][-1]]
    deck.close()


def test_a_seek_tells_a_reset_and_then_the_last_of_each_port(run: tuple[Path, Dive], deck: Deck) -> None:
    deck.play()
    deck.samples.clear()
    deck.events.clear()
    assert deck.call("playback/seek", t_s=1.0).fault is None
    assert [(event.event, event.t_ns) for event in deck.events] == [("reset", 1_000_000_000)]
    before = {s.port: s for s in run[1].samples[0] if s.t_sent_ns <= 1_000_000_000}
    assert {s.port: s for s in deck.samples} == before
    assert len(deck.samples) == len(before)
    seen: list[SceneState] = []
    deck.player.request_scene_state(seen.append)
    deck.turn()
    assert 0.96e9 < seen[0].t_ns <= 1e9
    assert (seen[0].poses == run[1].poses[0, seen[0].t_ns]).all()
    deck.samples.clear()
    assert deck.call("world/resume").fault is None
    deck.play()
    assert deck.samples == [s for s in run[1].samples[0] if s.t_sent_ns > 1_000_000_000]


class Listener:
    """Who comes later."""

    def __init__(self, *ports: str) -> None:
        self.subscriptions, self.samples = list(ports), list[Sample]()

    def put_samples(self, samples: Sequence[Sample]) -> None:
        self.samples += [sample for sample in samples if sample.port in self.subscriptions]

    def put_event(self, event: object) -> None: ...


def test_who_comes_while_it_stands_gets_the_last_of_each_port_at_once(run: tuple[Path, Dive]) -> None:
    deck = Deck(run[0])
    deck.subscriptions = ["rov/depth"]  # type: ignore[attr-defined]
    deck.bus.subscriptions_changed()
    assert deck.call("playback/pause").fault is None
    assert deck.call("playback/seek", t_s=1.0).fault is None
    before = {s.port: s for s in run[1].samples[0] if s.t_sent_ns <= 1_000_000_000}
    late = Listener("rov/imu", "rov/depth")
    deck.bus.attach(late)
    deck.turn(2)
    assert {s.port: s for s in late.samples} == {port: before[port] for port in ("rov/imu", "rov/depth")}
    assert len(late.samples) == 2
    deck.bus.attach(later := Listener("rov/depth"))  # which somebody wants already
    deck.turn(2)
    assert later.samples == [before["rov/depth"]]
    late.samples.clear()
    deck.turn(3)
    assert not late.samples
    deck.close()


@pytest.mark.parametrize(
    ("service", "args", "code"),
    [
        ("playback/seek", {"t_s": 99.0}, "out_of_range"),
        ("playback/seek", {"t_s": 1.0, "run": 7}, "out_of_range"),
        ("playback/loop", {"from_s": 1.5, "to_s": 1.0}, "out_of_range"),
        ("world/step", {"n": 3}, "busy"),
        ("world/run_until_tick", {"tick": 0}, "out_of_range"),
    ],
)
def test_what_cannot_be_is_refused(deck: Deck, service: str, args: dict[str, Any], code: str) -> None:
    deck.turn(3)
    before = deck.player.world.t_ns
    fault = deck.call(service, **args).fault
    assert fault is not None
    assert fault.code == code
    assert deck.player.world.t_ns >= before


def test_readers_hear_that_time_was_set(run: tuple[Path, Dive]) -> None:
    """So that what was enough for them of other samples does not thin those that follow."""
    deck = Deck(run[0])
    deck.subscriptions = ["rov/depth"]  # type: ignore[attr-defined]
    deck.bus.subscriptions_changed()
    deck.turn(20)
    deck.call("playback/seek", t_s=1.0)
    assert deck.bus._jumps == 1
    deck.close()


def test_steps_go_both_ways(deck: Deck) -> None:
    deck.call("playback/pause")
    begin = deck.player.world.tick
    assert deck.call("world/step", n=24).tick == begin + 24
    assert deck.player.paused
    assert deck.player.world.tick == begin + 24
    deck.events.clear()
    assert deck.call("playback/step", n=-10).fault is None
    assert deck.player.world.tick == begin + 14
    assert [event.event for event in deck.events] == ["reset"]
    assert deck.call("world/run_until", t_s=1.0).t_ns == 1_000_000_000
    assert deck.player.world.tick == 240


def test_a_goal_beyond_the_end_is_told_there(deck: Deck) -> None:
    fault = deck.call("world/run_until", t_s=50.0).fault
    assert fault is not None
    assert fault.code == "preempted"
    assert deck.player.world.tick == 480


def test_a_range_is_played_again_and_again(run: tuple[Path, Dive]) -> None:
    deck = Deck(run[0], span=Range(0.5, 1.0, True))
    assert deck.player.world.t_ns == 500_000_000
    for _ in range(400):
        deck.turn()
    resets = [event for event in deck.events if event.event == "reset"]
    assert len(resets) >= 2
    assert {event.t_ns for event in resets} == {500_000_000}
    assert all(0.4e9 <= sample.t_sent_ns <= 1.0e9 for sample in deck.samples)
    deck.call("playback/loop", on=False)
    deck.play()
    assert deck.player.world.t_ns == 1_000_000_000
    deck.close()


def test_from_the_end_it_begins_anew(run: tuple[Path, Dive], deck: Deck) -> None:
    deck.play()
    deck.samples.clear()
    deck.call("playback/resume")
    deck.play()
    assert deck.samples == run[1].samples[0]
    assert [event.event for event in deck.events] == [
        "watchdog", "paused", "reset", "resumed", "watchdog", "paused"]  # fmt: skip


def test_speed_can_be_set_at_any_time(run: tuple[Path, Dive]) -> None:
    deck = Deck(run[0], Timing("realtime", 1.0))
    deck.turn(20)
    deck.call("world/set_speed", speed=10.0)
    assert (deck.player.timing.mode, deck.player.pace.speed) == ("realtime", 10.0)
    deck.call("playback/speed", speed=0.0)
    assert deck.player.timing.mode == "freerun"
    waits = len(deck.time.waits)
    deck.play()
    assert len(deck.time.waits) == waits
    deck.close()


def test_a_recorded_reset_is_told_where_it_was(tmp_path: Path) -> None:
    def script(dive: Dive) -> None:
        dive.go(100)
        dive.call("world/reset")
        dive.go(60)

    dive = recorded(tmp_path / "x.mcap", script=script)
    deck = Deck(tmp_path / "x.mcap")
    times: list[int] = []
    while not deck.player.paused:
        deck.turn()
        times.append(deck.player.world.t_ns)
    assert [event.event for event in deck.events] == ["reset", "paused"]
    assert deck.samples == [s for samples in dive.samples for s in samples]
    assert sum(later < earlier for earlier, later in itertools.pairwise(times)) == 1
    assert deck.player.world.tick == 60
    assert deck.call("playback/state").result["spans_s"][1][1] == pytest.approx(0.25, abs=0.01)  # type: ignore[index,call-overload]
    deck.close()


def test_whoever_comes_and_goes_changes_ports_and_services(tmp_path: Path) -> None:
    def script(dive: Dive) -> None:
        dive.go(48)
        dive.call("world/spawn", like="rov", name="guest", p_NB=[5.0, 0.0, 2.0])
        dive.go(48)
        dive.call("world/remove", name="guest")
        dive.go(48)

    dive = recorded(tmp_path / "x.mcap", script=script)
    deck = Deck(tmp_path / "x.mcap")
    seen = []
    while not deck.player.paused:
        deck.turn()
        seen.append(("guest" in deck.player.world.members, "guest/imu" in deck.player.world.ports))
    assert [pair for k, pair in enumerate(seen) if not k or pair != seen[k - 1]] == [
        (False, False), (True, True), (False, False)]  # fmt: skip
    assert deck.events[:-1] == dive.events
    assert [event.event for event in dive.events].count("ports_changed") >= 2
    assert any(sample.port == "guest/imu" for sample in deck.samples)
    deck.events.clear()
    deck.call("playback/seek", t_s=0.3)
    assert "guest" in deck.player.world.members
    assert [event.event for event in deck.events] == ["reset", "ports_changed"]
    deck.close()


def end_of_data(path: Path, back: int = 1) -> int:
    """Where the chunk ends that is so many from the last."""
    chunks = Chunks(path)
    chunk = chunks.chunks[-back]
    chunks.close()
    return chunk.offset + chunk.length


def test_a_file_that_grows_is_played_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer_module, "CHUNK_BYTES", 4000)
    dive, path = recorded(tmp_path / "whole.mcap"), tmp_path / "growing.mcap"
    whole = (tmp_path / "whole.mcap").read_bytes()
    path.write_bytes(whole[: end_of_data(tmp_path / "whole.mcap", 9)])
    deck = Deck(path)
    while deck.track.head_item is not None:
        deck.turn()
    deck.turn(5)
    count = len(deck.samples)
    assert 0 < count < len(dive.samples[0])
    assert not deck.player.paused, "more may come"
    with path.open("r+b") as file:
        file.write(whole)
    deck.play()
    assert deck.samples == dive.samples[0]
    deck.close()


def test_a_file_that_grows_no_more_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer_module, "CHUNK_BYTES", 4000)
    dive, whole = recorded(tmp_path / "whole.mcap"), tmp_path / "whole.mcap"
    (tmp_path / "cut.mcap").write_bytes(whole.read_bytes()[: end_of_data(whole)])
    deck = Deck(tmp_path / "cut.mcap")
    deck.play()
    assert deck.samples == dive.samples[0]
    deck.close()


def test_a_file_that_shrinks_stops_it_with_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer_module, "CHUNK_BYTES", 4000)
    whole = tmp_path / "whole.mcap"
    recorded(whole)
    (tmp_path / "x.mcap").write_bytes(whole.read_bytes()[: end_of_data(whole)])
    deck = Deck(tmp_path / "x.mcap")
    deck.turn(5)
    (tmp_path / "x.mcap").write_bytes(b"")
    fault = deck.call("playback/seek", t_s=1.0).fault
    assert fault is not None
    assert "shorter" in fault.text
    assert "shorter" in deck.player.failure
    assert deck.call("world/resume").fault is not None
    deck.close()


def test_flipped_bytes_never_do_more_than_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer_module, "CHUNK_BYTES", 4000)
    recorded(tmp_path / "x.mcap", ticks=120)
    whole, dice = (tmp_path / "x.mcap").read_bytes(), np.random.default_rng(7)
    begin, played = end_of_data(tmp_path / "x.mcap", 5), 0
    for _ in range(60):
        data = bytearray(whole)
        for _ in range(int(dice.integers(1, 4))):
            data[dice.integers(begin, len(data))] = dice.integers(256)
        (tmp_path / "y.mcap").write_bytes(data)
        try:
            deck = Deck(tmp_path / "y.mcap")
        except NotPlayable:
            continue
        for _ in range(400):
            deck.turn()
        times = [event.t_ns for event in deck.events]
        assert deck.player.failure == "" or "y.mcap" in deck.player.failure
        assert times == sorted(times) or any(event.event == "reset" for event in deck.events)
        played += 1
        deck.close()
    assert played > 20


def test_commands_and_calls_that_come_anyhow_are_refused(deck: Deck) -> None:
    answers: list[Reply | Progress] = []
    deck.mailbox.post(Command("rov/thrusters", ((0.0,) * 8,), "me"), answers.append)
    deck.mailbox.post(Call("world/reset", {}, "me"), answers.append)
    deck.turn()
    assert [answer.fault.code for answer in answers if isinstance(answer, Reply) and answer.fault] == ["denied"] * 2
    assert all("playback" in answer.fault.text for answer in answers if isinstance(answer, Reply) and answer.fault)


def test_only_what_steers_time_may_be_called() -> None:
    assert [objection(path) for path in SERVICES] == [None] * len(SERVICES)
    assert {service.path for service in CLOCK_SERVICES} <= SERVICES.keys()
    for path in ("world/reset", "world/spawn", "rov/thrusters", "rov/thrusters/get", "world/save"):
        fault = objection(path)
        assert fault is not None
        assert (fault.code, fault.where) == ("denied", path)
        assert fault.text.startswith("playback: ")


def test_ranges_that_are_not_there_are_told(run: tuple[Path, Dive]) -> None:
    track = Track(run[0])
    assert "the recording ends at" in Range(5.0).fault(track)
    assert "the range from 1.5 to 1 s is empty" in Range(1.5, 1.0).fault(track)
    assert Range(0.0, 50.0).fault(track) == ""
    track.close()


def test_cancelling_a_step_stops_it(run: tuple[Path, Dive]) -> None:
    deck = Deck(run[0], Timing("realtime", 1.0))
    answers: list[Reply | Progress] = []
    cancel = deck.player.call("world/run_until", {"t_s": 1.5}, "", answers.append)
    deck.turn(3)
    assert answers == []
    assert cancel()
    deck.turn()
    assert isinstance(answers[0], Reply)
    assert answers[0].fault is not None
    assert not cancel()
    deck.close()
