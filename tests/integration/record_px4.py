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
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

from autopilot_server import serving
from pymavlink.dialects.v20 import common as mavlink
from test_real_px4 import PARAMS, Station, arm, px4, scenario, wait_for_estimator

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
    """All bytes, and the place in them when it was armed and steered."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = scenario().replace(f"port = {PORT}", "port = 0")
        with serving(folder, text) as server:
            relay = Relay(server.addresses["px4"])
            relay.start()
            station = Station()
            try:
                with px4(folder / "px4", **PARAMS):
                    wait_for_estimator(station)
                    arm(station)
                    station.surge, station.sway = 1.0, 0.5
                    steered = len(relay.log)
                    station.hold(3.0, lambda: 0.0)
            finally:
                station.close()
                relay.over.set()
                relay.join()
    return relay.log, steered


def is_outputs(data: bytes) -> bool:
    """Whether there are actuator outputs among these bytes of PX4."""
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return any(message.get_type() == "HIL_ACTUATOR_CONTROLS" for message in parser.parse_buffer(data) or ())


def main(file: Path, version: str) -> None:
    """Record, and write."""
    log, steered = record()
    outputs = [place for place, (way, data) in enumerate(log) if way == ">" and is_outputs(data)]
    first, armed = outputs[0], next(place for place in outputs if place >= steered)
    lines: list[object] = [f"{version} and {ABOUT}"]
    for what, part in (("start", log[:60]), ("locks", log[first - 40 :][:440]), ("steered", log[armed:][:400])):
        lines.append({"recording": what})
        lines.extend([way, data.hex()] for way, data in part)
    text = "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)
    file.write_bytes(gzip.compress(text.encode(), mtime=0))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
