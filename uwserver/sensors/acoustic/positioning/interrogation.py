"""Asks acoustic beacons for their range, one after the other: what long and ultra-short baselines have in common.

A beacon lies on the bottom, drifts, is carried by a ship that steams along, or sits on a vehicle. It hears the question, waits for its turn-around
time and answers. The reading is delivered when the sound of the answer arrives. Device and beacons may move meanwhile.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.environment.acoustics.channel import Path
from uwserver.frames import Quat, Vec3, multiply, rotate
from uwserver.modifiers.base import Measurement, Memory, Number, Time
from uwserver.ports import Argument, Value
from uwserver.sensors.acoustic.echo import SOUND_SPEED_ARGUMENT, or_truth
from uwserver.sensors.acoustic.link import Link, LinkTable, stages_of
from uwserver.sensors.base import (
    Distance,
    Gain,
    KnownBeacon,
    Named,
    Pose,
    Scope,
    Sensor,
    Settings,
    SoundSpeed,
    Traits,
    blank,
    earlier,
)
from uwserver.table import Name, NonNegative, Positive, Probability, Table, Vector3
from uwserver.units import NANOSECONDS

IDLE: Final = 0
QUESTION: Final = 1
TURN_AROUND: Final = 2
ANSWER: Final = 3
"""Legs of an exchange: nothing is under way, the question travels, the beacon waits, the answer travels."""
_CLOSING = 0.02
"""Largest closing speed of beacon and device, as a part of the sound speed. If they are faster, an arrival is noticed a little late."""
_STALE_S = 0.25
"""A device that is asked only this long after a sound has arrived, as a fault kept it silent, has missed the sound."""
_EXACT_S = 1e-12
_LATER_NS = NANOSECONDS // 50
_Normal = Annotated[float, Meta(ge=-100, le=100)]


class Beacon(Table, kw_only=True, frozen=True):
    """A transponder: at a position in N, fixed or with a constant velocity, or on a vehicle.

    Attributes:
        position_ned_m, velocity_ned_mps: position at t = 0, and velocity with which it drifts or its ship steams.
        vehicle: name of the vehicle that carries it, at `position_frd_m` in that vehicle's frame.
        survey_error_ned_m: true position minus the position that is known.
        turn_around_s: time between question and answer; the device subtracts it.
    """

    position_ned_m: Vector3 | UnsetType = UNSET
    velocity_ned_mps: Vector3 = (0.0, 0.0, 0.0)
    vehicle: Name | UnsetType = UNSET
    position_frd_m: Vector3 = (0.0, 0.0, 0.0)
    survey_error_ned_m: Vector3 = (0.0, 0.0, 0.0)
    turn_around_s: NonNegative = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError if the table gives no position, or two."""
        if (self.position_ned_m is UNSET) == (self.vehicle is UNSET):
            raise ValueError("give exactly one of position_ned_m and vehicle")

    def position(self, scope: Scope, ago: float = 0.0) -> Vec3 | None:
        """Return its true position in N (m), `ago` seconds ago; None if its vehicle is gone."""
        ex, ey, ez = self.survey_error_ned_m
        if isinstance(self.vehicle, str):
            place = scope.vehicles.get(self.vehicle)
            if place is None:
                return None
            p, q = earlier(place.p_NB, place.q_NB, place.nu, ago) if ago else (place.p_NB, place.q_NB)
            (x, y, z), (dx, dy, dz) = p, rotate(q, self.position_frd_m)
            return (x + dx + ex, y + dy + ey, z + dz + ez)
        assert isinstance(self.position_ned_m, tuple)
        x, y, z = (p + v * (scope.t - ago) for p, v in zip(self.position_ned_m, self.velocity_ned_mps, strict=True))
        return (x + ex, y + ey, z + ez)

    def known(self, name: str) -> KnownBeacon:
        """Return the beacon as its operator knows it."""
        if isinstance(self.vehicle, str):
            return KnownBeacon(name, self.position_frd_m, self.vehicle, self.turn_around_s)
        assert isinstance(self.position_ned_m, tuple)
        return KnownBeacon(name, self.position_ned_m, None, self.turn_around_s, any(self.velocity_ned_mps))


