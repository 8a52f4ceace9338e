"""The compiled part of this room, all at once: for who compiles before anything runs."""

from __future__ import annotations

from functools import cache

import numpy as np

from uwserver.physics.rays.raycast import no_hits
from uwserver.sensors.acoustic.imaging import echoes, silhouettes, speckle
from uwserver.sensors.acoustic.imaging.fan import Fan
from uwserver.sensors.acoustic.imaging.silhouettes import Silhouettes

KERNELS = (
    silhouettes.find_thin, silhouettes.cut, echoes.deposit, echoes.energies, speckle.scatter, speckle.detect,
    speckle.detect_mean, speckle.compress,
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
    field, bins, counts = np.empty((gates.total, 2)), np.empty(10), np.empty(10, np.int64)
    faded, share = speckle.fading((0.0, 0.0, 0.0), np.array((1.0, 0.0, 0.0)), 1.0, 1.0)
    speckle.scatter(energy, np.uint64(0), 0, 0.0, faded, share, speckle.PHASORS, field)
    speckle.detect(field, gates.window, gates.per_bin, bins)
    speckle.compress(bins, 1.0, 30.0, 0.01, 60.0, 100.0, 1.0, 255.0, counts)
    speckle.detect_mean(energy, gates.window, gates.per_bin, bins)
    if not bins[5] > 0.0 == bins[8] or Silhouettes(fan).refine(hits, fan.direction) is None:
        raise RuntimeError("the kernels of sonars heard no echo: reinstall numpy and numba")
