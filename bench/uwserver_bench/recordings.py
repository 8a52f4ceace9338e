"""Recordings: cost of recording everything of a full BlueROV2, speed of playing a recording to five clients, and time of a seek in a large recording.

The full BlueROV2 is that of the scenario `rov_autopilot`: its own sensors, DVL, AHRS, altimeter, battery, autopilot and truth, 240 ticks per second.
"""

from __future__ import annotations

import json
import os
import selectors
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread
from typing import IO, Any

from uwserver.recording.player_track import Track
from uwserver.recording.states import ENTITY_LISTS, STATES
from uwserver.simulation.clock import SystemTime, processor_ns
from uwserver_bench.processes import BenchFailed, Served, _address, serving, stop
from uwserver_bench.rows import Row
from uwserver_bench.server import LATENESS_BAR_MS, lateness_p99_ms

SCENARIO, CLIENTS = "rov_autopilot", 5
RECORDING_BAR, PLAYBACK_BAR, SEEK_BAR_MS = 0.05, 30.0, 200.0
_PIECE = 1 << 18


def bench_recordings(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on recordings.

    Args:
        quick: one short repeat of each.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    repeats, seconds, size = (1, 4.0, 4 << 20) if quick else (3, 120.0, 1 << 30)
    shares, late, factors, seeks = list[float](), list[float](), list[float](), list[float]()
    with tempfile.TemporaryDirectory(prefix="uwserver-bench-") as place:
        for repeat in range(repeats):
            say(f"logs: repeat {repeat + 1} of {repeats}")
            file = Path(place) / f"{repeat}.mcap"
            with_it = _processor_s("--until", str(seconds), "--record", str(file))
            shares.append(max(1e-6, (with_it - _processor_s("--until", str(seconds))) / seconds))
            with serving(SCENARIO, options=("--record", str(Path(place) / f"late{repeat}.mcap"))) as served:
                SystemTime().wait(min(seconds, 5.0), Event())
                late.append(lateness_p99_ms(served))
            factors.append(_played(file, seconds))
        say("logs: seeks in a large file")
        large = Path(place) / "large.mcap"
        span = _enlarged(Path(place) / "0.mcap", large, size)
        track = Track(large)
        for part in (0.5, 0.13, 0.91, 0.3, 0.77):
            began = processor_ns()
            track.seek(0, round(part * span))
            seeks.append((processor_ns() - began) * 1e-6)
        track.close()
    return [
        Row("logs", "recording all of a full BlueROV2: part of a core", "1", tuple(shares), at_most=RECORDING_BAR),
        Row("logs", "lateness p99 while it is recorded", "ms", tuple(late), at_most=LATENESS_BAR_MS),
        Row("logs", f"playback of it to {CLIENTS} clients that take all", "x", tuple(factors), at_least=PLAYBACK_BAR),
        Row("logs", f"seek in a file of {size >> 20} MiB, processor time", "ms", tuple(seeks), at_most=SEEK_BAR_MS),
    ]


def _processor_s(*options: str) -> float:
    """Return the processor time of a free-running server, s."""
    command = [sys.executable, "-m", "uwserver", "run", SCENARIO, "--port", "0", "--mode", "freerun", *options]
    with subprocess.Popen([*command, "--log-level", "error"], stdout=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise BenchFailed(f"{' '.join(command)} ended with {process.returncode}")
    return usage.ru_utime + usage.ru_stime


def _played(file: Path, seconds: float) -> float:
    """Return how many seconds of a recording are played per second to clients that take every sample."""
    command = [sys.executable, "-m", "uwserver", "play", str(file), "--port", "0", "--paused", "--speed", "max"]
    with subprocess.Popen([*command, "--log-level", "error"], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            host, port = _address(process.stdout, " ".join(command))
            return _fastest(Served(host, port, process.pid), seconds)
        finally:
            stop(process)


def _fastest(served: Served, seconds: float) -> float:
    ended = Event()
    peers = [socket.create_connection((served.host, served.port)) for _ in range(CLIENTS)]
    for peer in peers:
        peer.sendall(json.dumps(_request("subscribe", pattern="**", delivery="reliable")).encode() + b"\n")
    drain = Thread(target=_drain, args=(peers, ended))
    drain.start()
    try:
        SystemTime().wait(0.3, Event())
        began = SystemTime().now_ns()
        # It is paused, and continues with this one request: after a separate resume a short recording would end before the request. Its last tick
        # is a little before its end.
        served.ask(json.dumps(_request("call", service="world/run_until", args={"t_s": seconds - 0.1})))
        return (seconds - 0.1) * 1e9 / (SystemTime().now_ns() - began)
    finally:
        ended.set()
        drain.join()
        for peer in peers:
            peer.close()


def _request(method: str, **params: object) -> dict[str, object]:
    return {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}


def _drain(peers: list[socket.socket], ended: Event) -> None:
    """Receive everything, as five clients that are fast enough."""
    with selectors.DefaultSelector() as ready:
        for peer in peers:
            ready.register(peer, selectors.EVENT_READ)
        while not ended.is_set():
            for key, _ in ready.select(0.1):
                found: Any = key.fileobj
                found.recv(_PIECE)


def _enlarged(source: Path, target: Path, size: int) -> int:
    """Write the messages of a recording repeatedly, each time with later times, until the file has a size. Returns the duration of the file, ns."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    with source.open("rb") as file:
        reader = make_reader(file)
        found = list(reader.iter_messages(log_time_order=False))
        heads = list(reader.iter_metadata())
    step = max(message.log_time for _, _, message in found)
    output: IO[bytes]
    with target.open("wb") as output:
        writer: Any = Writer(output, chunk_size=_PIECE, compression=CompressionType.NONE)
        writer.start("", "uwserver")
        for head in heads:
            writer.add_metadata(head.name, head.metadata)
        numbers: dict[int, int] = {}
        for schema, channel, _ in found:
            if channel.id not in numbers and schema is not None:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
        k = 0
        while output.tell() < size:
            for _, channel, message in found:
                if channel.topic in (ENTITY_LISTS, STATES) and k:
                    continue  # the first lists what is there, and the second contains times
                writer.add_message(numbers[channel.id], message.log_time + k * step, message.data, message.publish_time)
            k += 1
        writer.finish()
    return k * step
