"""From an instant to a picture: what comes back of a ping over range, and what the beams of a receiver make of it.

Each step is a function of its own, for sonars that need some of them: `gates_of`, `Echoes.energy` (rays, ghosts, second-time-around, volume),
`hear` (speckle, beams, noise, pulse), `gain_over_range`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray
from uwserver.physics.rays.raycast import NOTHING, SURFACE, Geometry, Hits
from uwserver.sensors.acoustic.echo import MU_SURFACE, cast_from, kernels
from uwserver.sensors.acoustic.imaging import columns, echoes, speckle
from uwserver.sensors.acoustic.imaging.echoes import Gates
from uwserver.sensors.acoustic.imaging.swath import Plane, Swath, reflected, unfolded
from uwserver.sensors.voices import NO_BURSTS

BEYOND = 1.3
"""Rays look so much farther than the last gate: what they hit behind it may reach into it."""
SURFACE_LOSS_DB, BOTTOM_LOSS_DB = 2.0, 10.0
"""Of intensity at each reflection: a calm surface scatters a little aside; sand at grazing angles well above the critical one takes the most
(Medwin and Clay, Fundamentals of Acoustical Oceanography, 1998, chapters 2 and 13: typical values)."""
_UP = -0.7
"""Component down of the normal of what counts as bottom."""
_LEAST_RAYS = 256


class Pulse(NamedTuple):
    """What is sent, and what the receiver adds.

    Attributes:
        level: source level, dB re 1 uPa at 1 m.
        length: s.
        bandwidth: Hz.
        noise: spectral level around, dB re 1 uPa^2/Hz.
    """

    level: float
    length: float
    bandwidth: float
    noise: float


class Ranges(NamedTuple):
    """How range is divided, and the levels that follow.

    Attributes:
        gates: one a bin, and some behind the last.
        level: of the compressed pulse, uPa^2 at 1 m.
        noise: mean intensity in a gate, of an omnidirectional receiver, uPa^2.
    """

    gates: Gates
    level: float
    noise: float


def ranges(reach: float, bins: int, c: float, stretch: float, pulse: Pulse) -> Ranges:
    """Of a ping. A receiver filters to what its bins resolve: a pulse that resolves more than a bin counts as if it resolved one.

    Args:
        reach: range at the end of the last bin, as the device believes, m.
        bins: of the ping.
        c: sound speed, m/s.
        stretch: believed over true sound speed.
        pulse: its sound.
    """
    gate_m = reach / bins
    true_m = gate_m / stretch
    resolved = max(min(0.5 * c / pulse.bandwidth, reach / stretch), true_m)
    window = resolved / true_m
    bandwidth = 0.5 * c / resolved
    level = 10.0 ** (0.1 * pulse.level) * max(1.0, bandwidth * pulse.length)
    noise = 10.0 ** (0.1 * pulse.noise) * bandwidth / window
    return Ranges(Gates(1.0 / true_m, window, 1, bins + math.ceil(0.5 * window) + 1), level, noise)


class Water(NamedTuple):
    """What a ping meets besides solids.

    Attributes:
        alpha: absorption, dB/m.
        scattering: of a cubic metre of water, 1/m, linear.
        height: of the surface above the transducer, m.
        lambert: (n) by material, of `Scope`.
    """

    alpha: float
    scattering: float
    height: float
    lambert: FloatArray


class Paths(NamedTuple):
    """Which ways sound takes besides the straight one.

    Attributes:
        surface, bottom: echoes of what is seen by way of them as a mirror.
        again: range (true m) behind which echoes of the ping before arrive with those of this one; 0 for never.
    """

    surface: bool = False
    bottom: bool = False
    again: float = 0.0


class Echoes:
    """Casts the rays of one swath. Holds work space, so that one ping at a time may use it."""

    def __init__(self, swath: Swath, bins: int) -> None:
        """Of a sonar with so many bins."""
        self._swath = swath
        self._second: FloatArray = np.zeros((swath.columns, 0))

    def energy(
        self, geometry: Geometry, water: Water, p: Vec3, R: FloatArray, ranges: Ranges, paths: Paths
    ) -> FloatArray:
        """(columns, gates) mean intensity of what comes back, uPa^2.

        Args:
            geometry: solid things at the instant.
            water: around.
            p, R: of the transducer in N.
            ranges: of the ping.
            paths: of sound.
        """
        swath, gates = self._swath, ranges.gates
        direction: FloatArray = swath.grid.direction @ R.T
        farthest = max(BEYOND * gates.total / gates.per_metre, paths.again + gates.total / gates.per_metre)
        if not paths.again:
            farthest = BEYOND * gates.total / gates.per_metre
        hits = cast_from(geometry, p, water.height, direction, farthest)
        out = np.zeros((swath.columns, gates.total))
        for shift in (0.0, paths.again * gates.per_metre) if paths.again else (0.0,):
            second = self._seconds(gates.total)
            self._deposit(swath.grid.cells, direction, R, hits, water, gates, swath.column, shift, ranges.level, second)
            for chosen, loss in _mirrors(hits, paths):
                again = self._ghosts(geometry, p, direction, hits, chosen, farthest)
                cells, column = swath.grid.cells[chosen], swath.column[chosen]
                level = ranges.level * 10.0 ** (-0.2 * loss)
                self._deposit(cells, direction[chosen], R, again, water, gates, column, shift, level, second)
            columns.energies(second, shift, gates.per_metre, water.alpha, out)
            if water.scattering > 0.0:
                strength = water.scattering * ranges.level
                emitted = np.ascontiguousarray(swath.grid.cells["emitted"])
                columns.volume(emitted, hits.distance, hits.body, strength, shift, gates.per_metre, water.alpha, out)
        return out

    def _seconds(self, gates: int) -> FloatArray:
        if self._second.shape[1] != gates + 3:
            self._second = np.zeros((self._swath.columns, gates + 3))
        self._second[:] = 0.0
        return self._second

    @staticmethod
    def _deposit(
        cells: Array, direction: FloatArray, R: FloatArray, hits: Hits, water: Water, gates: Gates, column: IntArray, shift: float, level: float,
        second: FloatArray,
    ) -> None:  # fmt: skip
        ground = kernels()[0].Ground(water.lambert, MU_SURFACE)
        echoes.deposit_columns(cells, direction, R, *hits, ground, gates.per_metre, column, shift, level, second)

    @staticmethod
    def _ghosts(
        geometry: Geometry, p: Vec3, direction: FloatArray, hits: Hits, chosen: IntArray, farthest: float
    ) -> Hits:
        """What the chosen rays meet by way of a mirror."""
        start, towards = reflected(hits, chosen, np.array(p), direction)
        count, padded = len(chosen), _LEAST_RAYS
        while padded < count:  # few different numbers of rays: an engine keeps arrays for each
            padded *= 2
        start, towards = (
            np.concatenate([each, np.repeat(each[-1:], padded - count, axis=0)]) for each in (start, towards)
        )
        found = geometry.raycast(start, towards, farthest)
        first = slice(count)
        return unfolded(
            hits, chosen, Hits(found.distance[first], found.normal[first], found.body[first], found.material[first])
        )


def _mirrors(hits: Hits, paths: Paths) -> list[tuple[IntArray, float]]:
    """Rays that meet each mirror, and its loss, dB."""
    found: list[tuple[IntArray, float]] = []
    if paths.surface:
        found.append((np.flatnonzero(hits.body == SURFACE), SURFACE_LOSS_DB))
    if paths.bottom:
        is_bottom = (hits.body != NOTHING) & (hits.body != SURFACE) & (hits.normal[:, 2] < _UP)
        found.append((np.flatnonzero(is_bottom), BOTTOM_LOSS_DB))
    return [(chosen, loss) for chosen, loss in found if len(chosen)]


class Noise(NamedTuple):
    """Random parts of a ping.

    Attributes:
        key: of the sensor.
        number: drawn for the ping.
        faded, share: of `speckle.fading`.
        bursts: (n, 4) sound of other sonars, of `voices`.
    """

    key: int
    number: int
    faded: Array
    share: FloatArray
    bursts: FloatArray = NO_BURSTS


def hear(swath: Swath, energy: FloatArray, ranges: Ranges, noise: Noise | None) -> Plane:
    """What the beams hear.

    Args:
        swath: of the sonar.
        energy: (columns, gates) of `Echoes`.
        ranges: of the ping.
        noise: None for the mean, without speckle.

    Returns:
        (2, beams, gates) real and imaginary part, uPa; without noise (1, beams, gates) intensity, uPa^2.
    """
    beams, gates = len(swath.azimuth), energy.shape[1]
    if noise is None:
        mean = np.empty((1, beams, gates), np.float32)
        columns.form_beams(swath.power, energy.astype(np.float32), mean[0])
        received(mean, ranges, None, swath.directivity)
        return mean
    waves = np.empty((2, *energy.shape), np.float32)
    columns.scatter(energy, np.uint64(noise.key), noise.faded, noise.share, speckle.PHASORS, waves)
    sound = np.empty((2, beams, gates), np.float32)
    for plane in range(2):
        columns.form_beams(swath.pattern, waves[plane], sound[plane])
    received(sound, ranges, noise, swath.directivity)
    return sound


def received(sound: Plane, ranges: Ranges, noise: Noise | None, directivity: float) -> None:
    """As `columns.receive`, for a receiver of this directivity (as a ratio)."""
    key, number, bursts = (0, 0, NO_BURSTS) if noise is None else (noise.key, noise.number, noise.bursts)
    inside = ranges.noise / directivity
    columns.receive(inside, bursts, np.uint64(key), np.uint64(number), ranges.gates.window, speckle.PHASORS, sound)


def gain_over_range(reach: float, bins: int, spreading: float, alpha: float, limit: float) -> FloatArray:
    """(bins) time-varied gain, dB: spreading lg r + 2 alpha r, at most the limit."""
    r = (np.arange(bins) + 0.5) * (reach / bins)
    result: FloatArray = np.minimum(spreading * np.log10(r) + 2.0 * alpha * r, limit)
    return result
