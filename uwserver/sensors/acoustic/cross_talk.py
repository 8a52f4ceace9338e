"""What sonars of one vehicle hear of each other.

A model: another sonar's pulse comes straight through the water, weaker than on its axis by what the listener's table says (both stand in each
other's side lobes), and that part of it that lies in the listener's band is noise in the bins during which it lasts. When others ping is known
from their pace at the start of the listener's ping: a setting that changes it meanwhile counts from the next ping on. Echoes of the other's
pulse are not heard, nor is a pulse of the same shape compressed.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from msgspec import UNSET, UnsetType

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.sensors.acoustic.imaging.echoes import Gates
from uwserver.sensors.base import Scope, Sensor
from uwserver.sensors.latest import Latest

_NEAREST = 0.1
"""m: what is nearer counts as if it were there, for transducers are no points."""
_MOST = 100
"""Pings of another sonar that are heard in one of the listener's."""
_TICK = 1e-6


class Voice(NamedTuple):
    """How a sonar sounds.

    Attributes:
        p: of its transducer in B, m.
        frequency, bandwidth: Hz.
        level: of its source, dB re 1 uPa at 1 m.
        length: of its pulse, s.
        ready: time (s) from which it may ping next; 0 where it never did.
        busy: s from a ping to the time from which the next one may follow.
        dt: it pings at multiples of this, s.
    """

    p: Vec3
    frequency: float
    bandwidth: float
    level: float
    length: float
    ready: float
    busy: float
    dt: float

    def pings(self, since: float, now: float, until: float) -> Iterator[float]:
        """Times (s) of its pings, by its pace now: the last one, if it was later than `since`, and those to come before `until`."""
        began = self.ready - self.busy
        if self.ready > 0.0 and began > since:
            yield began
        t = self._due(max(self.ready, now))
        for _ in range(_MOST):
            if t >= until:
                return
            yield t
            t = self._due(max(t + self.busy, t + 0.5 * self.dt))

    def _due(self, t: float) -> float:
        return math.ceil((t - _TICK) / self.dt) * self.dt


class Believing(Protocol):
    """A table that may name what the device takes for the sound speed."""

    @property
    def ideal(self) -> bool:
        """Whether it knows."""

    @property
    def assumed_sound_speed_mps(self) -> float | UnsetType:
        """What it takes it for; default: the truth."""


def believed_speed(table: Believing, c: float) -> float:
    """What a device believes where the sound speed is c, m/s."""
    assumed = table.assumed_sound_speed_mps
    return c if isinstance(assumed, UnsetType) or table.ideal else assumed


class Burst(NamedTuple):
    """Sound of another sonar in one ping.

    Attributes:
        first, end: gates in which it is heard.
        intensity: mean, within the listener's band, uPa^2.
    """

    first: int
    end: int
    intensity: float


Nearby = Mapping[str, Latest]
"""Sensors of the vehicle by name, the listener among them."""


class Sonar(Sensor):
    """A sensor that pings, which others hear, and that may hear them."""

    _nearby: Nearby = MappingProxyType({})

    @property
    def needs(self) -> Collection[str]:
        """The others that ping."""
        return [name for name, other in self._nearby.items() if isinstance(other.sensor, Sonar)]

    def join(self, others: Nearby) -> None:
        """These it hears."""
        self._nearby = others

    @abstractmethod
    def voice(self, c: float) -> Voice:
        """How it sounds now, where the sound speed is c (m/s)."""

    def overhear(self, scope: Scope, gates: Gates, c: float, relative_db: float | UnsetType) -> tuple[Burst, ...]:
        """What is heard of the others in a ping that begins now; see `bursts`."""
        return () if relative_db is UNSET else bursts(scope, self, self._nearby, gates, c, relative_db)


def bursts(
    scope: Scope, listener: Sonar, nearby: Nearby, gates: Gates, c: float, relative_db: float
) -> tuple[Burst, ...]:
    """What is heard of the others in a ping that begins now.

    Args:
        scope: of its start.
        listener: who pings.
        nearby: sensors of the vehicle.
        gates: of the ping.
        c: sound speed, m/s.
        relative_db: level of another sonar's sound beside that of its axis.
    """
    me = listener.voice(c)
    bandwidth = min(me.bandwidth, 0.5 * c * gates.per_metre / gates.window)  # of what the bins resolve
    per_second = 0.5 * c * gates.per_metre
    found = []
    for other in nearby.values():
        if other.sensor is listener or not other.works or not isinstance(other.sensor, Sonar):
            continue
        voice = other.sensor.voice(c)
        share = _shared(me.frequency, bandwidth, voice.frequency, voice.bandwidth)
        if share <= 0.0 or scope.submergence(scope.position(voice.p)) <= 0.0:
            continue
        away = max(math.dist(me.p, voice.p), _NEAREST)
        intensity = share * 10.0 ** (0.1 * (voice.level + relative_db)) / away**2
        late = away / c
        for t in voice.pings(scope.t - late - voice.length, scope.t, scope.t + gates.total / per_second - late):
            start = (t + late - scope.t) * per_second
            first, end = max(math.floor(start), 0), min(math.ceil(start + voice.length * per_second), gates.total)
            if first < end:
                found.append(Burst(first, end, intensity))
    return tuple(found)


def _shared(frequency: float, bandwidth: float, other: float, width: float) -> float:
    """Part of the other's band that lies in the first one."""
    low, high = (
        max(frequency - 0.5 * bandwidth, other - 0.5 * width),
        min(frequency + 0.5 * bandwidth, other + 0.5 * width),
    )
    return min(max(high - low, 0.0) / width, 1.0)


def add_bursts(heard: tuple[Burst, ...], key: int, number: int, window: float, sound: npt.NDArray[np.floating]) -> None:
    """Add them to what a ping brings, independent in each beam and gate.

    Args:
        heard: of `bursts`.
        key, number: of the sensor's random numbers, and of the ping.
        window: gates that the resolution of the pulse is long, whose sum has the intensity.
        sound: (2, ..., gates) real and imaginary part, uPa, to which is added.
    """
    for k, burst in enumerate(heard):
        counter = (0, 0, 0, k + 1)
        rng = np.random.Generator(np.random.Philox(key=(key, number), counter=counter))
        part = sound[..., burst.first : burst.end]
        drawn: FloatArray = rng.standard_normal(part.shape)
        part += (math.sqrt(0.5 * burst.intensity / window) * drawn).astype(sound.dtype)
