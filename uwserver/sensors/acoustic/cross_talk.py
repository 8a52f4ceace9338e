"""What sonars of one vehicle hear of each other.

A model: another sonar's pulse comes straight through the water, weaker than on its axis by what the listener's table says (both stand in each
other's side lobes), and that part of it that lies in the listener's band is noise in the bins during which it lasts. When others ping is known
from their pace at the start of the listener's ping: a setting that changes it meanwhile counts from the next ping on. Echoes of the other's
pulse are not heard, nor is a pulse of the same shape compressed.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from msgspec import UNSET, UnsetType

from uwserver.environment.column import SOUND_SPEED
from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array, FloatArray, Records
from uwserver.physics.kernel.deferred import compiled
from uwserver.sensors.acoustic.imaging.echoes import Gates
from uwserver.sensors.bank import BankSensor, p_NB, q_NB, rotate, submergence, voices_of, water_property
from uwserver.sensors.base import Scope, Sensor
from uwserver.sensors.latest import Latest
from uwserver.sensors.voices import MOST, NO_BURSTS, VOICE, find_bursts, find_bursts_at_once


class SonarTable(Protocol):
    """Keys of a sonar: see `pinging.PingTable`."""

    @property
    def ideal(self) -> bool:
        """It has no errors of its own."""

    @property
    def assumed_sound_speed_mps(self) -> float | UnsetType:
        """What it takes for the sound speed; default: the truth."""

    @property
    def frequency_hz(self) -> float:
        """Of its sound."""

    @property
    def bandwidth_hz(self) -> float:
        """Of its sound."""

    @property
    def source_level_db(self) -> float:
        """dB re 1 uPa at 1 m."""

    @property
    def pulse_s(self) -> float:
        """How long its pulse is."""

    @property
    def overhead_s(self) -> float:
        """Between the end of a ping and the next one."""


def assumed_speed(table: SonarTable) -> float:
    """What a device takes for the sound speed, m/s; 0 where it is the truth."""
    assumed = table.assumed_sound_speed_mps
    return 0.0 if isinstance(assumed, UnsetType) or table.ideal else assumed


def believed_speed(table: SonarTable, c: float) -> float:
    """What a device believes where the sound speed is c, m/s."""
    return assumed_speed(table) or c


def describe(voice: Any, key: int, table: SonarTable, p: Vec3, reach: float, ready: float, dt: float) -> None:
    """Write into a VOICE how a sonar sounds that has these keys.

    Args:
        voice: the record.
        key: of its random numbers.
        table: of the sonar.
        p: of its transducer in B, m.
        reach: its range, m.
        ready: when it may ping next, s.
        dt: between two times at which it may, s.
    """
    voice["key"], voice["p"], voice["range"], voice["ready"], voice["dt"] = key, p, reach, ready, dt
    voice["frequency"], voice["bandwidth"] = table.frequency_hz, table.bandwidth_hz
    voice["level"], voice["length"], voice["overhead"] = table.source_level_db, table.pulse_s, table.overhead_s
    voice["speed"] = assumed_speed(table)


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
    def speak(self, voice: Any) -> None:
        """Write how it sounds now into a VOICE, but for the body that carries it and whether it works."""

    def voices(self) -> Records:
        """(n) of VOICE: its own, and those of the others that work."""
        others = [other for other in self._nearby.values() if other.sensor is not self and other.works]
        heard = [other.sensor for other in others if isinstance(other.sensor, Sonar)]
        found: Records = np.zeros(1 + len(heard), VOICE)
        found["works"] = 1
        for voice, sonar in zip(found, (self, *heard), strict=True):
            sonar.speak(voice)
        return found

    def overhear(self, scope: Scope, gates: Gates, c: float, relative_db: float | UnsetType) -> FloatArray:
        """What is heard of the others in a ping that begins now.

        Args:
            scope: of its start.
            gates: of the ping.
            c: sound speed, m/s.
            relative_db: level of another sonar's sound beside that of its axis; without it they are not heard.

        Returns:
            Bursts (n, 4) of `voices`.
        """
        if relative_db is UNSET:
            return NO_BURSTS
        voices = self.voices()
        wet = np.array([scope.submergence(scope.position(tuple(p))) > 0.0 for p in voices["p"].tolist()])
        found = np.empty((MOST * len(voices), 4))
        divided = float(gates.per_metre), float(gates.window), gates.total
        count = find_bursts_at_once(voices, 0, wet, c, float(relative_db), scope.t, *divided, found)
        return found[:count]


class BankSonar(Sonar, BankSensor):
    """A sonar whose readings compiled code makes; its record has `reach`, `speed` (of VOICE), and the memory `ready`.

    Attributes:
        table: its keys.
    """

    table: SonarTable

    def speak(self, voice: Any) -> None:
        """As `Sonar.speak`."""
        row, p = self.rows.rows[self.row], self.heads.rows["p"][self.head]
        describe(voice, self.key or 0, self.table, p, row["reach"], row["m"]["ready"], self.dt)


@compiled
def sound_speed(head: Any, row: Any, now: Array, z: float) -> tuple[float, float]:
    """At a depth (m), m/s: the true one, and what the device believes."""
    c = water_property(now, SOUND_SPEED, z)
    return c, c if head.exact != 0 or row.speed == 0.0 else row.speed


@compiled
def overheard(head: Any, now: Array, t: float, c: float, relative: float, gates: Any) -> Array:
    """What a sonar in compiled code hears of the others of its vehicle in a ping that begins now: bursts (n, 4) of `voices`.

    Args:
        head: of the sonar.
        now: what it sees.
        t: s.
        c, relative: as of `Sonar.overhear`.
        gates: of the ping.
    """
    voices, mine, count = voices_of(now), head.voice, 0
    heard, p, q = np.zeros(len(voices), np.bool_), p_NB(head, now), q_NB(head, now)
    for k in range(len(voices)):
        voice = voices[k]
        if k != mine and voice.works != 0 and voice.body == voices[mine].body:
            x, y, z = rotate(q, (voice.p[0], voice.p[1], voice.p[2]))
            heard[k] = submergence(now, (p[0] + x, p[1] + y, p[2] + z), t) > 0.0
            count += heard[k]
    bursts = np.empty((MOST * count, 4))
    found = find_bursts(voices, mine, heard, c, relative, t, gates.per_metre, gates.window, gates.total, bursts)
    return bursts[:found]


@compiled
def tell_pace(head: Any, now: Array, ready: float) -> None:
    """Say when a sonar in compiled code may ping next (s); its shadow says nothing."""
    if head.shadow == 0:
        voices_of(now)[head.voice].ready = ready
