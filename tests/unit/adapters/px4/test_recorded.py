"""A real PX4, recorded by tests/integration/record_px4.py: what it says, and the same steps again."""

from __future__ import annotations

import contextlib
import gzip
import json
from pathlib import Path
from typing import Any

import pytest

mavlink = pytest.importorskip("pymavlink.dialects.v20.common", reason="pymavlink is not installed")

from px4_rig import STEP_NS, rig  # noqa: E402  # needs pymavlink
from uwserver_adapters.px4 import codec  # noqa: E402

from uwserver.adapter import Order  # noqa: E402

Bytes = list[tuple[str, bytes]]


def recordings() -> dict[str, Bytes]:
    """What PX4 said (">") and was told ("<"), by recording."""
    file = Path(__file__).parent / "recorded" / "px4.jsonl.gz"
    about, *lines = map(json.loads, gzip.decompress(file.read_bytes()).splitlines())
    assert about.startswith("PX4 ")
    found: dict[str, Bytes] = {}
    for line in lines:
        if isinstance(line, dict):
            part = found[line["recording"]] = []
        else:
            part.append((line[0], bytes.fromhex(line[1])))
    return found


RECORDINGS = recordings()


def told(part: Bytes) -> list[list[Any]]:
    """Messages to PX4, by piece; what is no message is an error."""
    parser = mavlink.MAVLink(None)
    return [parser.parse_buffer(data) or [] for way, data in part if way == "<"]


@pytest.mark.parametrize("name", RECORDINGS)
@pytest.mark.parametrize("size", [1, 7, 1 << 16])
def test_it_is_understood_whole_and_in_pieces(name: str, size: int) -> None:
    said = b"".join(data for way, data in RECORDINGS[name] if way == ">")
    reader = codec.Codec()
    events = [event for at in range(0, len(said), size) for event in reader.receive(said[at : at + size])]
    assert reader.bad == 0
    if name == "start":
        assert sorted(events, key=len) == [codec.Greeting(), codec.Interval(115, 0.005)]
        return
    assert len(events) >= 199
    for event in events:
        assert isinstance(event, codec.Controls)
        assert event.is_lockstep
        assert event.is_armed == (name == "steered")
        assert event.limited == 0


@pytest.mark.parametrize("name", ["locks", "steered"])
def test_each_of_its_samples_has_its_outputs(name: str) -> None:
    """That the lock-step may wait for outputs, armed or not, and knows them by their time."""
    reader, newest, answered = codec.Codec(), 0, set()
    samples = iter(told(RECORDINGS[name]))
    for way, data in RECORDINGS[name]:
        if way == "<":
            newest = next(message.time_usec for message in next(samples) if message.get_type() == "HIL_SENSOR")
            continue
        for event in reader.receive(data):
            assert isinstance(event, codec.Controls)
            assert event.t_us == newest or not newest
            assert event.t_us not in answered
            answered.add(event.t_us)
    assert max(answered) - min(answered) == 4000 * (len(answered) - 1), "none is left out"


@pytest.mark.parametrize("name", ["locks", "steered"])
def test_the_same_steps_again(name: str) -> None:
    """Its outputs are our commands, one step each, and it gets the samples that it got."""
    reader = codec.Codec()
    with rig() as r, contextlib.closing(r.connect()) as px4:
        stream = px4.stream
        assert r.order() is None, "it has not spoken"
        px4.greet()
        assert r.order() == Order(4, ())
        samples, wanted, outputs = iter(told(RECORDINGS[name])), [], 0
        for way, data in RECORDINGS[name]:
            if way == ">":
                stream.sendall(data)
                (event,) = reader.receive(data)
                assert isinstance(event, codec.Controls)
                assert r.order() == Order(4, [("rov/thrusters", {"u": list(event.levels[:8])})])
                outputs += 1
                continue
            (sample,) = (message for message in next(samples) if message.get_type() == "HIL_SENSOR")
            wanted.append(sample)
            r.t_ns = sample.time_usec * 1000 - STEP_NS
            r.tick(imu=((sample.xacc, sample.yacc, sample.zacc), (sample.xgyro, sample.ygyro, sample.zgyro), 15.0))
            assert not outputs or r.order() is None, "until its outputs are there"
        stream.settimeout(0.2)
        got = b""
        with contextlib.suppress(TimeoutError):
            while True:
                got += stream.recv(65536)
        again = [m for m in mavlink.MAVLink(None).parse_buffer(got) if m.get_type() == "HIL_SENSOR"]
        for one, other in zip(again, wanted, strict=True):
            for key in ("time_usec", "xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "id"):
                assert getattr(one, key) == getattr(other, key), key
        counts = r.stats.details
        assert [counts[key] for key in ("controls", "late", "missed", "bad", "limited")] == [outputs, 0, 0, 0, 0]


def test_what_the_recordings_hold() -> None:
    """So that they are known to hold what they are for."""
    assert [message.get_type() for message in told(RECORDINGS["start"])[0]] == ["HEARTBEAT"]
    for part in RECORDINGS.values():
        stamps = [m.time_usec for piece in told(part) for m in piece if m.get_type() == "HIL_SENSOR"]
        assert stamps == list(range(stamps[0], stamps[-1] + 1, STEP_NS // 1000))
    (last,) = codec.Codec().receive(next(data for way, data in reversed(RECORDINGS["steered"]) if way == ">"))
    assert isinstance(last, codec.Controls)
    front_right, front_left, rear_right, rear_left = last.levels[:4]
    assert front_left > front_right > 0.05, "ahead and to the right"
    assert rear_right > rear_left > 0.05
