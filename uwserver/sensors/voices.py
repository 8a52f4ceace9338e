"""How sonars of one vehicle sound to each other, as rows, and what is heard of them in a ping (compiled)."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import Array, FloatArray, Records
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.physics.kernel.random import normals

VOICE = np.dtype(
    [
        ("body", "i8"),  # row of the body that carries it
        ("works", "i8"),  # 1: it is switched on, and no fault keeps it silent
        ("key", "u8"),  # of its random numbers: what is heard of it does not depend on where its row lies
        ("p", "f8", (3,)),  # of its transducer in B, m
        ("frequency", "f8"),  # Hz
        ("bandwidth", "f8"),
        ("level", "f8"),  # of its source, dB re 1 uPa at 1 m
        ("length", "f8"),  # of its pulse, s
        ("range", "f8"),  # m
        ("speed", "f8"),  # of sound, as it believes, m/s; 0 for the truth
        ("overhead", "f8"),  # from the end of a ping to the next one, s
        ("ready", "f8"),  # time from which it may ping next, s; 0 where it never did
        ("dt", "f8"),  # it pings at multiples of this, s
    ]
)
"""How a sonar sounds. Who pings says so here, and so does whoever changes it."""

NO_VOICES: Records = np.zeros(0, VOICE)
FIRST, END, INTENSITY, WHOSE = range(4)
"""Columns of bursts (n, 4), sound of other sonars in one ping: the gate from which on it is heard, the one behind it, its mean intensity within the
listener's band (uPa^2), and what tells its noise from that of all others: of the sonar and of its ping, a whole number below 2**52."""
NO_BURSTS: FloatArray = np.zeros((0, 4))
MOST = 101
"""Pings of another sonar that are heard in one of the listener's."""

_NEAREST = 0.1
"""m: what is nearer counts as if it were there, for transducers are no points."""
_TICK = 1e-6
_HEARD = 3
"""What random numbers are drawn for; others are in `kernel.random`."""
_REST, _PINGS = np.uint64(20), np.uint64(8)
"""Bits of a sonar's key that are left out, and bits behind the others for the number of its ping: both stand in WHOSE."""
_SONAR, _PING = np.uint64(12), np.uint64(56)
"""Where they lie in what its noise is drawn by."""


@compiled
def period(c: float, reach: float, speed: float, overhead: float) -> float:
    """From a ping to the time from which the next one may follow (s), where the sound speed is c (m/s); the others are of VOICE."""
    return 2.0 * reach / (speed if speed > 0.0 else c) + overhead


@compiled
def _due(t: float, dt: float) -> float:
    return math.ceil((t - _TICK) / dt) * dt


@compiled
def pings(ready: float, busy: float, dt: float, since: float, now: float, until: float, out: Array) -> int:
    """Times (s) of a sonar's pings, by its pace now: the last one, if it was later than `since`, and those to come before `until`.

    Args:
        ready, dt: of VOICE.
        busy: of `period`.
        since, now, until: s.
        out: (MOST) receives them.

    Returns:
        How many.
    """
    count, began = 0, ready - busy
    if ready > 0.0 and began > since:
        out[0] = began
        count = 1
    t = _due(max(ready, now), dt)
    for _ in range(MOST - 1):
        if t >= until:
            break
        out[count] = t
        count += 1
        t = _due(max(t + busy, t + 0.5 * dt), dt)
    return count


@compiled
def _shared(frequency: float, bandwidth: float, other: float, width: float) -> float:
    """Part of the other's band that lies in the first one."""
    low = max(frequency - 0.5 * bandwidth, other - 0.5 * width)
    high = min(frequency + 0.5 * bandwidth, other + 0.5 * width)
    return min(max(high - low, 0.0) / width, 1.0)


