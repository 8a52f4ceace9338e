"""Cost of reading logs in processor time of one core: telemetry logs, logs of MOOS, and the contents of a large MCAP file."""

from __future__ import annotations

import importlib
import os
import struct
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from uwserver.logfiles import open_log
from uwserver_bench.rows import Row

TLOG_BAR, ALOG_BAR, CONTENTS_BAR_S = 50e3, 500e3, 1.0
_START_US = 1_760_000_000_000_000
_MESSAGE_BYTES = 4000
_CHANNELS = 50


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
