"""Records what a real PX4 and the adapter `px4_hil` say to each other.

``UWSERVER_PX4=... python tests/integration/record_px4.py FILE VERSION``, in a network namespace (``unshare -n``, loopback up), as `test_real_px4.py`
says. A relay between the two keeps the bytes. FILE is gzip of JSON lines: what this is, with the VERSION of PX4; then for each recording what it
is, and its bytes in order, [">", hex] from PX4, ["<", hex] to it.
"""

from __future__ import annotations

import gzip
import json
import select
import socket
import sys
import tempfile
import threading
import time
from pathlib import Path

from autopilot_server import serving
from pymavlink.dialects.v20 import common as mavlink
from test_real_px4 import Station, px4, scenario, wait_for_estimator

ABOUT = "uwserver 0.1.0, scenario bluerov2_px4; recorded by tests/integration/record_px4.py"
PORT = 4560
Log = list[tuple[str, bytes]]


class Relay(threading.Thread):
    """Listens where PX4 looks for its simulator, and hands on to the server."""

    def __init__(self, server: tuple[str, int]) -> None:
        super().__init__()
        self.log: Log = []
        self.over = threading.Event()
        self._server = server
        self._listener = socket.create_server(("127.0.0.1", PORT))
        self._listener.settimeout(60.0)

    def run(self) -> None:
        with self._listener, self._listener.accept()[0] as near, socket.create_connection(self._server) as far:
            for stream in (near, far):
                stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            other, way = {near: far, far: near}, {near: ">", far: "<"}
            while not self.over.is_set():
                for ready in select.select([near, far], [], [], 0.2)[0]:
                    data = ready.recv(65536)
                    if not data:
                        return
                    self.log.append((way[ready], data))
                    other[ready].sendall(data)


def record() -> tuple[Log, int]:
    """All bytes, and the place in them when it was about to be armed."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with serving(folder, scenario(port=0)) as server:
            relay = Relay(server.addresses["px4"])
            relay.start()
            station = Station()
            try:
                with px4(folder / "px4"):
                    wait_for_estimator(station)
                    station.mode("MANUAL")
                    station.surge, station.yaw = 1.0, 0.5
                    armed = len(relay.log)
                    station.arm()
                    end = time.monotonic() + 5.0
                    while time.monotonic() < end:
                        station.turn()
            finally:
                station.close()
                relay.over.set()
                relay.join()
    return relay.log, armed


def first_armed(log: Log, start: int) -> int:
    """Place of the first outputs from `start` on that are those of an armed vehicle."""
    parser = mavlink.MAVLink(None, 1, 1)
    parser.robust_parsing = True
    for place in range(start, len(log)):
        way, data = log[place]
        if way == ">" and any(getattr(message, "mode", 0) & 128 for message in parser.parse_buffer(data) or ()):
            return place
    raise AssertionError("it was not armed")


def main(file: Path, version: str) -> None:
    """Record, and write."""
    lines: list[object] = [f"{version} and {ABOUT}"]
    log, place = record()
    armed = first_armed(log, place)
    for what, part in (("start", log[:300]), ("armed", log[armed - 100 :][:700])):
        lines.append({"recording": what})
        lines.extend([way, data.hex()] for way, data in part)
    text = "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)
    file.write_bytes(gzip.compress(text.encode(), mtime=0))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
