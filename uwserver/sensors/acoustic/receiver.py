"""From the instant of a ping to a picture or to soundings: the echoes over range, and what the beams of a receiver make of them.

Each step is a function of its own, as some sonars need only some of them: `ranges` (gates), `Echoes.energy` (rays, ghosts, echoes of the ping
before, volume), `hear` (speckle, beams, noise, pulse), `gain_over_range` and `picture_of` (output).
`sound_out` gives ranges of narrow beams, with level and quality.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from uwserver.environment.acoustics.boundaries import SURFACE_DB
from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.rays.raycast import NOTHING, SURFACE, Geometry, Hits
from uwserver.sensors.acoustic.imaging import columns, echoes, soundings, speckle
from uwserver.sensors.acoustic.imaging.echoes import DECIBEL, Gates
from uwserver.sensors.acoustic.imaging.fan import Plane, Swath, reflected, unfolded
from uwserver.sensors.voices import END, FIRST, NO_BURSTS

MU_SURFACE = 10.0 ** (0.1 * SURFACE_DB)
BEYOND = 1.3
"""Rays reach so many times farther than the last gate, as the echo of what they hit behind it may reach into it."""
SURFACE_LOSS_DB, BOTTOM_LOSS_DB = 2.0, 10.0
"""Loss of intensity at each reflection: a calm surface scatters a little aside; sand at grazing angles well above the critical one takes the most
(Medwin and Clay, Fundamentals of Acoustical Oceanography, 1998, chapters 2 and 13: typical values)."""
_UP = -0.7
"""What has a normal with a smaller down component than this counts as bottom."""
_LEAST_RAYS = 256
Output = Literal["counts", "pressure", "complex"]
_OTHER = 1 << 63
"""Bit that no number of a ping has: it tells the noise of the difference of both halves of the array from the noise of their sum."""


class Pulse(NamedTuple):
    """The pulse that is sent, and the noise at the receiver.

    Attributes:
        level: source level, dB re 1 uPa at 1 m.
        length: s.
        bandwidth: Hz.
        noise: spectral level of the ambient noise, dB re 1 uPa^2/Hz.
    """

    level: float
    length: float
    bandwidth: float
    noise: float


class Ranges(NamedTuple):
    """How range is divided into gates, and the levels that follow from it.

    Attributes:
        gates: one for each bin, and some behind the last bin.
        level: level of the compressed pulse, uPa^2 at 1 m.
        noise: mean intensity in a gate at an omnidirectional receiver, uPa^2.
    """

    gates: Gates
    level: float
    noise: float


def ranges(reach: float, bins: int, c: float, stretch: float, pulse: Pulse) -> Ranges:
    """Return the gates of a ping, one for each bin.

    The receiver filters to what its bins resolve: a pulse whose resolution is finer than a bin counts as if it resolved one bin.

    Args:
        reach: range at the end of the last bin, as the device believes, m.
        bins: number of bins.
        c: sound speed, m/s.
        stretch: believed over true sound speed.
        pulse: that is sent.
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
        scattering: backscatter of a cubic metre of water, 1/m, linear.
        height: height of the surface above the transducer, m.
        lambert: (n) Lambert's parameter of each material, linear, as in `Scope`.
    """

    alpha: float
    scattering: float
    height: float
    lambert: FloatArray


class Paths(NamedTuple):
    """Which paths sound takes besides the straight one.

    Attributes:
        surface, bottom: whether surface and bottom act as mirrors, so that echoes come by way of them too (ghosts).
        again: true range (m) behind which echoes of the ping before arrive together with those of this one; 0 for never.
    """

    surface: bool = False
    bottom: bool = False
    again: float = 0.0


class Echoes:
    """Casts the rays of one swath. It keeps work space, so only one ping at a time may use it."""

    def __init__(self, swath: Swath, bins: int) -> None:
        """Take the swath of a sonar with so many bins."""
        self._swath = swath
        self._second: FloatArray = np.zeros((swath.columns, 0))

    def energy(
        self, geometry: Geometry, water: Water, p: Vec3, R: FloatArray, ranges: Ranges, paths: Paths
    ) -> FloatArray:
        """Return the mean intensity of the echoes (columns, gates), uPa^2.

        Args:
            geometry: solids at the instant of the ping.
            water: around the sonar.
            p, R: position (m) of the transducer in N, and rotation matrix from the swath to N.
            ranges: ranges of the ping.
            paths: that sound takes.
        """
        # Imported here because numba takes half a second.
        from uwserver.physics.rays.echoes import Ground
        from uwserver.physics.rays.hits import intersect_level

        swath, gates = self._swath, ranges.gates
        direction: FloatArray = swath.grid.direction @ R.T
        farthest = BEYOND * gates.total / gates.per_metre
        if paths.again:
            farthest = max(farthest, paths.again + gates.total / gates.per_metre)
        hits = geometry.raycast(np.tile(p, (len(direction), 1)), direction, farthest)
        # The sea surface is a function, not a mesh. It is taken as level here; from below it reflects like a very rough bottom.
        intersect_level(water.height, direction, farthest, SURFACE, *hits)
        ground = Ground(water.lambert, MU_SURFACE)
        out = np.zeros((swath.columns, gates.total))
        for shift in (0.0, paths.again * gates.per_metre) if paths.again else (0.0,):
            second = self._cleared(gates.total)
            echoes.deposit_columns(
                swath.grid.cells, direction, R, *hits, ground, gates.per_metre, swath.column, shift, ranges.level, second
            )  # fmt: skip
            for chosen, loss in _mirrors(hits, paths):
                again = self._ghosts(geometry, p, direction, hits, chosen, farthest)
                cells, column = swath.grid.cells[chosen], swath.column[chosen]
                level = ranges.level * 10.0 ** (-0.2 * loss)
                echoes.deposit_columns(
                    cells, direction[chosen], R, *again, ground, gates.per_metre, column, shift, level, second
                )
            columns.energies(second, shift, gates.per_metre, water.alpha, out)
            if water.scattering > 0.0:
                strength = water.scattering * ranges.level
                emitted = np.ascontiguousarray(swath.grid.cells["emitted"])
                columns.volume(emitted, hits.distance, hits.body, strength, shift, gates.per_metre, water.alpha, out)
        return out

    def _cleared(self, gates: int) -> FloatArray:
        """Return the second differences of the energy (columns, gates + 3), all 0."""
        if self._second.shape[1] != gates + 3:
            self._second = np.zeros((self._swath.columns, gates + 3))
        self._second[:] = 0.0
        return self._second

    @staticmethod
    def _ghosts(
        geometry: Geometry, p: Vec3, direction: FloatArray, hits: Hits, chosen: IntArray, farthest: float
    ) -> Hits:
        """Return what the chosen rays hit by way of a mirror."""
        start, towards = reflected(hits, chosen, np.array(p), direction)
        count, padded = len(chosen), _LEAST_RAYS
        while padded < count:  # few different numbers of rays: an engine keeps arrays for each
            padded *= 2
        start, towards = (
            np.concatenate([each, np.repeat(each[-1:], padded - count, axis=0)]) for each in (start, towards)
        )
        found = geometry.raycast(start, towards, farthest)
        distance, normal, body, material = found
        return unfolded(hits, chosen, Hits(distance[:count], normal[:count], body[:count], material[:count]))


def _mirrors(hits: Hits, paths: Paths) -> list[tuple[IntArray, float]]:
    """Return for each mirror the rays that hit it, and its loss, dB."""
    is_bottom = (hits.body != NOTHING) & (hits.body != SURFACE) & (hits.normal[:, 2] < _UP)
    mirrors = (
        (paths.surface, hits.body == SURFACE, SURFACE_LOSS_DB),
        (paths.bottom, is_bottom, BOTTOM_LOSS_DB),
    )
    return [(np.flatnonzero(hit), loss) for reflects, hit, loss in mirrors if reflects and hit.any()]


class Noise(NamedTuple):
    """The random parts of a ping.

    Attributes:
        key: key of the sensor's random numbers.
        number: drawn for the ping.
        faded, share: as `speckle.fading` returns them.
        bursts: (n, 4) sound of other sonars, see `voices`.
    """

    key: int
    number: int
    faded: IntArray
    share: FloatArray
    bursts: FloatArray = NO_BURSTS


def hear(swath: Swath, energy: FloatArray, ranges: Ranges, noise: Noise | None) -> Plane:
    """Return what the beams hear.

    Args:
        swath: swath of the sonar.
        energy: (columns, gates) as `Echoes.energy` returns it.
        ranges: ranges of the ping.
        noise: None for the mean, without speckle.

    Returns:
        (2, beams, gates) real and imaginary part, uPa; without noise (1, beams, gates) intensity, uPa^2.
    """
    waves, pattern = waves_of(energy, noise), swath.power if noise is None else swath.pattern
    sound = np.empty((len(waves), len(swath.azimuth), energy.shape[1]), np.float32)
    for plane, wave in enumerate(waves):
        columns.form_beams(pattern, wave, sound[plane])
    received(sound, ranges, noise, swath.directivity)
    return sound


def waves_of(energy: FloatArray, noise: Noise | None) -> Plane:
    """Return the sound of each column with its speckle (2, columns, gates), uPa; without noise (1, columns, gates) intensity, uPa^2."""
    if noise is None:
        return energy.astype(np.float32)[None]
    waves = np.empty((2, *energy.shape), np.float32)
    columns.scatter(energy, np.uint64(noise.key), noise.faded, noise.share, speckle.PHASORS, waves)
    return waves


def received(sound: Plane, ranges: Ranges, noise: Noise | None, directivity: float) -> None:
    """Apply `columns.receive` in place, for a receiver with this directivity (a ratio)."""
    key, number, bursts = (0, 0, NO_BURSTS) if noise is None else (noise.key, noise.number, noise.bursts)
    inside = ranges.noise / directivity
    columns.receive(inside, bursts, np.uint64(key), np.uint64(number), ranges.gates.window, speckle.PHASORS, sound)


def gain_over_range(reach: float, bins: int, spreading: float, alpha: float, limit: float) -> FloatArray:
    """Return the time-varied gain of each bin (bins), dB: spreading lg r + 2 alpha r, at most the limit."""
    r = (np.arange(bins) + 0.5) * (reach / bins)
    result: FloatArray = np.minimum(spreading * np.log10(r) + 2.0 * alpha * r, limit)
    return result


def picture_of(sound: Plane, gain: FloatArray, level: FloatArray, steps: float, output: Output) -> npt.NDArray[Any]:
    """Return what a sonar gives of the sound in its bins.

    Args:
        sound: (2 or 1, beams, gates >= bins) as `hear` returns it.
        gain: (beams) gain of each beam's channel, by intensity.
        level: (bins) what is added to the level for counts, dB.
        steps: counts per dB.
        output: what the result is.

    Returns:
        (bins, beams) uint8 counts or float32 pressure (Pa); or (bins, beams, 2) real and imaginary part, float32, Pa.
    """
    sound = sound[:, :, : len(level)]
    if len(sound) == 1:  # an amplitude of the same intensity, with phase 0
        sound = np.concatenate([np.sqrt(sound), np.zeros_like(sound)])
    if output == "complex":
        factor = (1e-6 * np.sqrt(gain)).astype(np.float32)
        return np.ascontiguousarray((sound * factor[None, :, None]).transpose(2, 1, 0))
    intensity = np.empty((len(level), sound.shape[1]), np.float32)
    columns.intensities(sound, gain.astype(np.float32), intensity)
    if output == "pressure":
        pressure: Plane = np.float32(1e-6) * np.sqrt(intensity)
        return pressure
    counts = np.empty(intensity.shape, np.uint8)
    columns.counts(intensity, level, steps, columns.LOGARITHMS, counts)
    return counts


Methods = npt.NDArray[np.uint8]
Apart = Callable[[IntArray], tuple[Plane, int]]
"""Takes `spans` (beams, 2), the gates that count in each beam. Returns the difference of both halves of the array in these gates, (2, beams, some
gates), and the number of its first gate."""


class Soundings(NamedTuple):
    """What was found in each beam.

    Attributes:
        place: middle of the echo, gates from the start; NaN if there is no echo.
        level: mean intensity in the echo, uPa^2.
        hits: gates in it that are above the threshold.
        quality: part of the echo that is not noise, 0 to 1.
        method: uint8, how the place was found, see `soundings`.
    """

    place: FloatArray
    level: FloatArray
    hits: IntArray
    quality: FloatArray
    method: Methods


class Array(NamedTuple):
    """How beams hear columns.

    Attributes:
        pattern, power: (beams, columns) amplitude and power.
        bands: as `soundings.bands` returns them.
        apart: (beams, columns) of `array.difference`; None for an array that does not compare its halves.
    """

    pattern: Plane
    power: Plane
    bands: IntArray
    apart: Plane | None = None


def listen(
    energy: FloatArray, ranges: Ranges, noise: Noise | None, directivity: float, array: Array
) -> tuple[Plane, Apart | None]:
    """Return what narrow beams hear, without their far side lobes, and the function that compares both halves of the array.

    Args:
        energy: (columns, gates) mean intensity of the echoes, uPa^2.
        ranges: ranges of the ping.
        noise: None for the mean, without speckle.
        directivity: directivity of a receiver, as a ratio.
        array: how the beams hear the columns.

    Returns:
        (2, beams, gates) real and imaginary part, uPa; without noise (1, beams, gates) intensity, uPa^2. And the function, None without noise or
        for an array that does not compare its halves.
    """
    waves, whole = waves_of(energy, noise), np.array(((0, energy.shape[1]),) * len(array.bands))
    together = _beams(waves, array.power if noise is None else array.pattern, array.bands, whole, 0, energy.shape[1])
    received(together, ranges, noise, directivity)
    if noise is None or array.apart is None:
        return together, None
    pattern, own = array.apart, noise

    def apart(spans: IntArray) -> tuple[Plane, int]:
        # As the pulse is several gates long, a gate hears those around it.
        more, seen = math.ceil(ranges.gates.window) + 1, spans[:, 1] > spans[:, 0]
        around = np.where(seen[:, None], np.clip(spans + np.array((-more, more)), 0, energy.shape[1]), 0)
        start, end = (int(around[seen, 0].min()), int(around[:, 1].max())) if seen.any() else (0, 0)
        heard = _beams(waves, pattern, array.bands, around, start, end)
        # The noise of both halves is independent, and therefore also the noise of their sum and of their difference.
        bursts = own.bursts.copy()
        bursts[:, [FIRST, END]] = np.maximum(bursts[:, [FIRST, END]] - start, 0.0)
        received(heard, ranges, own._replace(number=own.number | _OTHER, bursts=bursts), directivity)
        return heard, start

    return together, apart


def _beams(waves: Plane, pattern: Plane, bands: IntArray, spans: IntArray, start: int, end: int) -> Plane:
    """Return (planes, beams, end - start) sums of the columns in the spans (beams, 2) of gates; see `soundings.form_bands`."""
    sound = np.empty((len(waves), len(bands), end - start), np.float32)
    for plane, wave in enumerate(waves):
        soundings.form_bands(pattern, bands, wave, spans, start, sound[plane])
    return sound


def blanked(sound: Plane, least: float, gate: float) -> None:
    """Silence, in place, what comes from nearer than `least` (m); `gate`: length of a gate, m."""
    sound[:, :, : math.ceil(least / gate - 0.5)] = 0.0


def thresholds(ranges: Ranges, directivity: float, alpha: float, threshold_db: float) -> tuple[float, float, float]:
    """Return the levels against which echoes of a ping are measured. Arguments as of `sound_out`.

    Returns:
        Mean noise in a gate after the pulse has its full length, uPa^2; least intensity of an echo, uPa^2; and the exponent of the loss of
        intensity by absorption from gate to gate.
    """
    around = max(ranges.noise * ranges.gates.window / directivity, 1e-300)
    return around, around * 10.0 ** (0.1 * threshold_db), 2.0 * DECIBEL * alpha / ranges.gates.per_metre


def sound_out(
    sound: Plane, bins: int, ranges: Ranges, directivity: float, alpha: float, threshold_db: float, apart: Apart | None = None
) -> Soundings:  # fmt: skip
    """Find the echo of each beam.

    Args:
        sound: as `listen` returns it.
        bins: gates that count.
        ranges, directivity: those of the ping.
        alpha: absorption, dB/m. Weights make up for it, so that the far part of an echo counts as much as the near part.
        threshold_db: level above the mean noise from which on a gate counts.
        apart: as `listen` returns it; without it phases are not used.
    """
    beams = sound.shape[1]
    around, least, loss = thresholds(ranges, directivity, alpha, threshold_db)
    place, level, hits, half = np.empty(beams), np.empty(beams), np.empty(beams, np.int64), np.empty(beams)
    soundings.find(sound, bins, least, loss, False, place, level, hits, half)
    method = np.where(hits > 0, soundings.BY_AMPLITUDE, soundings.NOTHING_FOUND).astype(np.uint8)
    if apart is not None:
        spans = soundings.phase_gates(place, half, bins)
        difference, start = apart(spans)
        soundings.cross(sound, difference, spans, start, least, half, place, method)
    quality: FloatArray = np.where(hits > 0, level / (level + around), 0.0)
    return Soundings(place, level, hits, quality, method)
