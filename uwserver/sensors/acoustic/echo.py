"""What sensors that send sound share: when they may ping, how they lay rays, and the bottom for which their range is given."""

from __future__ import annotations

from typing import Any

from msgspec import UnsetType

from uwserver.environment.acoustics.boundaries import SEDIMENT_DB
from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Argument
from uwserver.sensors.compiled import p_NS, submergence

MU_SEDIMENT = 10.0 ** (0.1 * SEDIMENT_DB)
"""Lambert's parameter of sediment, linear. The largest range of a device is the one at which it just detects a bottom of sediment."""
SOUND_SPEED_ARGUMENT = Argument(
    "sound_speed", "float", "sound speed that the device believes; 0 for the true one", "m/s", False, minimum=0, maximum=2000
)  # fmt: skip
"""Argument of the service ``set``."""


def or_truth(assumed_sound_speed_mps: float | UnsetType) -> float:
    """Return the sound speed of a table, m/s; 0, which stands for the true one, if the table gives none."""
    return 0.0 if isinstance(assumed_sound_speed_mps, UnsetType) else assumed_sound_speed_mps


def check_range(range_m: float, low: float, high: float, what: str) -> None:
    """Raise ValueError if `what` (a device, or one of its modes) with these limits (m) does not allow a range."""
    if low > high:
        raise ValueError(f"min_range_m is {low:g} and max_range_m {high:g}: {what} takes no range")
    if not low <= range_m <= high:
        raise ValueError(f"range_m is {range_m:g}, {what} takes {low:g} to {high:g}")


def fill_row(row: Any, **values: Any) -> None:
    """Write values into the record of a sensor, by the names of its fields."""
    for name, value in values.items():
        row[name] = value


@compiled
def is_busy(head: Any, row: Any, t: float) -> bool:
    """Return whether the last ping is not over at time t (s). The sensor then gives no reading.

    Args:
        head: head of the sensor, a row of `compiled.HEAD`.
        row: its record, whose memory has `ready`, the time (s) from which it may ping again.
    """
    if t < row.m.ready - 1e-6:
        head.ready = 0
        return True
    return False


@compiled
def pings(head: Any, row: Any, surroundings: Array, t: float) -> bool:
    """Return whether a sensor pings at time t (s): the last ping is over, and the sensor is under water. Arguments as of `is_busy`."""
    return bool(not is_busy(head, row, t) and submergence(surroundings, p_NS(head, surroundings), t) > 0.0)


@compiled
def lay_ray(p: Vec3, toward: Vec3, k: int, origin: Array, direction: Array) -> None:
    """Make ray k start at p (m, N) and point along the unit vector `toward` (N). `origin`, `direction`: (n, 3) of all rays."""
    origin[k, 0], origin[k, 1], origin[k, 2] = p
    direction[k, 0], direction[k, 1], direction[k, 2] = toward
