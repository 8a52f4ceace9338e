"""What cannot keep the time that its tables give it: readings that may be computed too late, and sonars that cannot ping so often."""

from __future__ import annotations

from typing import NamedTuple

from uwserver.scenario.load.resolved import Resolved
from uwserver.sensors.acoustic.pinging import PingTable

_FEW = 4
"""Sensors that are named."""


class _Computed(NamedTuple):
    """A sensor whose readings are computed.

    Attributes:
        path: of its port.
        cost: of a reading, s of processor time.
        given: from its begin to its delivery, s.
        piece: of a reading that is computed in pieces the longest, s; otherwise its cost.
        keys: what makes the latter longer, and the former shorter.
    """

    path: str
    cost: float
    given: float
    piece: float
    keys: str

    def keeps(self, other: _Computed) -> float:
        """How long another may have to wait for it, s: for all of it, but where this is due later for a piece, and for what it cannot have done
        so long after its begin."""
        later = self.given - other.given
        return self.cost if later <= 0.0 else max(self.piece, self.cost - later)


def late(resolved: Resolved) -> list[str]:
    """A line for each sensor whose readings may be dropped in real time: they are computed one at a time, that which is due first before others,
    but a piece that is in work is not left."""
    each = [
        _Computed(
            f"{vehicle}/{name}", sensor.computing_s, sensor.given_s, getattr(sensor, "piece_s", sensor.computing_s),
            _SONAR if isinstance(sensor, PingTable) else _CAMERA,
        )
        for vehicle, v in resolved.vehicles.items()
        for name, sensor in v.vehicle.sensors.items()
        if sensor.enabled and hasattr(sensor, "computing_s") and hasattr(sensor, "given_s") and sensor.computing_s > 0.0
    ]  # fmt: skip
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
        waits = "" if before is None else f" and {_ms(wait)} of {before.path}, which may be in work before it"
        lines.append(
            f"in time: {one.path} has {_ms(one.given)} from the begin of a reading to its delivery, and may need {_ms(need)}: "
            f"{_ms(one.cost)} of its own{waits}. In real time such readings are dropped: {one.keys}"
        )
    return _shortened(lines, "may be late too")


_CAMERA = (
    "more read_out_s or latency_s, fewer pixels (width, height), or a lower rate_hz of all, so that they seldom meet"
)
_SONAR = (
    "more processing_s or latency_s, fewer beams, bins or rays, or a lower rate_hz of all, so that they seldom meet"
)


def hasty(resolved: Resolved) -> list[str]:
    """A line for each sonar that is asked for more pings than its range leaves time for."""
    lines = [
        f"rate: {vehicle}/{name} cannot ping rate_hz = {sensor.rate_hz:g} times a second: with range_m = {sensor.range_m:g} and overhead_s = "
        f"{sensor.overhead_s:g} about {sensor.pings_hz:.3g} a second"
        for vehicle, v in resolved.vehicles.items()
        for name, sensor in v.vehicle.sensors.items()
        if sensor.enabled and isinstance(sensor, PingTable) and sensor.rate_hz > sensor.pings_hz
    ]
    return _shortened(lines, "cannot either")


def _shortened(lines: list[str], what: str) -> list[str]:
    return lines if len(lines) <= _FEW else [*lines[:_FEW], f"and {len(lines) - _FEW} more {what}"]


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"
