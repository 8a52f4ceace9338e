"""Computation of pictures beside a world in real time: how late the ticks are, and how many readings arrive."""

from __future__ import annotations

import socket
import struct
from collections import Counter
from collections.abc import Callable
from threading import Event, Thread

import msgspec

from uwserver.simulation.clock import SystemTime
from uwserver_bench.processes import BenchFailed, Served, scenario_file, serving
from uwserver_bench.report import Row
from uwserver_bench.server import STATUS, lateness_p99_ms
from uwserver_bench.swarm.swarm_scenario import SERVED

LATENESS_BAR_MS = 1.0
CAMERA, SONAR = "rov/front", "rov/imaging"
_LENGTH = struct.Struct("!I")
_SETTLE_S = 2.0

SCENARIO = f"""
schema = 1
[world]
rate_hz = 250
[seabed]
kind = "flat"
depth_m = 8.0
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]
[vehicles.rov.sensors.{CAMERA.removeprefix("rov/")}]
kind = "camera"
rate_hz = 10
width = 640
height = 480
position_frd_m = [0.3, 0.0, 0.0]
[vehicles.rov.sensors.{SONAR.removeprefix("rov/")}]
kind = "multibeam"
rate_hz = 50
overhead_s = 0.03
beams = 256
bins = 512
range_m = 20
position_frd_m = [0.3, 0.0, 0.1]
[vehicles.rov.override.sensors.imu]
rate_hz = 125
[vehicles.rov.override.sensors.pressure]
rate_hz = 50
[vehicles.rov.override.sensors.depth]
rate_hz = 50
"""
"""15 Hz does not divide 250 Hz. With this range and overhead the multibeam pings every 60 ms, 16.7 times per second."""


def bench_beside(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the rows on pictures beside a world, for the part of the report on video.

    Args:
        quick: short repeats.
        say: gets a line of progress.

    Raises:
        BenchFailed: no reading arrived.
    """
    repeats, seconds = (1, 2.0) if quick else (5, 10.0)
    late, shares = [], {CAMERA: [0.0] * 0, SONAR: [0.0] * 0}
    for repeat in range(repeats):
        say(f"video: a camera and a multibeam beside a world, {repeat + 1} of {repeats}")
        late_ms, share = _measure(seconds)
        late.append(late_ms)
        for port, values in shares.items():
            values.append(share[port])
    title = "beside a 10 Hz camera (640 x 480) and a 16.7 Hz multibeam (256 x 512), both computed"
    return [
        Row("video", f"250 Hz {title}: tick lateness p99", "ms", tuple(late), at_most=LATENESS_BAR_MS),
        Row("video", "of the pictures of that camera arrive in time", "ratio", tuple(shares[CAMERA])),
        Row("video", "of the pictures of that multibeam arrive in time", "ratio", tuple(shares[SONAR])),
    ]


def _measure(seconds: float) -> tuple[float, dict[str, float]]:
    """Return the p99 of the lateness in ms, and for each port the part of its readings that a client received."""
    clock, got = SystemTime(), Counter[str]()
    with scenario_file(SCENARIO + SERVED) as file:
        with serving(file) as served, socket.create_connection((served.host, served.port)) as connection:
            reader = Thread(target=_count, args=(connection, got), daemon=True)
            reader.start()
            for number, port in enumerate((CAMERA, SONAR)):
                request = {"jsonrpc": "2.0", "id": number, "method": "subscribe", "params": {"pattern": port}}
                body = msgspec.msgpack.encode(request)
                connection.sendall(_LENGTH.pack(len(body)) + body)
            clock.wait(_SETTLE_S, Event())
            lost, since = _lost(served), got.copy()
            clock.wait(seconds, Event())
            lost, given = _lost(served) - lost, got - since
            late_ms = lateness_p99_ms(served)
            connection.shutdown(socket.SHUT_RDWR)
            reader.join()
    for port in (CAMERA, SONAR):
        if not given[port] + lost[port]:
            raise BenchFailed(f'no reading of "{port}" was begun')
    return late_ms, {port: given[port] / (given[port] + lost[port]) for port in (CAMERA, SONAR)}


def _lost(served: Served) -> Counter[str]:
    """Return the number of readings that were not computed in time, by port."""
    return Counter(served.ask(STATUS)["value"]["readings_dropped"])


def _count(connection: socket.socket, got: Counter[str]) -> None:
    """Count the samples of each port until the connection ends."""
    with connection.makefile("rb") as stream:
        while len(head := stream.read(_LENGTH.size)) == _LENGTH.size:
            message = msgspec.msgpack.decode(stream.read(_LENGTH.unpack(head)[0]))
            if message.get("method") == "sample":
                got[message["params"]["port"]] += 1
