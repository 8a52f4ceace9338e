"""A server that works for long, with peers of all kinds: 25 minutes in the slow run, an hour or a minute where it is asked for.

`UWSERVER_SOAK_SECONDS` is how long (default 1500), `UWSERVER_SOAK_REPORT` a file for the report, which is printed too.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gauges import Usage, usage
from server_process import Audience, Peer, serving

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

SECONDS = float(os.environ.get("UWSERVER_SOAK_SECONDS", "1500"))
LOOKS = 60
"""How often it is looked at."""
MEGABYTE = 1 << 20
MOST_GROWN = 8 * MEGABYTE
"""In the second half."""
SCENARIO, VEHICLE = "rov_autopilot", "rov"


class Crew:
    """What peers do to the server meanwhile."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._address = address
        self._pilot = Peer(address)
        self._audience = Audience(address, 8)
        self._turn = 0
        self.refused = 0

    def work(self) -> None:
        """One turn: commands, a visitor, and now and then something that rebuilds the world."""
        self._turn += 1
        n = self._turn
        self._call(f"{VEHICLE}/autopilot/get_gains")
        reply = self._pilot.ask("command", port=f"{VEHICLE}/thrusters", value={"u": [0.2 * (n % 5 - 2)] * 8})
        self.refused += "error" in reply
        visitor = Peer(self._address)
        visitor.ask("subscribe", pattern="**")
        visitor.ask("nonsense")
        visitor.close()
        if n % 5 == 0:
            self._call("world/snapshot", name=f"s{n % 4}")
            self._call("world/state_hash")
        if n % 7 == 0:
            self._call("world/spawn", name="guest", like=VEHICLE, p_NB=[8.0, 0.0, 2.0])
            self._call("world/remove", name="guest")
        if n % 50 == 0:
            self._call("world/reset")

    def _call(self, service: str, **args: Any) -> None:
        reply = self._pilot.call(service, **args)
        assert "result" in reply, reply

    def status(self) -> dict[str, Any]:
        """Of the server."""
        value: dict[str, Any] = self._pilot.call("world/status")["result"]["value"]
        return value

    def leave(self) -> None:
        """All of them."""
        self._audience.leave()
        self._pilot.close()


def soak(seconds: float) -> tuple[list[tuple[float, Usage, dict[str, Any]]], int]:
    """What was seen at each look: seconds since the start, usage and status; and commands refused."""
    looks = []
    with serving(SCENARIO, program=sys.executable) as (address, pid):
        crew = Crew(address)
        begin = time.monotonic()
        try:
            for k in range(LOOKS + 1):
                while time.monotonic() < begin + k * seconds / LOOKS:
                    crew.work()
                    time.sleep(0.05)
                looks.append((time.monotonic() - begin, usage(pid), crew.status()))
        finally:
            crew.leave()
    return looks, crew.refused


def report(looks: list[tuple[float, Usage, dict[str, Any]]]) -> str:
    """A table of text."""
    lines = [
        "     s  memory MB  descriptors  threads  late p50 ms  p99 ms  max ms  overruns  dropped on the bus  for slow peers"
    ]
    for t, used, status in looks[:: max(1, len(looks) // 20)]:
        late = [1e3 * status["lateness"][key] for key in ("p50_s", "p99_s", "max_s")]
        lost = sum(adapter["dropped"] for adapter in status["adapters"].values())
        lines.append(
            f"{t:6.0f} {used.memory / MEGABYTE:10.1f} {used.descriptors:12d} {used.threads:8d} {late[0]:12.2f} {late[1]:7.2f} {late[2]:7.2f} "
            f"{status['overruns']:9d} {status['dropped']:19d} {lost:15d}"
        )
    return "\n".join(lines)


def memory_per_hour(looks: list[tuple[float, Usage, dict[str, Any]]]) -> float:
    """Slope of a line through the second half, bytes an hour."""
    half = looks[len(looks) // 2 :]
    return 3600.0 * float(np.polyfit([t for t, _, _ in half], [used.memory for _, used, _ in half], 1)[0])


@pytest.mark.slow
def test_a_long_run_stays_as_it_was() -> None:
    looks, refused = soak(SECONDS)
    half = looks[len(looks) // 2 :]
    grown = half[-1][1].memory - half[0][1].memory
    hourly = memory_per_hour(looks) / MEGABYTE
    told = f"memory grew by {grown / MEGABYTE:.1f} MB in the second half, {hourly:.0f} MB an hour; {refused} commands refused"
    text = f"{report(looks)}\n{told}"
    print(text)
    if path := os.environ.get("UWSERVER_SOAK_REPORT"):
        Path(path).write_text(text + "\n")
    assert grown < MOST_GROWN
    assert max(used.descriptors for _, used, _ in half) <= max(used.descriptors for _, used, _ in looks[1:6]) + 2
    assert len({used.threads for _, used, _ in looks[1:]}) == 1
    assert not any(status["failure"] for _, _, status in looks)
    assert looks[-1][2]["dropped"] == 0


def test_the_report_shows_growth() -> None:
    status = {
        "lateness": {"p50_s": 0.0, "p99_s": 0.001, "max_s": 0.002},
        "overruns": 0,
        "dropped": 0,
        "adapters": {"tcp": {"dropped": 5}},
    }
    looks = [(float(t), Usage(100 * MEGABYTE + t * 1000, 10, 5), status) for t in range(61)]
    assert memory_per_hour(looks) == pytest.approx(3.6e6)
    assert "   100.0           10        5         0.00    1.00    2.00" in report(looks)
