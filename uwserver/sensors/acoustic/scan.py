"""The bins of a scanning sonar's ping, from what its rays hit (compiled).

In all functions `head` is the row of the sonar in `compiled.HEAD`, `row` its record (hit_surface `scanning_sonar`), and `surroundings` what it sees.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.sensors.acoustic.cross_talk import overheard, sound_speed
from uwserver.sensors.acoustic.head import axes
from uwserver.sensors.acoustic.imaging.blocks import block_of, hit_surface, kept
from uwserver.sensors.acoustic.imaging.echoes import deposit, energies, gates
from uwserver.sensors.acoustic.imaging.speckle import DIRECTIONS, compress, detect, detect_mean, fade, scatter
from uwserver.sensors.acoustic.receiver import BEYOND
from uwserver.sensors.compiled import ground_of, p_NS, q_NS, sound_absorption, submergence
from uwserver.sensors.voices import add_burst

COUNTS, PRESSURE, COMPLEX = range(3)
"""Values of `output` in a record: what the bins are."""
FULL_SCALE = 255.0

_gates, _fade = compiled(gates), compiled(fade.py_func)


@compiled
def farthest(row: Any, stretch: float) -> float:
    """Return how far rays reach, m; `stretch`: believed over true sound speed."""
    return float(BEYOND * row.reach / min(stretch, 1.0))


@compiled
def _energy(
    row: Any, surroundings: Array, R: Array, alpha: float, divided: Any, finer: Array, hits: Any, out: Array
) -> None:
    """Find the mean intensity of the echoes in each gate, uPa^2.

    Args:
        row, surroundings: of the sonar.
        R: (3, 3) whose columns are the axes of its head in N.
        alpha: absorption, dB/m.
        divided: gates of the ping.
        finer, hits: directions (n, 3) of the finer rays, and what they hit; what the rays of the fan hit is kept in the block.
        out: (gates) receives the intensities.
    """
    block, ground, second = block_of(row), ground_of(surroundings), np.zeros((1, divided.total + 3))
    met, column = kept(block), np.zeros(max(len(block.cells), len(finer)), np.int64)
    deposit(
        block.cells, block.towards, R, met.distance, met.normal, met.body, met.material, ground, divided.per_metre, column, 0.0, 1.0, second
    )  # fmt: skip
    if len(finer) > 0:
        cells = block.finer[: len(finer)]
        deposit(
            cells, finer, R, hits.distance, hits.normal, hits.body, hits.material, ground, divided.per_metre, column, 0.0, 1.0, second
        )  # fmt: skip
    energies(second[0], divided.per_metre, alpha, out)


@compiled
def _receive(
    head: Any, row: Any, surroundings: Array, t: float, p: Vec3, R: Array, c: float, divided: Any, energy: Array, sound: Array
) -> None:  # fmt: skip
    """Find the strongest sample of the matched filter in each bin; without errors its mean, with phase 0.

    Args:
        head, row, surroundings, t: of the sonar; t in s.
        p, R: position of its head in N, m, and (3, 3) whose columns are its axes.
        c: sound speed, m/s.
        divided: gates of the ping.
        energy: (gates) mean intensity of the echoes, uPa^2.
        sound: (bins, 2) receives real and imaginary part, uPa.
    """
    if head.exact != 0:
        mean = np.empty(row.bins)
        detect_mean(energy, divided.window, divided.per_bin, mean)
        for k in range(row.bins):
            sound[k, 0], sound[k, 1] = math.sqrt(mean[k]), 0.0
        return
    block, field, axis = block_of(row), np.empty((divided.total, 2)), (R[0, 0], R[1, 0], R[2, 0])
    faded, share = np.empty(DIRECTIONS, np.int64), np.empty(DIRECTIONS)
    _fade(p, axis, row.fade_length, row.fade_angle, block.ways, faded, share)
    noise = row.noise * row.noise / divided.window
    scatter(energy, head.key, head.number, noise, faded, share, block.phasors, field)
    if row.hears != 0:
        bursts = overheard(head, surroundings, t, c, row.relative, divided)
        for k in range(len(bursts)):
            add_burst(bursts[k], 0, head.key, head.number, divided.window, field[:, 0], field[:, 1])
    detect(field, divided.window, divided.per_bin, sound)


@compiled
def _write_bins(row: Any, alpha: float, sound: Array, out: Array) -> None:
    """Write the bins of a reading (bins) as counts or pressure. Complex bins are a buffer, which Python makes."""
    if row.output == COMPLEX:
        return
    intensity = sound[:, 0] * sound[:, 0] + sound[:, 1] * sound[:, 1]
    if row.output == PRESSURE:
        out[:] = 1e-6 * np.sqrt(intensity)
        return
    counts = out.view(np.int64)
    compress(
        intensity, row.reach / row.bins, row.spreading, alpha, row.most_gain, row.gain - row.floor, row.steps, FULL_SCALE, counts
    )  # fmt: skip


@compiled
def _write_paper_bins(row: Any, out: Array) -> None:
    """Write the bins of the model in the paper (UW-MORSE, section IV-B): the sum of the cosines of incidence of the rays that hit within each bin.

    It is divided by the number of rays, so it is 1 if all of them hit at right angles.
    """
    block = block_of(row)
    hits, picture, per_metre = kept(block), np.zeros(row.bins), row.bins / row.reach
    for i in range(len(hits.distance)):
        if hits.distance[i] <= row.reach:
            cosine = 0.0
            for j in range(3):
                cosine += hits.normal[i, j] * block.towards[i, j]
            picture[min(int(hits.distance[i] * per_metre), row.bins - 1)] += abs(cosine)
    counts = out.view(np.int64)
    for k in range(row.bins):
        share = picture[k] / len(hits.distance)
        if row.output == COUNTS:
            counts[k] = int(np.rint(FULL_SCALE * share))
        else:
            out[k] = share


@compiled
def hear(
    head: Any, row: Any, surroundings: Array, t: float, direction: Array, hits: Any, sound: Array, out: Array
) -> None:
    """Make the bins of a ping under water.

    Args:
        head, row, surroundings, t: of the sonar; t in s.
        direction, hits: directions (n, 3) of the finer rays, and what they hit; what the rays of the fan hit is kept in the block.
        sound: (bins, 2) receives real and imaginary part of each bin, uPa; not used by the model of the paper.
        out: (bins) receives counts or pressure.
    """
    if row.paper != 0:
        _write_paper_bins(row, out)
        return
    p, R = p_NS(head, surroundings), np.empty((3, 3))
    c, believed = sound_speed(head, row, surroundings, p[2])
    # Absorption changes so little that an instrument asks for it once a metre.
    alpha, stretch = sound_absorption(surroundings, row.frequency, np.rint(p[2])), believed / c
    divided = _gates(row.reach, row.bins, c / (2.0 * row.bandwidth), stretch)
    hit_surface(submergence(surroundings, p, t), direction, farthest(row, stretch), hits)
    axes(q_NS(head, surroundings), row.angle, R)
    energy = np.empty(divided.total)
    _energy(row, surroundings, R, alpha, divided, direction, hits, energy)
    _receive(head, row, surroundings, t, p, R, c, divided, energy, sound)
    _write_bins(row, alpha, sound, out)
