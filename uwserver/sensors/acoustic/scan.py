"""From what the rays of a scanning sonar meet to the bins of its ping (compiled)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.sensors.acoustic.cross_talk import overheard, sound_speed
from uwserver.sensors.acoustic.head import axes
from uwserver.sensors.acoustic.imaging.blocks import block_of
from uwserver.sensors.acoustic.imaging.echoes import deposit, energies, gates
from uwserver.sensors.acoustic.imaging.fan_rays import kept, see
from uwserver.sensors.acoustic.imaging.speckle import DIRECTIONS, compress, detect, detect_mean, fade, scatter
from uwserver.sensors.acoustic.receiver import BEYOND
from uwserver.sensors.bank import ground_of, p_NS, q_NS, sound_absorption, submergence
from uwserver.sensors.voices import add_burst

COUNTS, PRESSURE, COMPLEX = range(3)
"""What the bins are."""
FULL_SCALE = 255.0

_gates, _fade = compiled(gates), compiled(fade.py_func)


@compiled
def farthest(row: Any, stretch: float) -> float:
    """How far rays look (m), where the believed sound speed is so many times the true one."""
    return float(BEYOND * row.reach / min(stretch, 1.0))


@compiled
def _energy(row: Any, now: Array, R: Array, alpha: float, divided: Any, finer: Array, hits: Any, out: Array) -> None:
    """Mean intensity of the echoes of each gate, uPa^2: what the rays of the fan have met, and the finer ones (n, 3), which have met `hits`."""
    block, ground, second = block_of(row), ground_of(now), np.zeros(divided.total + 3)
    met = kept(block)
    deposit(
        block.cells, block.towards, R, met.distance, met.normal, met.body, met.material, ground, divided.per_metre, second
    )  # fmt: skip
    if len(finer) > 0:
        cells = block.finer[: len(finer)]
        deposit(
            cells, finer, R, hits.distance, hits.normal, hits.body, hits.material, ground, divided.per_metre, second
        )
    energies(second, divided.per_metre, alpha, out)


@compiled
def _receive(
    head: Any, row: Any, now: Array, t: float, p: Vec3, R: Array, c: float, divided: Any, energy: Array, sound: Array
) -> None:  # fmt: skip
    """Real and imaginary part (bins, 2), uPa: the peak of what the pulse leaves of the echoes (gates) in each bin; the mean has the phase 0."""
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
        bursts = overheard(head, now, t, c, row.relative, divided)
        for k in range(len(bursts)):
            add_burst(bursts[k], 0, head.key, head.number, divided.window, field[:, 0], field[:, 1])
    detect(field, divided.window, divided.per_bin, sound)


@compiled
def _tell(row: Any, alpha: float, sound: Array, out: Array) -> None:
    """The bins of a reading (bins); complex ones are no numbers."""
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
def _show(row: Any, out: Array) -> None:
    """The picture of the paper (UW-MORSE, section IV-B): the cosine of incidence of each ray, summed over the bin of its range; 1 if all rays hit at
    right angles."""
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
def hear(head: Any, row: Any, now: Array, t: float, direction: Array, hits: Any, sound: Array, out: Array) -> None:
    """The bins of a ping under water.

    Args:
        head, row: of the sonar.
        now: what it sees.
        t: s.
        direction, hits: (n, 3) of the finer rays, and what they have met; what those of its fan have met is kept in its block.
        sound: (bins, 2) receives real and imaginary part of each bin, uPa; not of the paper's picture.
        out: (bins) receives what is told of them, where that is numbers.
    """
    if row.paper != 0:
        _show(row, out)
        return
    p, R = p_NS(head, now), np.empty((3, 3))
    c, believed = sound_speed(head, row, now, p[2])
    # Absorption changes so little that an instrument asks for it once a metre.
    alpha, stretch = sound_absorption(now, row.frequency, np.rint(p[2])), believed / c
    divided = _gates(row.reach, row.bins, c / (2.0 * row.bandwidth), stretch)
    see(submergence(now, p, t), direction, farthest(row, stretch), hits)
    axes(q_NS(head, now), row.angle, R)
    energy = np.empty(divided.total)
    _energy(row, now, R, alpha, divided, direction, hits, energy)
    _receive(head, row, now, t, p, R, c, divided, energy, sound)
    _tell(row, alpha, sound, out)