@compiled
def _by_key(voices: Array) -> Array:
    """Rows of voices in the order of their keys: their own depends on who came and went before."""
    order = np.arange(len(voices))
    for i in range(1, len(order)):
        j = i
        while j > 0 and voices[order[j]].key < voices[order[j - 1]].key:
            order[j], order[j - 1] = order[j - 1], order[j]
            j -= 1
    return order


@compiled
def find_bursts(
    voices: Array, mine: int, heard: Array, c: float, relative: float, t: float, per_metre: float, window: float, total: int, out: Array
) -> int:  # fmt: skip
    """What is heard of others in a ping that begins now.

    Args:
        voices: (n) of VOICE.
        mine: number of the listener's own.
        heard: (n) bool, which of the others may be heard: those that work, under water.
        c: sound speed, m/s.
        relative: level of another sonar's sound beside that of its axis, dB.
        t: now, s.
        per_metre, window, total: of the gates of the ping (`imaging.echoes.Gates`).
        out: (m, 4) receives bursts, by the keys of the sonars: room for MOST of each that is heard.

    Returns:
        How many bursts.
    """
    me, per_second, count, times = voices[mine], 0.5 * c * per_metre, 0, np.empty(MOST)
    bandwidth = min(me.bandwidth, per_second / window)  # of what the bins resolve
    for k in _by_key(voices):
        voice = voices[k]
        share = _shared(me.frequency, bandwidth, voice.frequency, voice.bandwidth) if heard[k] else 0.0
        if k == mine or share <= 0.0:
            continue
        square = (me.p[0] - voice.p[0]) ** 2 + (me.p[1] - voice.p[1]) ** 2 + (me.p[2] - voice.p[2]) ** 2
        away = max(math.sqrt(square), _NEAREST)
        intensity, late = share * 10.0 ** (0.1 * (voice.level + relative)) / away**2, away / c
        busy = period(c, voice.range, voice.speed, voice.overhead)
        since, until = t - late - voice.length, t + total / per_second - late
        for n in range(pings(voice.ready, busy, voice.dt, since, t, until, times)):
            start = (times[n] + late - t) * per_second
            first, end = max(math.floor(start), 0), min(math.ceil(start + voice.length * per_second), total)
            if first < end:
                whose = (voice.key >> _REST << _PINGS) + np.uint64(n)
                out[count, FIRST], out[count, END], out[count, INTENSITY], out[count, WHOSE] = (
                    first,
                    end,
                    intensity,
                    whose,
                )
                count += 1
    return count


@compiled
def add_burst(burst: Array, beam: int, key: int, number: int, window: float, real: Array, imaginary: Array) -> None:
    """Add a burst to what a beam hears, independent in each gate.

    Args:
        burst: (4) as a row of those.
        beam: number of the beam.
        key, number: of the sensor's random numbers, and of the ping.
        window: gates that the resolution of the pulse is long, whose sum has the intensity.
        real, imaginary: (gates) of the beam, uPa, to which is added.
    """
    root, gates = math.sqrt(0.5 * burst[INTENSITY] / window), len(real)
    whose = np.uint64(burst[WHOSE])
    mixed = np.uint64(number) ^ (whose >> _PINGS << _SONAR) ^ (whose << _PING)
    for k in range(int(burst[FIRST]), min(int(burst[END]), gates)):
        a, b = normals(key, mixed, _HEARD, beam * gates + k)
        real[k] += root * a
        imaginary[k] += root * b


find_bursts_at_once = entry(find_bursts.py_func)
"""`find_bursts`, for who pings in Python."""


@compiled
def add_bursts(bursts: Array, key: int, number: int, window: float, sound: Array) -> None:
    """Add bursts to what a ping brings, independent in each beam and gate.

    Args:
        bursts: (n, 4).
        key, number, window: of `add_burst`.
        sound: (2, beams, gates) real and imaginary part, uPa, to which is added.
    """
    for b in range(sound.shape[1]):
        for k in range(len(bursts)):
            add_burst(bursts[k], b, key, number, window, sound[0, b], sound[1, b])