class InterrogationTable(LinkTable, kw_only=True, frozen=True):
    """The keys of an interrogator of beacons.

    `rate_hz` is an upper limit: a question waits for the answer to the last one, or until that can no longer come.

    Attributes:
        beacons: by name; asked in this order, one at a time.
        max_range_m: a setting of the device; an answer from farther away comes too late.
        fading_sigma_db: standard deviation of the signal level from question to question.
        assumed_sound_speed_mps: sound speed that the device believes; default: the true one at its mount.
        turn_around_sigma_s: white error of the beacon's turn-around time.
        multipath_probability: probability that the later arrival by the surface is taken for the direct one; this makes ranges longer, never shorter.
        clearance_m: solids nearer to the beacon than this do not hide it, so that its own vehicle does not.
        processing_s: time from the arrival to the delivery.
    """

    example: ClassVar[Mapping[str, Any]] = {"beacons": {"beacon": {"position_ned_m": [0.0, 0.0, 0.0]}}}
    beacons: Annotated[dict[str, Beacon], Meta(min_length=1)]
    max_range_m: Positive = 1000.0
    fading_sigma_db: NonNegative = 0.0
    assumed_sound_speed_mps: Positive | UnsetType = UNSET
    turn_around_sigma_s: NonNegative = 0.0
    multipath_probability: Probability = 0.0
    clearance_m: NonNegative = 0.5
    processing_s: NonNegative = 0.0

    def traits(self) -> Traits:
        """Return its stages of compiled code, its beacons and their vehicles."""
        names = tuple(
            Named(("beacons", name, "vehicle"), "vehicles", beacon.vehicle)
            for name, beacon in self.beacons.items()
            if isinstance(beacon.vehicle, str)
        )
        beacons = tuple(beacon.known(name) for name, beacon in self.beacons.items())
        return Traits(stages_of(self.propagation), beacons=beacons, names=names)


class InterrogationSettings(Settings, frozen=True):
    """See `InterrogationTable`; `sound_speed` 0 stands for the true one."""

    max_range: Distance
    gain: Gain
    sound_speed: SoundSpeed


class Exchange(Memory):
    """Attributes:
    ready: time of the next question, s.
    beacon: number of the beacon that is asked now, or next.
    leg: `IDLE`, `QUESTION`, `TURN_AROUND` or `ANSWER`.
    wake: time at which the leg may be over, s.
    asked: time at which the question was sent, s.
    left: time at which the sound under way was sent, s.
    p: position in N from which it was sent, m.
    first: travel time of the question, s.
    away: straight distance that the question travelled, m.
    snr_db: signal over noise, dB.
    draws: normal random numbers of the exchange: fading, arrivals at beacon and device, turn-around, multipath."""

    ready: Time = 0.0
    beacon: Annotated[int, Meta(ge=0)] = 0
    leg: Literal[0, 1, 2, 3] = IDLE
    wake: Time = 0.0
    asked: Time = 0.0
    left: Time = 0.0
    p: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    first: Number = 0.0
    away: Number = 0.0
    snr_db: Annotated[float, Meta(ge=-100, le=1000)] = 0.0
    draws: tuple[_Normal, _Normal, _Normal, _Normal, _Normal] = (0.0, 0.0, 0.0, 0.0, 0.0)


class Answer(NamedTuple):
    """The answer of a beacon.

    Attributes:
        p_BN: true position in N from which the beacon answered, m.
        p_NS, q_NS: true pose of the device when it heard the answer.
        distance: true straight distance, mean of both ways, m.
        path: path of the sound, from the device to the beacon.
        travel_time: travel time of both ways with errors, without the turn-around time, s.
        snr: signal over noise, as a ratio; inf for an ideal device.
    """

    p_BN: Vec3
    p_NS: Vec3
    q_NS: Quat
    distance: float
    path: Path
    travel_time: float
    snr: float


