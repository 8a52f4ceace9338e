"""Cost of decoding one message: how long the most expensive call keeps the interpreter from the other threads of its process. A tick loses this
time, whatever else the machine does.
"""

from __future__ import annotations

import contextlib
import gc
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from statistics import median
from typing import NamedTuple

from uwserver_adapters.ardupilot.wire import parse as servo_frame
from uwserver_adapters.moos import wire as moos
from uwserver_adapters.moos.bridge.calls import parse as moos_call
from uwserver_adapters.moos.codec import Fix, pose_of, reset_pose
from uwserver_adapters.moos.text.lines import parse as moos_line
from uwserver_adapters.native.codec import JsonCodec, MsgpackCodec
from uwserver_adapters.native.websocket import Handshake
from uwserver_adapters.sockets.datagrams import parse_datagram
from uwserver_adapters.zenoh_bus.codec import decode_map

from uwserver.adapter import frame, line
from uwserver.ports import Refused
from uwserver.server.life_cycle import SWITCH_INTERVAL_S
from uwserver_bench.hostile.messages import JSON, MIB, MSGPACK
from uwserver_bench.report import Row

BAR_MS = 1.0
TRIES = 5
HAS_MAVLINK = find_spec("pymavlink") is not None


class Cost(NamedTuple):
    """Cost of one piece of work.

    Attributes:
        held_ns: longest processor time of its thread between two turns of a thread that always waits for the interpreter.
        spent_ns: whole processor time of its thread.
    """

    held_ns: int
    spent_ns: int


class Rival:
    """A thread that always waits for the interpreter, like the simulation in a late tick. It measures the processor time of the thread that made it,
    so that other processes have no effect. As in a server, Python code is interrupted, and compiled code is not."""

    def __init__(self) -> None:
        self._clock = time.pthread_getcpuclockid(threading.get_ident())
        self._most = 0
        self._is_over = False
        self._turns = 0
        self._thread = threading.Thread(target=self._run, name="rival", daemon=True)
        self._before = sys.getswitchinterval()

    def __enter__(self) -> Rival:
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        gc.collect()  # as in the server: objects of this process must not count as cost of a message
        gc.freeze()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over = True
        self._thread.join()
        sys.setswitchinterval(self._before)
        gc.unfreeze()

    def _run(self) -> None:
        last = time.clock_gettime_ns(self._clock)
        while not self._is_over:
            now = time.clock_gettime_ns(self._clock)
            self._most = max(self._most, now - last)
            last = now
            self._turns += 1
            time.sleep(0)

    def _let_in(self) -> None:
        turns = self._turns
        while self._turns < turns + 2:
            time.sleep(0)

    def cost(self, work: Callable[[], object]) -> Cost:
        """Do some work, and return its cost."""
        self._let_in()
        self._most = 0
        start = time.thread_time_ns()
        try:
            work()
        finally:
            spent = time.thread_time_ns() - start
            self._let_in()
        return Cost(min(self._most, spent), spent)


Call = Callable[[], object]


@dataclass(frozen=True)
class Decoding:
    """One attack on one decoder.

    Attributes:
        wire: the adapter that reads it.
        name: name of the attack.
        calls: makes the calls of the adapter, one after the other. Each call is measured by itself. A call that returns None is the last.
    """

    wire: str
    name: str
    calls: Callable[[], Iterator[Call]]


def _once(work: Callable[[bytes], object], data: bytes) -> Callable[[], Iterator[Call]]:
    return lambda: iter([lambda: work(data)])


def _reader(make: Callable[[], object], data: bytes) -> Callable[[], Iterator[Call]]:
    """Return the calls of a decoder that stores bytes, and returns one event per call."""

    def calls() -> Iterator[Call]:
        decoder = make()
        for at in range(0, len(data), RECEIVED):
            piece = data[at : at + RECEIVED]
            yield lambda piece=piece: decoder.receive(piece)  # type: ignore[misc,attr-defined]  # each decoder here has these two
        events: Call = decoder.next_event  # type: ignore[attr-defined]
        for _ in range(MOST_CALLS):
            yield events

    return calls


RECEIVED = 1 << 18
"""Largest number of bytes that asyncio reads at once."""
MOST_CALLS = 200
"""Number of measured calls of a decoder: the most expensive one is among the first."""


