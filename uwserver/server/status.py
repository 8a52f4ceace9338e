"""The reports of a server about itself: `world/status`, and the metrics for Prometheus."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from uwserver.ports import Json
from uwserver.server.context import Hub
from uwserver.simulation.clock import BUCKETS_S, Lateness
from uwserver.units import NANOSECONDS

if TYPE_CHECKING:
    from prometheus_client.metrics_core import Metric


class Monitor:
    """Measures the real-time factor twice a second, and makes the status. Loop thread.

    Attributes:
        real_time_factor: simulated time divided by wall time, in the last half second.
        lateness: quantiles of the lateness, as of then, so that a status stays cheap.
    """

    def __init__(self, hub: Callable[[], Hub], now_ns: Callable[[], int]) -> None:
        self._hub = hub
        self._now_ns = now_ns
        self.real_time_factor = 0.0
        self.lateness = Lateness().quantiles()

    async def run(self) -> None:
        """Measure until cancelled."""
        world = self._hub().simulation.world
        wall, sim = self._now_ns(), world.t_ns
        while True:
            await asyncio.sleep(0.5)
            now, t_ns = self._now_ns(), world.t_ns
            self.real_time_factor = max(0.0, (t_ns - sim) / (now - wall))
            self.lateness = self._hub().simulation.lateness.quantiles()
            wall, sim = now, t_ns
            for handler in logging.getLogger().handlers:
                handler.flush()  # writes pending counts of repeated messages, even if no further message comes

    def status(self) -> dict[str, Json]:
        """Return the answer of `world/status`."""
        hub = self._hub()
        simulation, world = hub.simulation, hub.simulation.world
        return {
            "server": hub.server,
            "scenario": world.name,
            "tick": world.tick,
            "t_ns": world.t_ns,
            "t_s": world.t_ns / NANOSECONDS,
            "rate_hz": float(world.rate_hz),
            "mode": simulation.timing.mode,
            "paused": simulation.paused,
            "failure": simulation.failure,
            "speed": simulation.pace.speed,
            "real_time_factor": round(self.real_time_factor, 3),
            "lateness": dict(self.lateness),
            "overruns": simulation.pace.overruns,
            "dropped": hub.bus.dropped,
            "readings_dropped": dict(world.readings_dropped),
            "readings_failed": dict(world.readings_failed),
            "stops": {reason: count for reason, count in world.stops.items() if count},
            "vehicles": list(world.members),
            "held": [name for name, member in world.members.items() if member.vehicle.is_held],
            "conflicts": sum(slot.conflicts for slot in world.actuators.values()),
            "lockstep_waits_for": list(simulation.lockstep.barrier.missing(world.tick))
            if simulation.timing.mode == "lockstep"
            else [],
            "playback": None if hub.playback is None else hub.playback(),
            "adapters": {name: dict(vars(stats)) for name, stats in hub.stats.items()},
            "recorder": hub.recordings.status() if hub.recordings else None,
        }


class Metrics:
    """The metrics for Prometheus, made from live counters."""

    def __init__(self, hub: Hub, monitor: Monitor) -> None:
        self._hub = hub
        self._monitor = monitor

    def text(self) -> bytes:
        """Return all metrics as text."""
        # Imported at the first request, as the import takes a tenth of the start-up time.
        from prometheus_client import CollectorRegistry, generate_latest

        registry = CollectorRegistry(auto_describe=False)
        registry.register(self)
        return generate_latest(registry)

    def collect(self) -> Iterable[Metric]:
        """Yield all metrics; prometheus_client calls this."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily

        simulation = self._hub.simulation
        lateness = simulation.lateness
        total, buckets = 0, []
        for bound, count in zip((*map(str, BUCKETS_S), "+Inf"), lateness.counts, strict=True):
            total += count
            buckets.append((bound, float(total)))
        yield HistogramMetricFamily(
            "uwserver_tick_lateness_seconds", "Lateness of paced ticks.", buckets, lateness.total_s
        )
        known = simulation.world
        conflicts = sum(slot.conflicts for slot in known.actuators.values())
        for family, name, doc, value in (
            (CounterMetricFamily, "ticks", "Ticks done.", lateness.ticks),
            (GaugeMetricFamily, "simulation_time_seconds", "Simulation time.", simulation.world.t_ns / NANOSECONDS),
            (GaugeMetricFamily, "real_time_factor", "Simulated over wall time.", self._monitor.real_time_factor),
            (GaugeMetricFamily, "paused", "1 while time stands still.", int(simulation.paused)),
            (CounterMetricFamily, "overruns", "Times the clock fell behind and started anew.", simulation.pace.overruns),
            (CounterMetricFamily, "bus_dropped_samples", "Samples the loop was too slow to take.", self._hub.bus.dropped),
            (CounterMetricFamily, "readings_dropped", "Readings that were not computed in time.", sum(known.readings_dropped.values())),
            (CounterMetricFamily, "readings_failed", "Readings that could not be computed.", sum(known.readings_failed.values())),
            (CounterMetricFamily, "command_conflicts", "Commands to an actuator that another source commands too.", conflicts),
        ):  # fmt: skip
            yield family(f"uwserver_{name}", doc, value)
        for name, doc in _OF_ADAPTERS.items():
            kind = GaugeMetricFamily if name == "peers" else CounterMetricFamily
            of_each = kind(f"uwserver_adapter_{name}", doc, labels=["adapter"])
            for adapter, stats in self._hub.stats.items():
                of_each.add_metric([adapter], getattr(stats, name))
            yield of_each


_OF_ADAPTERS = {
    "samples_sent": "Samples sent to peers.",
    "bytes_sent": "Bytes sent to peers.",
    "commands": "Commands received.",
    "calls": "Calls received.",
    "errors": "Requests refused.",
    "dropped": "Samples dropped for slow peers.",
    "restarts": "Restarts after a failure.",
    "peers": "Peers connected.",
}
