"""The kernels of sonars that Python calls, so that all of them can be compiled before anything runs."""

from __future__ import annotations

from functools import cache

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.raycast import no_hits
from uwserver.sensors import voices
from uwserver.sensors.acoustic.imaging import columns, echoes, soundings, speckle
from uwserver.sensors.acoustic.imaging.fan import Fan

KERNELS = (
    speckle.fade, voices.find_bursts_at_once, echoes.deposit_columns, columns.energies, columns.volume, columns.scatter,
    columns.form_beams, columns.receive, columns.intensities, columns.counts, soundings.form_bands, soundings.find,
    soundings.cross,
)  # fmt: skip
"""Kernels that Python calls."""


@cache
def load() -> None:
    """Run each kernel once, compiled or from the cache, so that no reading waits for it.

    Raises:
        RuntimeError: a thin thing in the middle of the beam gives no echo.
    """
    from uwserver.physics.rays.echoes import Ground

    fan, hits = Fan(0.1, 0.1, 5, 5, 1.0), no_hits(25)
    hits.distance[12], hits.body[12], hits.normal[12] = 5.0, 0, (-1.0, 0.0, 0.0)
    seconds, energy, column = np.zeros((4, 13)), np.zeros((4, 10)), np.tile(np.arange(4), 7)[:25]
    echoes.deposit_columns(
        fan.cells, fan.direction, np.eye(3), *hits, Ground(np.ones(1), 1.0), 1.0, column, 0.0, 1.0, seconds
    )  # fmt: skip
    columns.energies(seconds, 0.0, 1.0, 0.01, energy)
    if not energy[0, 5] > 0.0 == energy[0, 8]:
        raise RuntimeError("the kernels of sonars heard no echo: reinstall numpy and numba")
    columns.volume(
        np.ascontiguousarray(fan.cells["emitted"])[:24], hits.distance[:24], hits.body[:24], 1.0, 0.0, 1.0, 0.01, energy
    )
    _load_beams(energy)


def _load_beams(energy: FloatArray) -> None:
    """Run the kernels that make beams of columns."""
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
    columns.receive(1.0, voices.NO_BURSTS, np.uint64(0), np.uint64(0), 2.5, speckle.PHASORS, sound)
    columns.intensities(sound, np.ones(4, np.float32), image)
    columns.intensities(
        sound[:, :, 1:], np.ones(4, np.float32), image[1:]
    )  # a ping of more gates than the picture has bins
    columns.counts(image, np.zeros(10), 1.0, columns.LOGARITHMS, np.zeros((10, 4), np.uint8))
    heard = np.zeros(2, voices.VOICE)
    voices.find_bursts_at_once(heard, 0, np.zeros(2, bool), 1500.0, 0.0, 0.0, 1.0, 1.0, 10, np.empty((0, 4)))