def _websocket() -> object:
    handshake = Handshake((), ())
    handshake.receive(
        b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    assert handshake.codec is not None
    return handshake.codec


def web_frame(body: bytes, opcode: int = 1) -> bytes:
    """Return a WebSocket frame of a client, masked with zeros."""
    return bytes((0x80 | opcode, 0x80 | 127)) + len(body).to_bytes(8, "big") + bytes(4) + body


def _small_frame(opcode: int, body: bytes = b"") -> bytes:
    """Return a small frame of a client, masked with zeros. With opcode 1 it begins an unfinished text, and with opcode 0 it continues one."""
    return bytes((opcode if opcode < 2 else 0x80 | opcode, 0x80 | len(body))) + bytes(4) + body


def _native() -> Iterator[Decoding]:
    yield Decoding("JSON lines", "256 KiB of blank lines", _reader(JsonCodec, b"\n" * RECEIVED))
    for name, small in {
        "parts of a text": _small_frame(0, b"x"),
        "pongs": _small_frame(10),
        "pings": _small_frame(9),
    }.items():
        frames = _small_frame(1) + small * (RECEIVED // len(small) - 1)
        yield Decoding("WebSocket", f"256 KiB of {name}", _reader(_websocket, frames))
    for name, body in JSON.items():
        yield Decoding("JSON lines", name, _reader(JsonCodec, line(body)))
        yield Decoding("WebSocket", name, _reader(_websocket, web_frame(body)))
        yield Decoding("zenoh", name, _once(lambda data: decode_map(data, "json"), body))
        if len(body) < 1 << 16:
            yield Decoding("UDP", name, _once(parse_datagram, body))
    for name, body in MSGPACK.items():
        yield Decoding("msgpack frames", name, _reader(MsgpackCodec, frame(body)))
        yield Decoding("WebSocket", name, _reader(_websocket, web_frame(body, 2)))
        yield Decoding("zenoh", name, _once(lambda data: decode_map(data, "msgpack"), body))


def _packet(message: moos.MoosMessage, count: int = 1) -> bytes:
    return moos.packet([moos.encode(message)] * count)


def _text(value: str) -> moos.MoosMessage:
    return moos.notify("A", value, 0.0, "x")


MOOS: Mapping[str, bytes] = {
    "16 384 messages in a packet": _packet(moos.notify("A", 1.0, 0.0, "x"), 16_384),
    "2048 messages in a packet": _packet(moos.notify("A", 1.0, 0.0, "x"), 2048),
    "a value of 4 MiB": _packet(_text("x" * (4 * MIB - 200))),
    "a name of 1 MiB that is no UTF-8": _packet(moos.MoosMessage(moos.NOTIFY, "\udcff" * MIB)),
}


def _moos() -> Iterator[Decoding]:
    for name, data in MOOS.items():
        yield Decoding("MOOSDB", name, _reader(moos.Decoder, data))
    long = moos.MoosMessage(moos.NOTIFY, "A", data=b"\xff" * (4 * MIB), kind=moos.STRING)
    yield Decoding("MOOSDB", "a text of 4 MiB that is no UTF-8", _once(lambda _: long.value, b""))
    call = "7 world/echo " + '{"value":[' + "1e300," * 10_000 + "1]}"
    yield Decoding(
        "MOOSDB", "UWSERVER_CALL, 64 KiB of 1e300,", _once(lambda data: moos_call(data.decode()), call.encode())
    )
    reset = "x=1," * 16_384
    yield Decoding(
        "MOOSDB",
        "USM_RESET, 64 KiB of x=1,",
        _once(lambda data: reset_pose(data.decode(), pose_of(Fix())), reset.encode()),
    )
    for name, data in {
        "64 KiB of A=1": b"A=1 " * 16_384, "a number of 64 KiB": b"A=" + b"1" * 65_000, "quotes": b'A="' + b'\\"' * 32_000 + b'"',
    }.items():  # fmt: skip
        yield Decoding("MOOS text", name, _once(moos_line, data))


def _autopilots() -> Iterator[Decoding]:
    yield Decoding("ArduPilot JSON", "2 KiB of frames", _once(servo_frame, b"\x1a\x48\x00\x00" * 512))
    if not HAS_MAVLINK:
        return
    from uwserver_adapters.mavlink.wire.dialect import Dialect
    from uwserver_adapters.mavlink.wire.frames import Decoder
    from uwserver_adapters.mavlink.wire.json_form import BadJson, frame_of
    from uwserver_adapters.px4.codec import Codec
    from uwserver_adapters.px4.door import READ

    dialect = Dialect()

    def message(data: bytes) -> object:
        try:
            return frame_of(data, dialect)
        except BadJson as error:
            return error

    garbage = {"0xFD": b"\xfd", "zeros": b"\0", "all bytes": bytes(range(256)), "short frames": b"\xfd\0\0" + bytes(9)}
    for name, bits in garbage.items():
        yield Decoding("MAVLink", name, _reader(lambda: Decoder(dialect), bits * (65_507 // len(bits))))
        yield Decoding("PX4", name, _once(Codec().receive, bits * (READ // len(bits))))
    yield Decoding("MAVLink", "JSON, 16 KiB of 1e9,", _once(message, JSON["16 KiB of 1e9,"][:16_000] + b"1]}"))


def decodings() -> Iterator[Decoding]:
    """Return all attacks on decoders."""
    yield from _native()
    yield from _moos()
    yield from _autopilots()


def costs(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return a row for each attack on a decoder."""
    say("hostile: decoders")
    repeats = 1 if quick else 5
    rows = []
    with Rival() as rival:
        for each in decodings():
            found = [_cost(each, rival) for _ in range(repeats)]
            note = f"{median(cost.spent_ns for cost in found) * 1e-6:.2f} ms in all"
            values = tuple(cost.held_ns * 1e-6 for cost in found)
            rows.append(Row("decode", f"{each.wire}: {each.name}", "ms", values, at_most=BAR_MS, note=note))
    return rows


def _cost(attack: Decoding, rival: Rival) -> Cost:
    """Return the cost of the most expensive call, by both measures. It is the least of several tries, because a rival that waits for a processor
    itself makes a call seem too expensive."""
    tries = [_once_more(attack, rival) for _ in range(TRIES)]
    return Cost(min(cost.held_ns for cost in tries), min(cost.spent_ns for cost in tries))


def _once_more(attack: Decoding, rival: Rival) -> Cost:
    held = spent = 0
    for call in attack.calls():
        cost = rival.cost(lambda call=call: _refused(call))  # type: ignore[misc]
        held, spent = max(held, cost.held_ns), max(spent, cost.spent_ns)
    return Cost(held, spent)


def _refused(call: Call) -> None:
    with contextlib.suppress(Refused, ValueError):  # a decoder should refuse an attack
        call()
