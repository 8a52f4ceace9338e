"""The water between an acoustic device and its beacon: by which way sound gets across, and how strong it is then."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from uwserver.environment.acoustics.boundaries import Boundaries
from uwserver.environment.acoustics.channel import Path, channel_of, first, load_kernels, strongest
from uwserver.environment.materials import SEDIMENTS
from uwserver.frames import Vec3
from uwserver.sensors.base import Scope, SensorTable
from uwserver.table import Positive

_DEEPEST_M = 12_000.0
_ASIDE = (0.25, 0.5, 0.75)
"""Where along the way the bottom is looked for: neither below the device's own vehicle, nor below the beacon's."""
_FOUND = 2
"""Of these it must be found, so that one thing that swims below is no bottom."""


class LinkTable(SensorTable, kw_only=True, frozen=True):
    """The sound of a device, and the water's part in it.

    Attributes:
        ideal: exact ranges of all beacons that sound reaches.
        propagation: along straight lines at the mean slowness, or along the rays that lead through the layers of the water, that turn in them, and
            that surface and bottom reflect; where none leads there is no answer.
        arrival: which of these the receivers take of those above their threshold.
        reflections: at surface and bottom, of a ray that is followed, at most.
        frequency_hz, bandwidth_hz: of the signal.
        source_level_db: of both sides, dB re 1 uPa at 1 m.
        noise_level_db: dB re 1 uPa^2/Hz at the receiver.
        threshold_db: signal over noise that is needed.
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
    """The compiled code that rays through layers need, as of `Traits`."""
    return ("sound",) if propagation == "layered" else ()


class Link:
    """Sound of one device, both ways, as the sea is the same from both ends."""

    def __init__(self, table: LinkTable) -> None:
        self._table = table

    def load_kernels(self) -> None:
        """Have those of layered water ready."""
        if self._table.propagation == "layered":
            load_kernels()

    def paths(self, scope: Scope, a: Vec3, b: Vec3) -> tuple[Path, ...]:
        """All ways from a to b (N, m), the earliest first."""
        column, frequency = scope.water.column, self._table.frequency_hz
        across = math.hypot(b[0] - a[0], b[1] - a[1])
        if self._table.propagation == "straight":
            return (channel_of(column, frequency, 0.0).straight(across, a[2], b[2]),)
        return channel_of(column, frequency).paths(across, a[2], b[2], boundaries(scope, a, b), self._table.reflections)

    def heard(self, paths: tuple[Path, ...], gain: float) -> Path | None:
        """The way by which a receiver hears it that takes the first arrival, or the strongest, above its threshold; None in silence.

        An ideal one has no threshold.

        Args:
            paths: all ways.
            gain: setting and fading, dB.
        """
        table = self._table
        most = math.inf if table.ideal else self.snr_db(0.0, gain) - table.threshold_db
        return (first if table.arrival == "first" else strongest)(paths, most)

    def snr_db(self, loss: float, gain: float) -> float:
        """Signal over white noise in the band, after a loss (dB); gain: setting and fading, dB."""
        table = self._table
        noise = table.noise_level_db + 10.0 * math.log10(table.bandwidth_hz)
        return table.source_level_db + gain - loss - noise

    def surface_delay(self, scope: Scope, a: Vec3, b: Vec3, path: Path) -> float:
        """How much later than a path the first other one comes that the surface reflects, s; 0 where there is none."""
        if self._table.propagation == "straight":
            # The image above the surface.
            across, drop = math.hypot(b[0] - a[0], b[1] - a[1]), b[2] - a[2]
            length = max(math.hypot(across, drop), 1e-6)
            return path.time * (math.hypot(across, a[2] + b[2]) / length - 1.0)
        later = (other.time for other in self.paths(scope, a, b) if other.surface and other.time > path.time)
        return next(later, path.time) - path.time


def boundaries(scope: Scope, a: Vec3, b: Vec3) -> Boundaries:
    """Surface and bottom as flat ones between two points (N, m): the roughness of the waves, and the middle of the depths found on the way.

    It lies at the deeper end at least, and is of what is found below the middle. Where less than two of three looks find one, there is none.
    """
    origin = np.array([[p + part * (q - p) for p, q in zip(a, b, strict=True)] for part in _ASIDE])
    down = np.zeros(origin.shape)
    down[:, 2] = 1.0
    found = scope.geometry.raycast(origin, down, _DEEPEST_M)
    depths = sorted((origin[:, 2] + found.distance)[np.isfinite(found.distance)].tolist())
    waves = 0.0
    if scope.water.sea is not None:
        waves = scope.water.sea.roughness
    if len(depths) < _FOUND:
        return Boundaries(roughness=waves)
    number = int(next(material for material in found.material[[1, 0, 2]].tolist() if material >= 0))
    known = scope.sediments
    sediment = known[number] if number < len(known) else SEDIMENTS["sediment"]
    return Boundaries(max(depths[len(depths) // 2], a[2], b[2]), sediment, waves)
