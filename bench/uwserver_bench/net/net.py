"""The network: latency, throughput and cost of each transport, with a server that records a trace; and effects of faults."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from threading import Event
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver.world.warm import warm
from uwserver_bench.net.net_processes import (
    HAS_ZENOH,
    NO_ZENOH,
    WIRE_ADDRESS,
    Router,
    Traced,
    free_endpoint,
    tracing,
)  # fmt: skip
from uwserver_bench.processes import Load, loading
from uwserver_bench.report import Row
from uwserver_bench.server import LATENESS_BAR_MS, STATUS, UNKNOWN, lateness_p99_ms

COMMAND_P99_BAR_MS, READING_P50_BAR_MS, RECONNECT_BAR_S = 5.0, 1.0, 2.0
SAMPLE_P50_BAR_MS, ZENOH_SAMPLE_P50_BAR_MS = 0.5, 0.6
FLOW_BARS = {"TCP msgpack": 50_000.0, "zenoh": 20_000.0}
CROWDS = (1, 10, 50)
SHARED = 0.7
"""Least part of the clients that must be served over the whole measurement."""
FLOW_CLIENTS = 10
SLOW_CLIENTS = 10
SETTLE_S = 1.0
IMPATIENT_S = 0.3
_EVERYTHING = "**"
_LOAD = "uwserver_bench.net.net_load"

Say = Callable[[str], None]


@dataclass(frozen=True)
class Length:
    """Duration and number of the measurements."""

    repeats: int
    seconds: float
    stopped_s: float
    times: int


FULL, QUICK = Length(3, 2.0, 10.0, 10), Length(1, 0.4, 0.5, 2)


def bench_net(quick: bool, say: Say) -> list[Row]:
    """Return the part of the report on the network.

    Args:
        quick: one short repeat of each.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    warm()
    length = QUICK if quick else FULL
    with loading(_LOAD) as load:
        rows = _latencies(load, length, say)
        rows += _flows(load, length, say)
        rows += _crowds(load, length, say)
        rows += _stopped_reader(load, length, say)
        rows += _megabyte(load, length, say)
        rows += _reconnects(load, length, say)
        return rows + _router_restart(load, length, say)


def _wires() -> list[str]:
    return [wire for wire in WIRE_ADDRESS if wire != "zenoh" or HAS_ZENOH]


def _latencies(load: Load, length: Length, say: Say) -> list[Row]:
    """Measure latencies of one client, with all transports in turn on one server."""
    figures: dict[tuple[str, str], list[float]] = {}
    with tracing() as traced:
        for repeat in range(length.repeats):
            say(f"net: latencies, repeat {repeat + 1} of {length.repeats}")
            for wire in _wires():
                place = traced.place(wire)
                for task, figure in (("commands", "p99_s"), ("samples", "p50_s"), ("readings", "p50_s")):
                    result = load.ask(task, **place, pattern=_EVERYTHING, seconds=length.seconds)
                    figures.setdefault((wire, task), []).append(result[figure] * 1e3)
                    if task == "commands":
                        figures.setdefault((wire, "seen"), []).append(result["seen_p99_s"] * 1e3)
    rows = []
    for wire in WIRE_ADDRESS:
        bar = ZENOH_SAMPLE_P50_BAR_MS if wire == "zenoh" else SAMPLE_P50_BAR_MS
        note = "" if wire in _wires() else NO_ZENOH
        names = (
            ("commands", "command sent to its force, p99", COMMAND_P99_BAR_MS),
            ("seen", "command sent to its force seen, p99", None),
            ("samples", "end of the tick to the client, p50", bar),
            ("readings", "world/status, p50", READING_P50_BAR_MS),
        )
        for task, name, most in names:
            values = tuple(figures.get((wire, task), ()))
            rows.append(Row("net", f"{wire}: {name}", "ms", values, at_most=most, note=note))
    return rows


def _flows(load: Load, length: Length, say: Say) -> list[Row]:
    """Measure a free-running server that sends every sample to ten clients. With zenoh to one client, whose decoding is the limit."""
    rows = []
    for wire, bar in FLOW_BARS.items():
        clients = 1 if wire == "zenoh" else FLOW_CLIENTS
        name = f"{wire}: samples received, free-running, {clients} client{'s' if clients > 1 else ''}"
        if wire not in _wires():
            rows.append(Row("net", name, "1/s", (), at_least=bar, note=NO_ZENOH))
            continue
        rates = []
        for repeat in range(length.repeats):
            say(f"net: throughput over {wire}, repeat {repeat + 1} of {length.repeats}")
            with tracing("freerun") as traced:
                result = load.ask(
                    "flow", **traced.place(wire), pattern=_EVERYTHING, clients=clients, seconds=length.seconds
                )
                rates.append(result["per_s"])
        rows.append(Row("net", name, "1/s", tuple(rates), at_least=bar))
    return rows