class Interrogator(Sensor):
    """Asks the beacons of one device. Subclasses make readings of the answers; their first field is the name of the beacon.

    An exchange takes as long as its sound: question and answer each reach the receiver where it is by then, not where it was at the start.
    """

    paces = True
    settings: InterrogationSettings
    memory: Exchange
    listens = True

    def __init__(self, mount: Pose, config: InterrogationTable) -> None:
        self._mount, self._table = mount, config
        self._names = tuple(config.beacons)
        self._link = Link(config)
        self.arguments = (
            Argument("max_range", "float", "largest distance of a beacon", "m", False, minimum=1, maximum=config.max_range_m),
            Argument("gain", "float", "added to the source level of both sides", "dB", False, minimum=-60, maximum=0),
            SOUND_SPEED_ARGUMENT,
        )  # fmt: skip
        super().__init__(InterrogationSettings(config.max_range_m, 0.0, or_truth(config.assumed_sound_speed_mps)))

    def turn_on(self) -> Exchange:
        """Return the memory of a device that asks the first beacon at once."""
        return Exchange()

    def load_kernels(self) -> None:
        self._link.load_kernels()

    def valid(self, record: Memory | Settings) -> None:
        """Check also that the beacon is one of the table's."""
        super().valid(record)
        if isinstance(record, Exchange) and record.beacon >= len(self._names):
            raise ValueError(f'"beacon" is {record.beacon}, there are {len(self._names)} beacons')

    def believed(self, c: float) -> float:
        """Return the sound speed that the device uses where the true one is c, m/s."""
        return c if self._table.ideal or not self.settings.sound_speed else self.settings.sound_speed

    @property
    def wake(self) -> float | None:
        return None if self.memory.leg == IDLE else self.memory.wake

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Return a reading after a whole exchange, with the device and all vehicles at rest where they are."""
        still = replace(scope, v_NB_B=(0.0, 0.0, 0.0), w_NB_B=(0.0, 0.0, 0.0))
        reading = self.sense(still)
        while reading is None and self.wake is not None:
            still.t_ns = max(still.t_ns, math.ceil(self.wake * NANOSECONDS)) + _LATER_NS
            reading = self.sense(still)
        return (False, blank(self.fields)) if reading is None else (reading.valid, reading.values)

    @abstractmethod
    def values(self, scope: Scope, answer: Answer) -> list[Value]:
        """Return the values of a reading behind the name of the beacon."""

    def sense(self, scope: Scope) -> Measurement | None:
        """Go on with the exchange under way, or ask the next beacon when it is time. Return its reading, or None until the exchange is over."""
        m, now = self.memory, scope.t
        if m.leg == IDLE:
            if now < m.ready - 1e-6:
                return None
            if not self._ask(scope):
                return self._over(scope, None)
        beacon = self._table.beacons[self._name]
        if m.leg == QUESTION:
            met = self._meet(scope, partial(beacon.position, scope))
            if met is None:
                return None
            ago, p, path = met
            if p is None or path is None or ago > _STALE_S:
                return self._over(scope, None)
            m.first, m.away = path.time, math.dist(p, m.p)
            m.leg, m.wake = TURN_AROUND, now - ago + beacon.turn_around_s
        if m.leg == TURN_AROUND:
            if now < m.wake:
                return None
            p = beacon.position(scope, now - m.wake)
            if p is None or now - m.wake > _STALE_S or scope.submergence(p) <= 0.0:
                return self._over(scope, None)
            m.leg, m.left, m.p = ANSWER, m.wake, p
        return self._hear(scope)

    @property
    def _name(self) -> str:
        return self._names[self.memory.beacon]

    def _ask(self, scope: Scope) -> bool:
        """Send the question. Return False if the beacon will not hear it."""
        m, table = self.memory, self._table
        # Drawn even if they are not needed, so that what one beacon does never shifts the errors of another.
        fading, first, second, turn, luck = self.rng.standard_normal(5).tolist()
        m.draws = (fading, first, second, turn, luck)
        m.asked = m.left = scope.t
        p_NS = scope.position(self._mount.p)
        p = table.beacons[self._name].position(scope)
        if p is None or scope.submergence(p_NS) <= 0.0 or scope.submergence(p) <= 0.0:
            return False
        distance = math.dist(p, p_NS)
        if distance > self.settings.max_range or self._hidden(scope, p_NS, p, distance):
            return False
        path = self._path(scope, p_NS, p)
        if path is None:
            return False
        if not table.ideal:
            m.snr_db = self._link.snr_db(path.loss, self._gain)
        m.p = p_NS
        m.leg = QUESTION
        return True

    def _meet(
        self, scope: Scope, where: Callable[[float], Vec3 | None]
    ) -> tuple[float, Vec3 | None, Path | None] | None:
        """Find when and where the sound under way reaches something that moves; None while the sound is still under way.

        Args:
            scope: the present instant.
            where: gives its position in N (m) so many seconds ago; None if it is gone.

        Returns:
            How long ago (s) the sound arrived, the position (None: it is gone), and the path of the sound (None: no path leads there).
        """
        m, now = self.memory, scope.t
        start = m.p
        ago, p = 0.0, where(0.0)
        if p is None:
            return ago, None, None
        path = self._path(scope, p, start)
        if path is None:
            return ago, p, None
        late = now - m.left - path.time
        if late < 0.0:
            m.wake = now - late * (1.0 - _CLOSING)
            return None
        # Fixed-point iteration over the time of arrival: the receiver moves far slower than sound.
        for _ in range(20):
            ago += late
            before, p = p, where(ago)
            if p is None:
                return ago, None, None
            if p != before:
                path = self._path(scope, p, start)
                if path is None:
                    return ago, p, None
            late = now - ago - m.left - path.time
            if abs(late) < _EXACT_S:
                break
        return ago, p, path

    def _hear(self, scope: Scope) -> Measurement | None:
        """Return the reading when the answer has reached the device; None while it is under way."""
        m, table = self.memory, self._table
        nu = (*scope.v_NB_B, *scope.w_NB_B)

        def where(ago: float) -> Vec3:
            p, q = earlier(scope.p_NB, scope.q_NB, nu, ago)
            dx, dy, dz = rotate(q, self._mount.p)
            return (p[0] + dx, p[1] + dy, p[2] + dz)

        met = self._meet(scope, where)
        if met is None:
            return None
        ago, p_NS, path = met
        assert p_NS is not None
        if path is None:
            return self._over(scope, None)
        p = m.p
        distance = math.dist(p, p_NS)
        if ago > _STALE_S or scope.submergence(p_NS) <= 0.0 or self._hidden(scope, p_NS, p, distance):
            return self._over(scope, None)
        travel, snr = m.first + path.time, math.inf
        if not table.ideal:
            _, first, second, turn, luck = m.draws
            snr = 10.0 ** (0.1 * m.snr_db)
            jitter = 1.0 / (table.bandwidth_hz * math.sqrt(snr))
            travel += jitter * (first + second) + table.turn_around_sigma_s * turn
            if 0.5 * math.erfc(luck / math.sqrt(2.0)) < table.multipath_probability:
                travel += 2.0 * self._link.surface_delay(scope, p_NS, p, path)
        _, q = earlier(scope.p_NB, scope.q_NB, nu, ago)
        mean = 0.5 * (m.away + distance)
        return self._over(scope, Answer(p, p_NS, multiply(q, self._mount.q), mean, path, travel, snr))

    def _over(self, scope: Scope, answer: Answer | None) -> Measurement:
        """End the exchange and return its reading. When that is delivered, the next beacon is asked."""
        m, table, name = self.memory, self._table, self._name
        turn_around, asked = table.beacons[name].turn_around_s, m.asked
        c = scope.water.sound_speed(scope.position(self._mount.p)[2])
        patience = 2.0 * self.settings.max_range / c + turn_around
        if answer is not None and answer.travel_time + turn_around > patience:
            answer = None
        wait = (patience if answer is None else answer.travel_time + turn_around) + table.processing_s
        m.leg, m.ready, m.beacon = IDLE, asked + wait, (m.beacon + 1) % len(self._names)
        values = blank(self.fields[1:]) if answer is None else self.values(scope, answer)
        delay_ns, since_ns = round(wait * NANOSECONDS), scope.t_ns - round(asked * NANOSECONDS)
        return Measurement([name, *values], answer is not None, delay_ns, since_ns=since_ns)

    @property
    def _gain(self) -> float:
        """Return the gain of the device plus the fading of the exchange, dB."""
        return self.settings.gain + self._table.fading_sigma_db * self.memory.draws[0]

    def _path(self, scope: Scope, a: Vec3, b: Vec3) -> Path | None:
        """Return the path of sound from a to b that the receiver takes, which is also the path from b to a; None if it hears nothing."""
        return self._link.heard(self._link.paths(scope, a, b), self._gain)

    def _hidden(self, scope: Scope, p_NS: Vec3, p: Vec3, distance: float) -> bool:
        """Return whether a solid stands between device and beacon."""
        free = distance - self._table.clearance_m
        if free <= 0.0:
            return False
        direction = np.array([[(b - a) / distance for a, b in zip(p_NS, p, strict=True)]])
        return bool(scope.geometry.raycast(np.array([p_NS]), direction, free).distance[0] <= free)
