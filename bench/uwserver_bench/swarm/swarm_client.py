"""The client of `uwserver bench swarm`, in a process of its own: ``python -m uwserver_bench.swarm.swarm_client``. Its tasks are as of `load`."""

from __future__ import annotations

import contextlib
import json
import re
import selectors
import socket
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver.units import NANOSECONDS
from uwserver_bench.processes import carry_out
from uwserver_bench.swarm.swarm_scenario import START_M, mission, names, place

PORTS = ("depth", "ahrs", "dvl", "autopilot/state")
"""Ports of each vehicle that are read, at RATE_HZ of simulated time, newest sample only."""
RATE_HZ = 10.0
AHRS_S = 2.0
"""Simulated time until an AHRS has found north."""
_PATIENCE_S = 60.0
_TIME = re.compile(rb'"t_ns":([0-9]+)')
_clock = SystemTime()


def set_out(task: Mapping[str, Any]) -> dict[str, object]:
    """Start the missions of all vehicles of a server except the last one. It stays where it is and gets set points; no other vehicle passes it.

    Raises:
        ValueError: a request was refused.
    """
    with _connection(task) as connection, connection.makefile("rb") as lines:

        def ask(method: str, **params: object) -> None:
            connection.sendall(_request(1, method, params))
            for line in lines:
                if b'"error"' in line:
                    raise ValueError(f"the server refused {params}: {line.decode(errors='replace')}")
                if b'"id":1' in line and b'"result"' in line:
                    return
            raise ConnectionError("the server closed a connection")

        ask("call", service="world/run_until", args={"t_s": AHRS_S})
        for k, name in enumerate(names(task["vehicles"])):
            ask("call", service=f"{name}/autopilot/set_mission", args={"items": mission(k)})
            ask("call", service=f"{name}/autopilot/arm")
            ask("call", service=f"{name}/autopilot/start_mission")
        ask("call", service=f"{name}/autopilot/set_mode", args={"mode": "position_hold"})
    return {}


def follow(task: Mapping[str, Any]) -> dict[str, object]:
    """For `seconds` of wall time, receive PORTS of all vehicles, and send the last vehicle a set point in each simulated second.

    Returns:
        Samples and set points per simulated second.

    Raises:
        ValueError: a request was refused.
    """
    samples = points = answers = first_ns = last_ns = 0
    held, (north, east) = names(task["vehicles"])[-1], place(task["vehicles"] - 1)
    with _connection(task) as connection, selectors.DefaultSelector() as selector:
        selector.register(connection, selectors.EVENT_READ)
        for port in PORTS:
            taken = {"pattern": f"*/{port}", "rate_hz": RATE_HZ, "delivery": "latest"}
            connection.sendall(_request(0, "subscribe", taken))
        end, rest = _clock.now_ns() + int(task["seconds"] * NANOSECONDS), b""
        while _clock.now_ns() < end:
            if not selector.select(0.1):
                continue
            received = connection.recv(1 << 18)
            if not received:
                raise ConnectionError("the server closed a connection")
            *lines, rest = (rest + received).split(b"\n")
            for line in lines:
                if b'"method":"sample"' in line:
                    samples += 1
                elif b'"error"' in line:
                    raise ValueError(f"the server refused a request: {line.decode(errors='replace')}")
                elif b'"id":1' in line:
                    answers += 1
            newest = next((int(found[1]) for line in reversed(lines) if (found := _TIME.search(line))), last_ns)
            first_ns, last_ns = first_ns or newest, max(newest, last_ns)
            if points <= (last_ns - first_ns) // NANOSECONDS:
                points += 1
                wanted = {"p_N": [north + 0.5 * (points % 2), east, START_M]}
                connection.sendall(_request(1, "command", {"port": f"{held}/autopilot/position", "value": wanted}))
    if not answers:
        raise ValueError("no set point was answered")
    simulated_s = (last_ns - first_ns) / NANOSECONDS
    return {"samples_per_s": samples / simulated_s, "points_per_s": points / simulated_s}


def compute(task: Mapping[str, Any]) -> dict[str, object]:
    """Compute on one core for `seconds` of wall time, without the server."""
    end, numbers = _clock.now_ns() + int(task["seconds"] * NANOSECONDS), [k / 7.0 for k in range(100)]
    while _clock.now_ns() < end:
        json.dumps(numbers)
    return {}


@contextlib.contextmanager
def _connection(task: Mapping[str, Any]) -> Iterator[socket.socket]:
    with socket.create_connection((task["host"], task["port"]), timeout=_PATIENCE_S) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        yield connection


def _request(number: int, method: str, params: Mapping[str, object]) -> bytes:
    return json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": params}).encode() + b"\n"


_TASKS: Mapping[str, Callable[[Mapping[str, Any]], dict[str, object]]] = {
    "set_out": set_out,
    "follow": follow,
    "compute": compute,
}


if __name__ == "__main__":
    carry_out(_TASKS, "swarm")
