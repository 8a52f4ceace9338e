"""The acoustic channel: all paths of sound between two points of a layered sea, with time of arrival, direction and loss.

The sea depends on depth only; surface and bottom are flat. No sound reaches a shadow zone, into which no ray leads: diffraction and scattering into
it are neglected.
"""

from __future__ import annotations

import math
from functools import cache, cached_property, lru_cache
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from uwserver.environment.acoustics.boundaries import Boundaries, bottom_loss, surface_loss
from uwserver.environment.column import WaterColumn
from uwserver.physics.kernel.arrays import FloatArray

TOLERANCE = 1e-3
"""Error of sound speed, m/s, by which layers may differ from the table of the column. The error of that against TEOS-10 is 2e-3 m/s."""
ORDER = 2
"""Most reflections at surface and bottom of a path."""
_OPEN = Boundaries()


class Path(NamedTuple):
    """A ray from a to b.

    Attributes:
        time: time of travel, s.
        dip_a, dip_b: angle of the ray below the horizontal at its ends, in the direction of travel, rad.
        spreading: loss by the widening of the ray tube, relative to 1 m from the source, dB.
        absorption: loss by absorption in the water, dB.
        reflection: loss at surface and bottom, dB.
        surface, bottom: number of reflections there.
        turns: number of turning points in the water.
        caustic: whether it ends so near a caustic that its level was limited to that of a wave there.
    """

    time: float
    dip_a: float
    dip_b: float
    spreading: float
    absorption: float = 0.0
    reflection: float = 0.0
    surface: int = 0
    bottom: int = 0
    turns: int = 0
    caustic: bool = False

    @property
    def loss(self) -> float:
        """Total transmission loss, dB."""
        return self.spreading + self.absorption + self.reflection


@cache
def _kernels() -> tuple[ModuleType, ModuleType, ModuleType]:
    """Return the modules of compiled code. They are imported at the first use, as numba takes long to load."""
    from uwserver.environment.acoustics import fan, layers, search

    return search, layers, fan


def kernels() -> tuple[Any, ...]:
    """Return the compiled functions that Python calls."""
    search, layers, fan = _kernels()
    return (search.find_rays.made(), layers.thin_out.made(), fan.make_fan.made())


def load_kernels() -> None:
    """Compile the functions, or load them from the cache, so that no tick has to wait for that."""
    find, thin, make = kernels()
    none, table = np.zeros(2), np.zeros((1, 1))
    find.load(none, none, none, none, np.zeros(1, int), table, table, 1.0, 1.0, 1.0, 1.0, 1, 1.0, table)
    thin.load(none, none, 1.0)
    make.load(none, none)


