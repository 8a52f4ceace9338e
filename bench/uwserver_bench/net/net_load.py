"""The clients of `uwserver bench net`, in a process of their own: ``python -m uwserver_bench.net.net_load``.

Tasks and results are lines on stdin and stdout, as of `uwserver_bench.load`. Times can be compared with the trace of the server, because both
processes read the same monotonic clock.
"""

from __future__ import annotations

import contextlib
import json
import selectors
import sys
from collections.abc import Callable, Mapping, Sequence
from threading import Event
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver_bench.net.traced import TICKS, open_trace
from uwserver_bench.net.wires import Peer, Refusal, TimedMessage, ask, connect
from uwserver_bench.report import quantile

WRENCH, THRUSTERS = "rov/truth/wrench", "rov/thrusters"
PATIENCE_S = 10.0
_SETTLE_S = 0.3
_GOLDEN = 0.6180339887
"""Multiples of the golden ratio spread the commands evenly over the phase of the tick."""
_clock = SystemTime()

Task = Mapping[str, Any]


def commands(task: Task) -> dict[str, object]:
    """For `seconds`, command a thruster vector, then wait for the reply and for the first wrench that shows the command.

    Returns the p99 (s) of the time from before the sending to the end of the tick in which the command acts (`p99_s`), and to the arrival of the
    sample that shows it (`seen_p99_s`).

    Raises:
        ValueError: the wrench did not change in the tick after the command.
    """
    ends, rate_hz = open_trace(task["trace"]), task["rate_hz"]
    acted: list[float] = []
    with contextlib.closing(_peer(task)) as peer:
        ask(peer, "subscribe", pattern=WRENCH)
        end, turn, late = _clock.now_ns() + int(task["seconds"] * 1e9), 0, []
        before: object = None
        while _clock.now_ns() < end:
            _listen(peer, (turn * _GOLDEN % 1.0 + 1.0) / task["rate_hz"])
            sent = _clock.now_ns()
            u = [0.3 if turn % 2 else -0.3] * 8
            seen: list[TimedMessage] = []
            applied = ask(peer, "command", PATIENCE_S, seen, port=THRUSTERS, value={"u": u})["t_ns"]
            shown = _first(peer, seen, applied)
            if shown.body["params"]["value"] == before:
                raise ValueError(f"the wrench after the command at t = {applied} ns is the one before it")
            before = shown.body["params"]["value"]
            tick = -(-shown.body["params"]["t_ns"] * rate_hz // 10**9)
            acted.append((int(ends[tick % TICKS]) - sent) * 1e-9)
            late.append((shown.at_ns - sent) * 1e-9)
            turn += 1
    return {"p99_s": quantile(acted, 0.99), "seen_p99_s": quantile(late, 0.99), "count": len(late)}


def _first(peer: Peer, seen: list[TimedMessage], applied_ns: int) -> TimedMessage:
    """Return the first wrench of a tick that began at or after the tick of the command."""
    end = _clock.now_ns() + int(PATIENCE_S * 1e9)
    while _clock.now_ns() < end:
        for message in seen:
            if message.body.get("method") == "sample" and message.body["params"]["t_ns"] > applied_ns:
                return message
        seen = peer.receive(0.1)
    raise TimeoutError("no wrench after a command")


def samples(task: Task) -> dict[str, object]:
    """Receive all samples for `seconds`. Returns for each the time (s) from the end of its tick to the arrival."""
    ends = open_trace(task["trace"])
    rate_hz = task["rate_hz"]
    late: list[float] = []
    with contextlib.closing(_peer(task)) as peer:
        ask(peer, "subscribe", pattern=task["pattern"])
        _listen(peer, _SETTLE_S)
        end = _clock.now_ns() + int(task["seconds"] * 1e9)
        while _clock.now_ns() < end:
            for at_ns, body in peer.receive(0.1):
                if body.get("method") == "sample":
                    tick = -(-body["params"]["t_sent_ns"] * rate_hz // 10**9)
                    late.append((at_ns - int(ends[tick % TICKS])) * 1e-9)
    if not late:
        raise ValueError("no sample came")
    return {"p50_s": quantile(late, 0.5), "p99_s": quantile(late, 0.99), "count": len(late)}


def readings(task: Task) -> dict[str, object]:
    """Call world/status again and again for `seconds`. Returns the time to each reply (s)."""
    late = []
    with contextlib.closing(_peer(task)) as peer:
        end = _clock.now_ns() + int(task["seconds"] * 1e9)
        while (sent := _clock.now_ns()) < end:
            ask(peer, "call", service="world/status")
            late.append((_clock.now_ns() - sent) * 1e-9)
    return {"p50_s": quantile(late, 0.5), "p99_s": quantile(late, 0.99), "count": len(late)}


def flow(task: Task) -> dict[str, object]:
    """Let `clients` receive all samples that match `pattern` for `seconds`. Returns samples per second of all clients together."""
    with contextlib.ExitStack() as stack:
        peers = [stack.enter_context(contextlib.closing(_peer(task))) for _ in range(task["clients"])]
        for peer in peers:
            ask(peer, "subscribe", pattern=task["pattern"])
        _count(peers, _SETTLE_S)
        start = _clock.now_ns()
        count, large = _count(peers, task["seconds"])
        elapsed = (_clock.now_ns() - start) * 1e-9
    return {"per_s": count / elapsed, "count": count, "large": large}


def _count(peers: Sequence[Peer], seconds: float) -> tuple[int, int]:
    """Return the number of samples that arrived at all clients, and how many of them are the megabyte."""
    end, count, large = _clock.now_ns() + int(seconds * 1e9), 0, 0
    with selectors.DefaultSelector() as selector:
        for peer in peers:
            if (number := peer.fileno()) is not None:
                selector.register(number, selectors.EVENT_READ, peer)
        while _clock.now_ns() < end:
            ready = [key.data for key, _ in selector.select(0.05)] if selector.get_map() else peers
            arrived = [message.body for peer in ready for message in peer.receive(0.0)]
            count += sum(body.get("method") == "sample" for body in arrived)
            large += sum(
                body["params"]["port"].endswith("/megabyte") for body in arrived if body.get("method") == "sample"
            )
            if not selector.get_map():
                _clock.wait(0.002, Event())
    return count, large


def reconnect(task: Task) -> dict[str, object]:
    """Let a subscribed client disconnect and come back, `times`. Returns the longest time (s) from its end to the first sample of the new client."""
    worst = 0.0
    for _ in range(task["times"]):
        peer = _peer(task)
        ask(peer, "subscribe", pattern=task["pattern"])
        peer.close()
        gone = _clock.now_ns()
        with contextlib.closing(_peer(task)) as again:
            ask(again, "subscribe", pattern=task["pattern"])
            worst = max(worst, (_next_sample(again) - gone) * 1e-9)
    return {"worst_s": worst}


def outage(task: Task) -> dict[str, object]:
    """Subscribe, report it on stdout, and wait until samples fail for `silence_s` and return. Returns the time (ns) of the first that came back."""
    with contextlib.closing(_peer(task)) as peer:
        ask(peer, "subscribe", pattern=task["pattern"])
        last = _next_sample(peer)
        print(json.dumps({"ready": True}), flush=True)
        while True:
            at_ns = _next_sample(peer)
            if at_ns - last > task["silence_s"] * 1e9:
                return {"back_ns": at_ns}
            last = at_ns


def _next_sample(peer: Peer) -> int:
    end = _clock.now_ns() + int(PATIENCE_S * 1e9)
    while _clock.now_ns() < end:
        for at_ns, body in peer.receive(0.1):
            if body.get("method") == "sample":
                return at_ns
    raise TimeoutError(f"no sample within {PATIENCE_S:g} s")


def _listen(peer: Peer, seconds: float) -> None:
    end = _clock.now_ns() + int(seconds * 1e9)
    while (now := _clock.now_ns()) < end:
        peer.receive((end - now) * 1e-9)


def _peer(task: Task) -> Peer:
    return connect(task["wire"], task["address"])


_TASKS: Mapping[str, Callable[[Task], dict[str, object]]] = {
    "commands": commands,
    "samples": samples,
    "readings": readings,
    "flow": flow,
    "reconnect": reconnect,
    "outage": outage,
}


def main() -> None:
    """Carry out tasks until stdin ends."""
    for line in sys.stdin:
        task = json.loads(line)
        try:
            result = _TASKS[task["task"]](task)
        except (OSError, ValueError, Refusal) as error:
            result = {"failed": f"load task {task['task']} over {task['wire']}: {error}"}
        print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
