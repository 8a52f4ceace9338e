"""The water between an acoustic device and its beacon: the paths of sound, and its level at the receiver."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from uwserver.environment.acoustics.boundaries import SEDIMENTS, Boundaries
from uwserver.environment.acoustics.channel import Path, channel_of, first, load_kernels, strongest
from uwserver.frames import Vec3
from uwserver.sensors.base import Scope, SensorTable
from uwserver.table import Positive

_DEEPEST_M = 12_000.0
_ASIDE = (0.25, 0.5, 0.75)
"""Where along the way the bottom is probed: neither below the device's own vehicle nor below the beacon's."""
_FOUND = 2
"""So many probes must find a bottom, so that a single thing that swims below does not count as one."""


class LinkTable(SensorTable, kw_only=True, frozen=True):
    """The keys of an acoustic signal, and of its way through the water.

    Attributes:
        ideal: exact ranges of all beacons that sound reaches.
        propagation: along straight lines at the mean slowness; or along rays through the layers of the water, which bend in them and are reflected
            by surface and bottom; without a ray there is no answer.
        arrival: which of the rays above their threshold the receivers take.
        reflections: largest number of reflections at surface and bottom of a ray.
        frequency_hz, bandwidth_hz: those of the signal.
        source_level_db: source level of both sides, dB re 1 uPa at 1 m.
        noise_level_db: at the receiver, dB re 1 uPa^2/Hz.
        threshold_db: signal over noise from which on a signal is detected.
    """

    ideal: bool = False
    propagation: Literal["straight", "layered"] = "layered"
    arrival: Literal["first", "strongest"] = "first"
    reflections: Annotated[int, Meta(ge=0, le=8)] = 2
    frequency_hz: Positive = 26e3
    bandwidth_hz: Positive = 4e3
    source_level_db: float = 185.0
    noise_level_db: float = 50.0
    threshold_db: float = 10.0


def stages_of(propagation: str) -> tuple[str, ...]:
    """Return the stages of compiled code (`Traits.stages`) that a kind of propagation needs."""
    return ("sound",) if propagation == "layered" else ()


class Link:
    """The sound of one device. It serves both directions, as the paths from a to b are those from b to a."""

    def __init__(self, table: LinkTable) -> None:
        self._table = table

    def load_kernels(self) -> None:
        """Load the kernels of layered water, if the device needs them."""
        if self._table.propagation == "layered":
            load_kernels()

    def paths(self, scope: Scope, a: Vec3, b: Vec3) -> tuple[Path, ...]:
        """Return all paths from a to b (m, N), the earliest first."""
        column, frequency = scope.water.column, self._table.frequency_hz
        across = math.hypot(b[0] - a[0], b[1] - a[1])
        if self._table.propagation == "straight":
            return (channel_of(column, frequency, 0.0).straight(across, a[2], b[2]),)
        return channel_of(column, frequency).paths(across, a[2], b[2], boundaries(scope, a, b), self._table.reflections)

    def heard(self, paths: tuple[Path, ...], gain: float) -> Path | None:
        """Return the path that the receiver takes: the first or the strongest arrival above its threshold; None if there is none.

        An ideal receiver has no threshold.

        Args:
            paths: all paths.
            gain: gain of the device plus fading, dB.
        """
        table = self._table
        most = math.inf if table.ideal else self.snr_db(0.0, gain) - table.threshold_db
        return (first if table.arrival == "first" else strongest)(paths, most)

    def snr_db(self, loss: float, gain: float) -> float:
        """Return the signal over white noise in the band, dB, after a loss (dB); `gain`: of the device plus fading, dB."""
        table = self._table
        noise = table.noise_level_db + 10.0 * math.log10(table.bandwidth_hz)
        return table.source_level_db + gain - loss - noise

    def surface_delay(self, scope: Scope, a: Vec3, b: Vec3, path: Path) -> float:
        """Return the delay (s) from a path to the next later one that the surface reflects; 0 if there is none."""
        if self._table.propagation == "straight":
            # Straight lines have one reflection at most: that from the image of b above the surface.
            across, drop = math.hypot(b[0] - a[0], b[1] - a[1]), b[2] - a[2]
            length = max(math.hypot(across, drop), 1e-6)
            return path.time * (math.hypot(across, a[2] + b[2]) / length - 1.0)
        later = (other.time for other in self.paths(scope, a, b) if other.surface and other.time > path.time)
        return next(later, path.time) - path.time


def boundaries(scope: Scope, a: Vec3, b: Vec3) -> Boundaries:
    """Return surface and bottom between two points (m, N), both taken as flat: the roughness of the waves, and the median of three depths on the way.

    The bottom is never above the deeper end. Its material is the one found below the middle. If fewer than two of three probes find a bottom, there
    is none.
    """
    origin = np.array([[p + part * (q - p) for p, q in zip(a, b, strict=True)] for part in _ASIDE])
    down = np.zeros(origin.shape)
    down[:, 2] = 1.0
    found = scope.geometry.raycast(origin, down, _DEEPEST_M)
    depths = sorted((origin[:, 2] + found.distance)[np.isfinite(found.distance)].tolist())
    waves = 0.0 if scope.water.sea is None else scope.water.sea.roughness
    if len(depths) < _FOUND:
        return Boundaries(roughness=waves)
    number = int(next(material for material in found.material[[1, 0, 2]].tolist() if material >= 0))
    sediment = scope.sediments[number] if number < len(scope.sediments) else SEDIMENTS["sediment"]
    return Boundaries(max(depths[len(depths) // 2], a[2], b[2]), sediment, waves)


def ray(a: Vec3, b: Vec3, dip: float) -> Vec3:
    """Return the unit vector (N) at a with the heading of b and a dip below the horizon (rad), as a `Path` gives it for both of its ends."""
    heading = math.atan2(b[1] - a[1], b[0] - a[0])
    flat = math.cos(dip)
    return flat * math.cos(heading), flat * math.sin(heading), math.sin(dip)
