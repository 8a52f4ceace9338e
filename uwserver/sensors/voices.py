"""How the sonars of a vehicle disturb each other: the sound of each as a row, and what a ping receives of the others (compiled)."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import Array, FloatArray, Records
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.physics.kernel.random import normals

VOICE = np.dtype(
    [
        ("body", "i8"),  # row of the body that carries it
        ("works", "i8"),  # 1: the sonar is on, and no fault keeps it silent
        ("key", "u8"),  # of its random numbers; what is received does not depend on the order of rows
        ("p", "f8", (3,)),  # position of its transducer, m in B
        ("frequency", "f8"),  # Hz
        ("bandwidth", "f8"),
        ("level", "f8"),  # source level, dB re 1 uPa at 1 m
        ("length", "f8"),  # pulse length, s
        ("range", "f8"),  # m
        ("speed", "f8"),  # sound speed that it assumes, m/s; 0 for the true one
        ("overhead", "f8"),  # time from the end of a ping to the next one, s
        ("ready", "f8"),  # time from which it may ping next, s; 0 before its first ping
        ("dt", "f8"),  # it pings at multiples of this, s
    ]
)
"""The sound of a sonar. The sonar updates it when it pings, and so does whatever changes its settings."""

NO_VOICES: Records = np.zeros(0, VOICE)
FIRST, END, INTENSITY, WHOSE = range(4)
"""Columns of bursts (n, 4), the sound of other sonars in one ping: its first gate, the gate after its last one, its mean intensity within the
listener's band (uPa^2), and a whole number below 2**52, of the sonar and its ping, that makes its noise differ from that of all others."""
NO_BURSTS: FloatArray = np.zeros((0, 4))
MOST = 101
"""Most pings of another sonar that one ping of the listener receives."""

_NEAREST = 0.1
"""m. A sonar that is nearer counts as if it were this far away, because transducers are no points."""
_TICK = 1e-6
_HEARD = 3
"""Purpose of these random numbers; other purposes are in `kernel.random`."""
_REST, _PINGS = np.uint64(20), np.uint64(8)
"""How WHOSE is made: bits of a sonar's key that are left out, and bits after the rest of the key that hold the number of the ping."""
_SONAR, _PING = np.uint64(12), np.uint64(56)
"""By how many bits the two are shifted in the number that its noise is drawn with."""


@compiled
def period(c: float, reach: float, speed: float, overhead: float) -> float:
    """Return the time from a ping to the earliest next one (s). c: true sound speed, m/s; the others are fields of VOICE."""
    return 2.0 * reach / (speed if speed > 0.0 else c) + overhead


@compiled
def _due(t: float, dt: float) -> float:
    return math.ceil((t - _TICK) / dt) * dt


@compiled
def pings(ready: float, busy: float, dt: float, since: float, now: float, until: float, out: Array) -> int:
    """Find the times (s) of a sonar's pings at its present pace: the last one, if it was after `since`, and the coming ones before `until`.

    Args:
        ready, dt: fields of VOICE.
        busy: the result of `period`.
        since, now, until: s.
        out: (MOST) receives the times.

    Returns:
        The number of times.
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
    """Return the part of the other's band that lies in the first band."""
    low = max(frequency - 0.5 * bandwidth, other - 0.5 * width)
    high = min(frequency + 0.5 * bandwidth, other + 0.5 * width)
    return min(max(high - low, 0.0) / width, 1.0)


@compiled
def _by_key(voices: Array) -> Array:
    """Return the rows of voices sorted by key. Their own order depends on which sensors were added and removed before."""
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
    """Find the bursts of other sonars in a ping that begins now.

    Args:
        voices: (n) of VOICE.
        mine: number of the listener's own voice.
        heard: (n) bool, which of the others may be heard: those that work and are under water.
        c: sound speed, m/s.
        relative: level of another sonar's sound relative to that on its axis, dB.
        t: now, s.
        per_metre, window, total: the gates of the ping (`imaging.echoes.Gates`).
        out: (m, 4) receives the bursts, in the order of the sonars' keys. It has room for MOST bursts of each sonar that is heard.

    Returns:
        The number of bursts.
    """
    me, per_second, count, times = voices[mine], 0.5 * c * per_metre, 0, np.empty(MOST)
    bandwidth = min(me.bandwidth, per_second / window)  # the band that the bins resolve
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
    """Add a burst to the sound that a beam receives, independently in each gate.

    Args:
        burst: (4) a row of bursts.
        beam: number of the beam.
        key, number: key of the sensor's random numbers, and number of the ping.
        window: length of the pulse's resolution in gates. The sum over these gates has the intensity of the burst.
        real, imaginary: (gates) sound of the beam, uPa; the burst is added.
    """
    root, gates = math.sqrt(0.5 * burst[INTENSITY] / window), len(real)
    whose = np.uint64(burst[WHOSE])
    mixed = np.uint64(number) ^ (whose >> _PINGS << _SONAR) ^ (whose << _PING)
    for k in range(int(burst[FIRST]), min(int(burst[END]), gates)):
        a, b = normals(key, mixed, _HEARD, beam * gates + k)
        real[k] += root * a
        imaginary[k] += root * b


find_bursts_at_once = entry(find_bursts.py_func)
"""`find_bursts` for sonars that ping in Python."""


@compiled
def add_bursts(bursts: Array, key: int, number: int, window: float, sound: Array) -> None:
    """Add bursts to the sound of a ping, independently in each beam and gate.

    Args:
        bursts: (n, 4), see INTENSITY.
        key, number, window: see `add_burst`.
        sound: (2, beams, gates) real and imaginary part, uPa; the bursts are added.
    """
    for b in range(sound.shape[1]):
        for k in range(len(bursts)):
            add_burst(bursts[k], b, key, number, window, sound[0, b], sound[1, b])
