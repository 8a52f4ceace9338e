"""Records what a real ArduSub and the adapter `ardupilot_json` say to each other.

``UWSERVER_ARDUSUB=... python tests/integration/record_ardusub.py FILE VERSION``, in a network namespace (``unshare -n``, loopback up), as
`ground_station` says. A relay between the two keeps the datagrams. FILE is gzip of JSON lines: what this is, with the VERSION of ArduSub;
then for each recording what it is, and its datagrams in order, [">", hex] from ArduSub, ["<", text] to it.
"""

from __future__ import annotations

import gzip
import itertools
import json
import select
import socket
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

sys.path.append(str(Path(__file__).parents[1]))

from autopilot_server import ardusub_scenario, serving
from ground_station import Gcs, ardusub

ABOUT = "uwserver 0.1.0, bluerov2_heavy at 5 m depth; recorded by tests/integration/record_ardusub.py"
Log = list[tuple[str, bytes]]


class Relay(threading.Thread):
    """Between an ArduSub and a server; with `loses_one` the first answer is kept from ArduSub, which then asks again."""

    def __init__(self, server: tuple[str, int], loses_one: bool) -> None:
        super().__init__()
        self.log: Log = []
        self.over = threading.Event()
        self.near, self.far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self.near.bind(("127.0.0.1", 0))
        self.far.connect(server)
        self._loses_one = loses_one

    def run(self) -> None:
        peer: Any = None
        while not self.over.is_set():
            for ready in select.select([self.near, self.far], [], [], 0.2)[0]:
                if ready is self.near:
                    data, peer = self.near.recvfrom(4096)
                    self.log.append((">", data))
                    self.far.send(data)
                    continue
                data = self.far.recv(4096)
                self.log.append(("<", data))
                if not self._loses_one:
                    self.near.sendto(data, peer)
                self._loses_one = False
        self.near.close()
        self.far.close()


def record(
    rate: int, *options: str, adapter: str = "no_time_sync = true", params: str = "", loses_one: bool = False, arms: bool = False
) -> tuple[Log, int]:  # fmt: skip
    """All datagrams, and the place in them when it was armed and steered."""
    gcs, armed = Gcs(), 0
    text = ardusub_scenario(rate=rate, clock="max_speed = 1.0", adapter=adapter)
    with tempfile.TemporaryDirectory() as name, serving(Path(name), text) as server:
        relay = Relay(server.addresses["autopilot"], loses_one)
        relay.start()
        try:
            there: Any = SimpleNamespace(addresses={"autopilot": relay.near.getsockname()})
            with ardusub(Path(name), there, gcs, *options, params=params):
                if arms:
                    gcs.until(lambda: gcs.last.get("HEARTBEAT"), "a heartbeat")
                    gcs.mode("MANUAL")
                    gcs.arm()
                    armed = len(relay.log)
                    gcs.sticks.update({4: 1400, 5: 1700})
                end = time.monotonic() + 10.0
                while len(relay.log) < armed + 3000 and time.monotonic() < end:
                    gcs.turn()
        finally:
            relay.over.set()
            relay.join()
            gcs.close()
    return relay.log, armed


def changes(log: Log, start: int) -> int:
    """Place of the first frame from `start` on whose pulse widths are others than those of the one before."""
    frames = [place for place in range(start, len(log)) if log[place][0] == ">"]
    return next(b for a, b in itertools.pairwise(frames) if log[a][1][8:] != log[b][1][8:])


def main(file: Path, version: str) -> None:
    """Record, and write."""
    lines: list[object] = [f"{version} and {ABOUT}"]

    def keep(what: str, log: Log) -> None:
        lines.append({"recording": what})
        lines.extend([way, data.hex() if way == ">" else data.decode()] for way, data in log)

    log, armed = record(1200, arms=True)
    steered = changes(log, armed)
    keep("start", log[:600])
    keep("steered", log[steered - steered % 2 - 40 :][:160])
    keep("32 channels", record(1200, params="SERVO_32_ENABLE 1\n")[0][:200])
    keep("960 ticks/s, first answer lost", record(960, adapter="", loses_one=True)[0][:400])
    keep("--rate 900", record(1200, "--rate", "900")[0][:640])
    text = "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)
    file.write_bytes(gzip.compress(text.encode(), mtime=0))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
