"""Warns of sensors that cannot keep their times: readings that may be computed too late, and sonars that cannot ping often enough."""

from __future__ import annotations

from typing import NamedTuple

from uwserver.scenario.load.resolved import Resolved
from uwserver.sensors.acoustic.pinging import PingTable

_MOST_NAMED = 4
"""Sensors that are named in a warning; further ones are counted."""
_CAMERA = (
    "more read_out_s or latency_s, fewer pixels (width, height), or lower all rate_hz, so that readings seldom coincide"
)
_SONAR = (
    "more processing_s or latency_s, fewer beams, bins or rays, or lower all rate_hz, so that readings seldom coincide"
)


class _Computed(NamedTuple):
    """A sensor whose readings take processor time to compute.

    Attributes:
        path: path of its port.
        cost: processor time of a reading, s.
        given: time from the start of a reading to its delivery, s.
        piece: longest piece of a reading that is computed in pieces, s; otherwise the cost.
        keys: changes to the table that lengthen `given` or shorten `cost`.
    """

    path: str
    cost: float
    given: float
    piece: float
    keys: str

    def keeps(self, other: _Computed) -> float:
        """Return how long another sensor may have to wait for this one, s.

        If this reading is due first, the other one waits for all of it. If it is due later, the other one waits for the piece that is being
        computed, or for what cannot have been done in the time by which this reading began earlier.
        """
        later = self.given - other.given
        return self.cost if later <= 0.0 else max(self.piece, self.cost - later)


def late(resolved: Resolved) -> list[str]:
    """Return a line for each sensor whose readings may be dropped in real time.

    One reading is computed at a time, the one that is due first before others; but a piece that has begun is not interrupted.
    """
    each = [
        _Computed(
            f"{vehicle}/{name}", sensor.computing_s, sensor.given_s, getattr(sensor, "piece_s", sensor.computing_s),
            _SONAR if isinstance(sensor, PingTable) else _CAMERA,
        )
        for vehicle, v in resolved.vehicles.items()
        for name, sensor in v.vehicle.sensors.items()
        if sensor.enabled and hasattr(sensor, "computing_s") and hasattr(sensor, "given_s") and sensor.computing_s > 0.0
    ]  # fmt: skip
    # Two of each group of equal sensors are enough to find the longest wait.
    alike: dict[tuple[float, ...], list[_Computed]] = {}
    for one in each:
        alike.setdefault((one.cost, one.given, one.piece), []).append(one)
    others = [one for few in alike.values() for one in few[:2]]
    lines = []
    for one in each:
        before = max((other for other in others if other is not one), key=lambda other: other.keeps(one), default=None)
        wait = 0.0 if before is None else before.keeps(one)
        need = one.cost + wait
        if need <= one.given:
            continue
        waits = "" if before is None else f" and {_ms(wait)} for {before.path}, which may be computed before it"
        lines.append(
            f"in time: {one.path} has {_ms(one.given)} from the start of a reading to its delivery, and may need {_ms(need)}: "
            f"{_ms(one.cost)} for itself{waits}. In real time such readings are dropped. Give it {one.keys}"
        )
    return _shortened(lines, "may be late too")


def hasty(resolved: Resolved) -> list[str]:
    """Return a line for each sonar whose rate is higher than its range leaves time for."""
    lines = [
        f"rate: {vehicle}/{name} cannot ping rate_hz = {sensor.rate_hz:g} times a second: with range_m = {sensor.range_m:g} and overhead_s = "
        f"{sensor.overhead_s:g} about {sensor.pings_hz:.3g} a second"
        for vehicle, v in resolved.vehicles.items()
        for name, sensor in v.vehicle.sensors.items()
        if sensor.enabled and isinstance(sensor, PingTable) and sensor.rate_hz > sensor.pings_hz
    ]
    return _shortened(lines, "cannot either")


def _shortened(lines: list[str], what: str) -> list[str]:
    more = len(lines) - _MOST_NAMED
    return lines if more <= 0 else [*lines[:_MOST_NAMED], f"and {more} more {what}"]


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"
