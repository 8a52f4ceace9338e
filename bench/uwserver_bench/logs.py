"""Logs and recordings: cost of reading logs, in processor time of one core; cost of recording everything of a full BlueROV2, speed of playing a
recording to five clients, and time of a seek in a large recording.

The full BlueROV2 is that of the scenario `rov_autopilot`: its own sensors, DVL, AHRS, altimeter, battery, autopilot and truth, 240 ticks per second.
"""

from __future__ import annotations

import importlib
import json
import os
import selectors
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread
from typing import IO, Any

from uwserver.logfiles import open_log
from uwserver.recording.player.track import Track
from uwserver.recording.states import ENTITY_LISTS, STATES
from uwserver.simulation.clock import SystemTime, processor_ns
from uwserver_bench.processes import BenchFailed, Served, running, served_by, serving
from uwserver_bench.report import Row
from uwserver_bench.server import LATENESS_BAR_MS, lateness_p99_ms

TLOG_BAR, ALOG_BAR, CONTENTS_BAR_S = 50e3, 500e3, 1.0
_START_US = 1_760_000_000_000_000
_MESSAGE_BYTES = 4000
_CHANNELS = 50
SCENARIO, CLIENTS = "rov_autopilot", 5
RECORDING_BAR, PLAYBACK_BAR, SEEK_BAR_MS = 0.05, 30.0, 200.0
_PIECE = 1 << 18


def bench_logs(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on logs.

    Args:
        quick: two repeats with short files.
        say: gets a line of progress.
    """
    repeats = 2 if quick else 5
    with tempfile.TemporaryDirectory(prefix="uwserver_bench_") as folder:
        say("logs: writing them")
        tlog = _tlog(Path(folder) / "a.tlog", 2_000 if quick else 60_000)
        alog = _alog(Path(folder) / "a.alog", 10_000 if quick else 1_000_000)
        mcap = _mcap(Path(folder) / "a.mcap", 10 if quick else 1000)
        open_log(tlog).close()  # imports the dialect, which happens only once
        say("logs: reading them")
        return [
            Row("logs", "messages of a .tlog, all fields", "1/s", tuple(_rate(tlog) for _ in range(repeats)), at_least=TLOG_BAR),
            Row("logs", "lines of an .alog", "1/s", tuple(_rate(alog) for _ in range(repeats)), at_least=ALOG_BAR),
            Row("logs", "contents of 1 GB of MCAP with index", "s", tuple(_contents_s(mcap) for _ in range(repeats)), at_most=CONTENTS_BAR_S,
                note="10 MB" if quick else ""),
        ]  # fmt: skip


def _rate(file: Path) -> float:
    start = time.process_time_ns()
    log = open_log(file)
    count = sum(1 for _ in log.read())
    taken = time.process_time_ns() - start
    log.close()
    return count / taken * 1e9


def _contents_s(file: Path) -> float:
    start = time.process_time_ns()
    log = open_log(file)
    found = sum(topic.count or 0 for topic in log.topics.values())
    log.close()
    assert found
    return (time.process_time_ns() - start) * 1e-9


def _tlog(file: Path, count: int) -> Path:
    """Write a log of six messages, each equally often: small ones, one with arrays, one with text."""
    os.environ.setdefault("MAVLINK20", "1")
    m: Any = importlib.import_module("pymavlink.dialects.v20.ardupilotmega")
    link = m.MAVLink(None, srcSystem=1, srcComponent=1)
    some = [0.5] * 21
    made = [
        m.MAVLink_attitude_message(1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
        m.MAVLink_local_position_ned_message(1, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3),
        m.MAVLink_scaled_pressure2_message(1, 1500.0, 0.0, 1200),
        m.MAVLink_vfr_hud_message(1.0, 1.0, 90, 50, -3.0, 0.0),
        m.MAVLink_odometry_message(1, 1, 8, 1, 2, 3, [1.0, 0.0, 0.0, 0.0], 4, 5, 6, 7, 8, 9, some, some, 0, 0, 0),
        m.MAVLink_statustext_message(6, b"EKF3 IMU0 is using GPS"),
    ]
    frames = [message.pack(link) for message in made]
    file.write_bytes(b"".join(struct.pack(">Q", _START_US + k * 1000) + frames[k % 6] for k in range(count)))
    return file


def _alog(file: Path, count: int) -> Path:
    """Write a log of four numbers and a text, in turn."""
    with file.open("w", encoding="utf-8") as out:
        out.write("%% LOGSTART           1760000000.0\n")
        for k in range(count // 5):
            t = f"{k * 0.1:<16.5f}"
            out.write(f"{t}NAV_X  pSim  {k * 0.01:.5f}\n{t}NAV_Y  pSim  {k * 0.02:.5f}\n{t}NAV_HEADING  pSim  45.23\n")
            out.write(f"{t}NAV_DEPTH  pSim  3.2\n{t}IVPHELM_STATE  pHelmIvP  DRIVE\n")
    return file


def _mcap(file: Path, megabytes: int) -> Path:
    """Write a file of several channels in turn, in chunks as our recorder makes them."""
    from mcap.writer import CompressionType, Writer

    with file.open("wb") as out:
        writer: Any = Writer(out, chunk_size=256 * 1024, compression=CompressionType.NONE)
        writer.start("", "bench")
        schema = writer.register_schema(
            "thing", "jsonschema", b'{"type": "object", "properties": {"x": {"type": "number"}}}'
        )
        channels = [writer.register_channel(f"/thing/{k}", "json", schema) for k in range(_CHANNELS)]
        data = b'{"x": 1.0, "more": "' + b"x" * (_MESSAGE_BYTES - 22) + b'"}'
        for k in range(megabytes * 1_000_000 // _MESSAGE_BYTES):
            writer.add_message(channels[k % _CHANNELS], k * 1_000_000, data, 0)
        writer.finish()
    return file


# -- recordings -------------------------------------------------------------------------------------------------------------------------


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
    with running([*command, "--log-level", "error"], stdout=subprocess.PIPE) as process:
        return _fastest(served_by(process, " ".join(command)), seconds)


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
