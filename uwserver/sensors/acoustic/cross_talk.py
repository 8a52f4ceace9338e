"""What all sonars have in common: their keys, how they sound to others, and what they hear of other sonars on their vehicle.

Cross-talk is a model. The pulse of another sonar comes straight through the water. It is weaker than on the other's axis by what the listener's
table says, as both stand in each other's side lobes. The part of the pulse that lies in the listener's band is noise in the bins during which it
lasts. The times of the other's pings follow from its pace at the start of the listener's ping: if a setting changes the pace during that ping, the
change counts from the next ping on. Echoes of the other's pulse are not heard, and a pulse of the same shape is not compressed.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.environment.column import SOUND_SPEED
from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array, FloatArray, Records
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Argument
from uwserver.sensors.acoustic.echo import check_range, fill_row, or_truth
from uwserver.sensors.acoustic.imaging.echoes import Gates
from uwserver.sensors.base import Latest, Scope, Sensor, SensorTable
from uwserver.sensors.compiled import CompiledSensor, p_NB, q_NB, rotate, submergence, voices_of, water_property
from uwserver.sensors.voices import MOST, NO_BURSTS, VOICE, find_bursts, find_bursts_at_once
from uwserver.table import NonNegative, Positive


class SonarTable(SensorTable, kw_only=True, frozen=True):
    """The keys of every sonar. `rate_hz` is an upper limit: a ping waits until the last one is over.

    Attributes:
        ideal: mean level without speckle and noise, at the true sound speed.
        frequency_hz, bandwidth_hz: those of the sound; the bandwidth gives the resolution in range, which is never finer than a bin.
        pulse_s: length of the pulse; a swept pulse longer than 1 / bandwidth is compressed, which lifts the echo by bandwidth times length.
        bins: number of equal range bins in a ping.
        range_m: range at the start; the service `set` changes it.
        min_range_m, max_range_m: limits of the range.
        source_level_db: dB re 1 uPa at 1 m.
        noise_level_db: spectral level of the ambient noise, dB re 1 uPa^2/Hz.
        cross_talk_db: level of the direct sound of other sonars on the vehicle whose bands overlap, relative to the level on their axis: -40 for two
            side lobes of -20 dB (a model); without it they are not heard.
        assumed_sound_speed_mps: sound speed that the device believes; default: the true one.
        sees_own_vehicle: whether the shapes of its own vehicle are in its field of view; otherwise it looks through them, wherever it is mounted.
        overhead_s: pause between the end of a ping and the next one.
    """

    ideal: bool = False
    frequency_hz: Positive = 450e3
    bandwidth_hz: Positive = 4e4
    pulse_s: Positive = 4e-4
    bins: Annotated[int, Meta(ge=8, le=4096)] = 1000
    range_m: Positive = 50.0
    min_range_m: Positive = 1.0
    max_range_m: Positive = 100.0
    source_level_db: float = 210.0
    noise_level_db: float = 42.0
    cross_talk_db: Annotated[float, Meta(ge=-200, le=0)] | UnsetType = UNSET
    assumed_sound_speed_mps: Positive | UnsetType = UNSET
    sees_own_vehicle: bool = False
    overhead_s: NonNegative = 0.005

    def __post_init__(self) -> None:
        """Raise ValueError if the range is outside its limits."""
        check_range(self.range_m, self.min_range_m, self.max_range_m, "the sonar")


def ping_arguments(table: SonarTable) -> tuple[Argument, ...]:
    """Return the arguments of the service ``set`` that all sonars have."""
    low, high = table.min_range_m, table.max_range_m
    return (
        Argument("range", "float", "distance at the end of the last bin", "m", False, minimum=low, maximum=high),
        Argument("gain", "float", "added to the level before compression", "dB", False, minimum=-60, maximum=60),
    )


def assumed_speed(table: SonarTable) -> float:
    """Return the sound speed that a device believes, m/s; 0 if it knows the true one."""
    return 0.0 if table.ideal else or_truth(table.assumed_sound_speed_mps)


def believed_speed(table: SonarTable, c: float) -> float:
    """Return the sound speed that a device believes where the true one is c, m/s."""
    return assumed_speed(table) or c


def describe(voice: Any, key: int, table: SonarTable, p: Vec3, reach: float, ready: float, dt: float) -> None:
    """Write into a VOICE how a sonar with these keys sounds.

    Args:
        voice: the record.
        key: key of the sonar's random numbers.
        table: table of the sonar.
        p: position of its transducer in B, m.
        reach: its range, m.
        ready: time from which it may ping next, s.
        dt: interval at which it may ping, s.
    """
    fill_row(
        voice, key=key, p=p, range=reach, ready=ready, dt=dt, frequency=table.frequency_hz, bandwidth=table.bandwidth_hz,
        level=table.source_level_db, length=table.pulse_s, overhead=table.overhead_s, speed=assumed_speed(table),
    )  # fmt: skip


Nearby = Mapping[str, Latest]
"""The sensors of a vehicle by name, the listener among them."""


class Sonar(Sensor):
    """A sensor that pings. Other sonars may hear it, and it may hear them."""

    _nearby: Nearby = MappingProxyType({})

    @property
    def needs(self) -> Collection[str]:
        """Return the names of the sonars on its vehicle."""
        return [name for name, other in self._nearby.items() if isinstance(other.sensor, Sonar)]

    def join(self, others: Nearby) -> None:
        """Keep the sensors of its vehicle, to hear the sonars among them."""
        self._nearby = others

    @abstractmethod
    def speak(self, voice: Any) -> None:
        """Write into a VOICE how the sonar sounds now: all fields except the body that carries it and whether it works."""

    def voices(self) -> Records:
        """Return the VOICEs (n) of this sonar and of the others on its vehicle that work."""
        others = [other for other in self._nearby.values() if other.sensor is not self and other.works]
        heard = [other.sensor for other in others if isinstance(other.sensor, Sonar)]
        found: Records = np.zeros(1 + len(heard), VOICE)
        found["works"] = 1
        for voice, sonar in zip(found, (self, *heard), strict=True):
            sonar.speak(voice)
        return found

    def overhear(self, scope: Scope, gates: Gates, c: float, relative_db: float | UnsetType) -> FloatArray:
        """Return what this sonar hears of the others in a ping that begins now: bursts (n, 4) of `voices`.

        Args:
            scope: the instant at which the ping begins.
            gates: gates of the ping.
            c: sound speed, m/s.
            relative_db: level of another sonar's sound relative to its axis; if unset, the others are not heard.
        """
        if relative_db is UNSET:
            return NO_BURSTS
        voices = self.voices()
        wet = np.array([scope.submergence(scope.position(tuple(p))) > 0.0 for p in voices["p"].tolist()])
        found = np.empty((MOST * len(voices), 4))
        divided = float(gates.per_metre), float(gates.window), gates.total
        count = find_bursts_at_once(voices, 0, wet, c, float(relative_db), scope.t, *divided, found)
        return found[:count]


class CompiledSonar(Sonar, CompiledSensor):
    """A sonar whose readings compiled code makes. Its record has `reach` and `speed` (as in VOICE), and its memory has `ready`.

    Attributes:
        table: its keys.
    """

    table: SonarTable

    def speak(self, voice: Any) -> None:
        """Write into a VOICE how the sonar sounds now, as `Sonar.speak`."""
        row, p = self.rows.rows[self.row], self.heads.rows["p"][self.head]
        describe(voice, self.key or 0, self.table, p, row["reach"], row["m"]["ready"], self.dt)


@compiled
def sound_speed(head: Any, row: Any, surroundings: Array, z: float) -> tuple[float, float]:
    """Return the true sound speed at a depth z (m), and the one that the device believes, m/s."""
    c = water_property(surroundings, SOUND_SPEED, z)
    return c, c if head.exact != 0 or row.speed == 0.0 else row.speed


@compiled
def overheard(head: Any, surroundings: Array, t: float, c: float, relative: float, gates: Any) -> Array:
    """Return what a sonar in compiled code hears of the others on its vehicle in a ping that begins now: bursts (n, 4) of `voices`.

    Args:
        head: head of the sonar.
        surroundings: the table of what it sees.
        t: s.
        c, relative: as in `Sonar.overhear`.
        gates: gates of the ping.
    """
    voices, mine, count = voices_of(surroundings), head.voice, 0
    heard, p, q = np.zeros(len(voices), np.bool_), p_NB(head, surroundings), q_NB(head, surroundings)
    for k in range(len(voices)):
        voice = voices[k]
        if k != mine and voice.works != 0 and voice.body == voices[mine].body:
            x, y, z = rotate(q, (voice.p[0], voice.p[1], voice.p[2]))
            heard[k] = submergence(surroundings, (p[0] + x, p[1] + y, p[2] + z), t) > 0.0
            count += heard[k]
    bursts = np.empty((MOST * count, 4))
    found = find_bursts(voices, mine, heard, c, relative, t, gates.per_metre, gates.window, gates.total, bursts)
    return bursts[:found]


@compiled
def tell_pace(head: Any, surroundings: Array, ready: float) -> None:
    """Write the time (s) from which a sonar in compiled code may ping next into its VOICE. Its twin without errors writes nothing."""
    if head.shadow == 0:
        voices_of(surroundings)[head.voice].ready = ready