class Channel:
    """Sound propagation in a profile of sound speed at one frequency. It is immutable, and so thread-safe."""

    def __init__(
        self, depth: FloatArray, speed: FloatArray, frequency: float, absorption: FloatArray | None = None
    ) -> None:
        """Make a channel for a profile.

        Args:
            depth, speed: (n >= 2) m, ascending from 0, and m/s; linear between the depths, and constant below.
            frequency: frequency of the sound, Hz.
            absorption: (n) dB/m; default: none.
        """
        self._depth, self._speed = np.array(depth, float), np.array(speed, float)
        self._absorption = np.zeros(len(depth)) if absorption is None else np.array(absorption, float)
        self._omega = 2.0 * math.pi * frequency

    def paths(
        self, horizontal: float, a: float, b: float, boundaries: Boundaries = _OPEN, order: int = ORDER
    ) -> tuple[Path, ...]:
        """Return all rays from depth a to depth b, the earliest first: at most 64, and none that turns in the water more than 16 times.

        Args:
            horizontal: distance, m.
            a, b: depths, m; those above the surface or below the bottom count as at it.
            boundaries: surface and bottom. Without a bottom, sound that leaves the profile downwards is lost.
            order: most reflections at surface and bottom.
        """
        return self._find(_kernels()[0].MOST, horizontal, a, b, boundaries, order)

    def earliest(
        self, horizontal: float, a: float, b: float, boundaries: Boundaries = _OPEN, order: int = ORDER
    ) -> Path | None:
        """Return the first of `paths`, however weak, without computing the others; None if there is none."""
        return next(iter(self._find(1, horizontal, a, b, boundaries, order)), None)

    @cached_property
    def _fan(self) -> tuple[FloatArray, Any, FloatArray, FloatArray]:
        """The fan of the profile, computed at the first use (2 ms for 300 layers)."""
        fan: tuple[FloatArray, Any, FloatArray, FloatArray] = _kernels()[2].make_fan(self._depth, self._speed)
        return fan

    def _find(
        self, most: int, horizontal: float, a: float, b: float, boundaries: Boundaries, order: int
    ) -> tuple[Path, ...]:
        search = _kernels()[0]
        out = np.empty((most, search.COLUMNS))
        a, b = (min(max(z, 0.0), boundaries.bottom) for z in (a, b))
        upper, lower = min(a, b), max(a, b)
        count = search.find_rays(
            self._depth, self._speed, self._absorption, *self._fan, float(horizontal), upper, lower, float(boundaries.bottom), order,
            self._omega, out,
        )  # fmt: skip
        return tuple(self._path(row, a > b, boundaries) for row in out[:count].tolist())

    def _path(self, row: list[float], climbs: bool, boundaries: Boundaries) -> Path:
        time, dip_a, dip_b, area, absorbed, surface, bottom, turns, above, below, caustic = row
        if climbs:
            dip_a, dip_b = -dip_b, -dip_a
        lost = 0.0
        if surface and boundaries.roughness:
            lost += surface * surface_loss(above, boundaries.roughness, self._omega / float(self._speed[0]))
        if bottom:
            lost += bottom * bottom_loss(below, boundaries.sediment)
        spread = 10.0 * math.log10(max(area, 1.0))
        return Path(time, dip_a, dip_b, spread, absorbed, lost, int(surface), int(bottom), int(turns), bool(caustic))

    def straight(self, horizontal: float, a: float, b: float) -> Path:
        """Return the straight path between two points, with the mean slowness of the depths between them and spherical spreading; see `paths`."""
        low, high = min(a, b), max(a, b)
        inside = self._depth[(self._depth > low) & (self._depth < high)]
        z = np.concatenate(((low,), inside, (high,)))
        c = np.interp(z, self._depth, self._speed)
        length, dip = math.hypot(horizontal, b - a), math.atan2(b - a, horizontal)
        alphas = np.interp(z, self._depth, self._absorption)
        slowness, alpha = 1.0 / float(c[0]), float(alphas[0])
        if high > low:
            slowness = float((np.diff(z) * _log_ratio(np.diff(c) / c[:-1]) / c[:-1]).sum()) / (high - low)
            alpha = float((np.diff(z) * 0.5 * (alphas[1:] + alphas[:-1])).sum()) / (high - low)
        return Path(length * slowness, dip, dip, 20.0 * math.log10(max(length, 1.0)), alpha * length)


@lru_cache(maxsize=64)
def channel_of(column: WaterColumn, frequency: float, tolerance: float = TOLERANCE) -> Channel:
    """Return the channel of a water column, in as few layers as the tolerance allows.

    Args:
        column: column of the water.
        frequency: frequency of the sound, Hz.
        tolerance: largest error of the sound speed, m/s. With 0 all layers are kept, and no compiled code is needed.
    """
    kept = (
        _kernels()[1].thin_out(column.depth, column.sound_speed, tolerance)
        if tolerance
        else np.arange(len(column.depth))
    )
    depth = column.depth[kept]
    absorption = np.array([column.absorption_at(frequency, z) for z in depth.tolist()])
    return Channel(depth, column.sound_speed[kept], frequency, absorption)


def first(paths: tuple[Path, ...], most: float = math.inf) -> Path | None:
    """Return the earliest path with a loss of at most `most` (dB); None if there is none."""
    return next((path for path in paths if path.loss <= most), None)


def strongest(paths: tuple[Path, ...], most: float = math.inf) -> Path | None:
    """Return the path with the least loss, if that is at most `most` (dB); None if there is none."""
    return min((path for path in paths if path.loss <= most), key=lambda path: path.loss, default=None)


def _log_ratio(u: FloatArray) -> FloatArray:
    """Return log(1 + u) / u, which is 1 at 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        result: FloatArray = np.where(np.abs(u) < 1e-12, 1.0 - 0.5 * u, np.log1p(u) / u)
    return result