def _crowds(load: Load, length: Length, say: Say) -> list[Row]:
    """Measure the processor time of the server for a sent sample, beyond that of the server alone. Clients share the encoding of a sample."""
    cost: dict[int, list[float]] = {count: [] for count in CROWDS}
    shared: dict[int, list[float]] = {count: [] for count in CROWDS}
    late: list[float] = []
    for repeat in range(length.repeats):
        say(f"net: {', '.join(map(str, CROWDS))} clients, repeat {repeat + 1} of {length.repeats}")
        with tracing() as traced:
            SystemTime().wait(
                SETTLE_S, Event()
            )  # until the server has finished what it does once at its start, which is not a cost of the clients
            alone = _processor_share(traced, lambda: SystemTime().wait(length.seconds, Event()))
            for count in CROWDS:
                received = 0

                def crowd(count: int = count) -> None:
                    nonlocal received
                    result = load.ask(
                        "flow",
                        **traced.place("TCP msgpack"),
                        pattern=_EVERYTHING,
                        clients=count,
                        seconds=length.seconds,
                    )
                    received = result["per_s"]

                before = _adapter(traced, "tcp")
                share = _processor_share(traced, crowd)
                after = _adapter(traced, "tcp")
                encoded = after["encoded"] - before["encoded"]
                shared[count].append((after["samples_sent"] - before["samples_sent"]) / max(encoded, 1))
                if share is not None and alone is not None and received:
                    cost[count].append(max(0.0, share - alone) / received * 1e6)
            late.append(lateness_p99_ms(traced.served))
    rows = [
        Row("net", f"server processor time a sample, {count} client(s)", "us", tuple(values), note="" if values else UNKNOWN)
        for count, values in cost.items()
    ]  # fmt: skip
    rows += [
        Row("net", f"samples sent for each one encoded, {count} client(s)", "1", tuple(values), at_least=SHARED * count)
        for count, values in shared.items()
    ]
    return [*rows, Row("net", "tick lateness p99 over all that", "ms", tuple(late), at_most=LATENESS_BAR_MS)]


def _adapter(traced: Traced, name: str) -> dict[str, Any]:
    """Return the status of the adapter in world/status."""
    stats: dict[str, Any] = traced.served.ask(STATUS)["value"]["adapters"][name]
    return stats


def _processor_share(traced: Traced, work: Callable[[], None]) -> float | None:
    """Return how many cores the server used during `work`."""
    clock = SystemTime()
    before, start = traced.processor_s(), clock.now_ns()
    work()
    after, elapsed = traced.processor_s(), (clock.now_ns() - start) * 1e-9
    return None if before is None or after is None else (after - before) / elapsed


def _stopped_reader(load: Load, length: Length, say: Say) -> list[Row]:
    """Stop the process of ten clients, while an eleventh client continues."""
    say("net: a process of ten clients is stopped")
    with tracing() as traced, loading(_LOAD) as others:
        place = traced.place("TCP msgpack")
        others.begin(
            "flow", **place, pattern=_EVERYTHING, clients=SLOW_CLIENTS, seconds=length.seconds + length.stopped_s
        )
        SystemTime().wait(1.0, Event())
        os.kill(others.pid, signal.SIGSTOP)
        try:
            result = load.ask("samples", **place, pattern=_EVERYTHING, seconds=length.stopped_s)
        finally:
            os.kill(others.pid, signal.SIGCONT)
        others.result()
        dropped = _adapter(traced, "tcp")["dropped"]
        late = lateness_p99_ms(traced.served)
    who = f"{SLOW_CLIENTS} readers stopped for {length.stopped_s:g} s"
    return [
        Row("net", f"{who}: tick lateness p99", "ms", (late,), at_most=LATENESS_BAR_MS),
        Row("net", f"{who}: end of the tick to another client, p50", "ms", (result["p50_s"] * 1e3,), at_most=SAMPLE_P50_BAR_MS),
        Row("net", f"{who}: samples dropped for them", "1", (float(dropped),)),
    ]  # fmt: skip


def _megabyte(load: Load, length: Length, say: Say) -> list[Row]:
    rows = []
    with tracing(megabyte=True) as traced:
        for wire in ("TCP msgpack", "zenoh"):
            say(f"net: a megabyte at 10 Hz over {wire}")
            name = f"{wire}: samples of 1 MB at 10 Hz received"
            if wire not in _wires():
                rows.append(Row("net", name, "1/s", (), note=NO_ZENOH))
                continue
            result = load.ask(
                "flow", **traced.place(wire), pattern=_EVERYTHING, clients=1, seconds=2.0 * length.seconds
            )
            rows.append(Row("net", name, "1/s", (result["large"] / (2.0 * length.seconds),)))
        late = lateness_p99_ms(traced.served)
    return [*rows, Row("net", "with 1 MB at 10 Hz: tick lateness p99", "ms", (late,), at_most=LATENESS_BAR_MS)]


def _reconnects(load: Load, length: Length, say: Say) -> list[Row]:
    rows = []
    with tracing() as traced:
        for wire in _wires():
            say(f"net: clients that come again over {wire}")
            result = load.ask("reconnect", **traced.place(wire), pattern=_EVERYTHING, times=length.times)
            name = f"{wire}: client gone to sample at its successor, worst of {length.times}"
            rows.append(Row("net", name, "s", (result["worst_s"],), at_most=RECONNECT_BAR_S))
    return rows


def _router_restart(load: Load, length: Length, say: Say) -> list[Row]:
    """Kill the router that connects server and client, and start it again."""
    name = "zenoh: killed router started again (its own start included) to the first sample"
    if not HAS_ZENOH:
        return [Row("net", name, "s", (), at_most=RECONNECT_BAR_S, note=NO_ZENOH)]
    endpoint, clock, seconds = free_endpoint(), SystemTime(), []
    for repeat in range(length.repeats):
        say(f"net: router restarted, repeat {repeat + 1} of {length.repeats}")
        router = Router(endpoint)
        try:
            with tracing(router=endpoint) as traced:
                place = {**traced.place("zenoh"), "address": endpoint}
                load.begin("outage", **place, pattern=_EVERYTHING, silence_s=IMPATIENT_S)
                load.result()
                router.kill()
                clock.wait(1.0, Event())
                again = clock.now_ns()
                router = Router(endpoint)
                seconds.append((load.result()["back_ns"] - again) * 1e-9)
        finally:
            router.kill()
    return [Row("net", name, "s", tuple(seconds), at_most=RECONNECT_BAR_S)]
