"""The compiled part of this room, all at once: for who compiles before anything runs."""

from __future__ import annotations

from functools import cache

import numpy as np

from uwserver.physics.rays.raycast import Hits, no_hits
from uwserver.sensors.acoustic.imaging import columns, echoes, silhouettes, soundings, speckle
from uwserver.sensors.acoustic.imaging.fan import Fan
from uwserver.sensors.acoustic.imaging.silhouettes import Silhouettes

KERNELS = (
    silhouettes.find_thin, silhouettes.cut, echoes.deposit, echoes.energies, speckle.scatter, speckle.detect,
    speckle.detect_mean, speckle.compress, echoes.deposit_columns, columns.energies, columns.volume, columns.scatter, columns.form_beams,
    columns.add_noise, columns.lengthen, columns.intensities, columns.counts, soundings.form_bands, soundings.find,
    soundings.cross,
)  # fmt: skip
"""What Python calls."""


@cache
def load() -> None:
    """Run each once, compiled or from the cache, so that no reading waits for them.

    Raises:
        RuntimeError: they hear nothing of a thread in the middle of the beam.
    """
    from uwserver.physics.rays.echoes import Ground

    fan = Fan(0.1, 0.1, 5, 5, 1.0)
    hits, gates = no_hits(25), echoes.gates(10.0, 10, 0.5)
    hits.distance[12], hits.body[12], hits.normal[12] = 5.0, 0, (-1.0, 0.0, 0.0)
    second, energy = np.zeros(gates.total + 3), np.empty(gates.total)
    echoes.deposit(
        fan.cells, fan.direction, np.eye(3), *hits, Ground(np.ones(1), 1.0), gates.per_metre, second
    )  # fmt: skip
    echoes.energies(second, gates.per_metre, 0.01, energy)
    field, found, bins, counts = np.empty((gates.total, 2)), np.empty((10, 2)), np.empty(10), np.empty(10, np.int64)
    faded, share = speckle.fading((0.0, 0.0, 0.0), np.array((1.0, 0.0, 0.0)), 1.0, 1.0)
    speckle.scatter(energy, np.uint64(0), 0, 0.0, faded, share, speckle.PHASORS, field)
    speckle.detect(field, gates.window, gates.per_bin, found)
    bins[:] = np.square(found).sum(axis=1)
    speckle.compress(bins, 1.0, 30.0, 0.01, 60.0, 100.0, 1.0, 255.0, counts)
    speckle.detect_mean(energy, gates.window, gates.per_bin, bins)
    _load_columns(fan, hits)
    if not bins[5] > 0.0 == bins[8] or Silhouettes(fan).refine(hits, fan.direction) is None:
        raise RuntimeError("the kernels of sonars heard no echo: reinstall numpy and numba")


def _load_columns(fan: Fan, hits: Hits) -> None:
    """Those of sonars that form beams."""
    from uwserver.physics.rays.echoes import Ground

    seconds, energy, column = np.zeros((4, 13)), np.zeros((4, 10)), np.tile(np.arange(4), 7)[:25]
    echoes.deposit_columns(
        fan.cells, fan.direction, np.eye(3), *hits, Ground(np.ones(1), 1.0), 1.0, column, 0.0, 1.0, seconds
    )  # fmt: skip
    columns.energies(seconds, 0.0, 1.0, 0.01, energy)
    columns.volume(
        np.ascontiguousarray(fan.cells["emitted"])[:24], hits.distance[:24], hits.body[:24], 1.0, 0.0, 1.0, 0.01, energy
    )
    faded, share = speckle.fading((0.0, 0.0, 0.0), np.array((1.0, 0.0, 0.0)), 1.0, 1.0)
    sound, image = np.zeros((2, 4, 10), np.float32), np.zeros((10, 4), np.float32)
    columns.scatter(energy, np.uint64(0), faded, share, speckle.PHASORS, sound)
    columns.form_beams(np.ones((4, 4), np.float32), sound[0].copy(), sound[0])
    columns.form_beams(np.ones((4, 4), np.float32), energy.astype(np.float32), sound[1])
    spans = np.array([[0, 4]] * 4)
    soundings.form_bands(np.ones((4, 4), np.float32), spans, sound[0].copy(), spans, 0, sound[1])
    place, half = np.empty(4), np.empty(4)
    soundings.find(sound, 10, 0.0, 0.0, False, place, np.empty(4), np.empty(4, np.int64), half)
    soundings.cross(sound, sound, spans, 0, 0.0, half, place, np.empty(4, np.uint8))
    columns.add_noise(np.uint64(0), np.uint64(0), 1.0, speckle.PHASORS, sound)
    columns.lengthen(sound, 2, 0.5, np.zeros(10, np.float32))
    columns.intensities(sound, np.ones(4, np.float32), image)
    columns.counts(image, np.zeros(10), 1.0, columns.LOGARITHMS, np.zeros((10, 4), np.uint8))
