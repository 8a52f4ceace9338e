"""Asking acoustic beacons for their range, one after the other: what long and ultra-short baselines have in common.

A beacon lies on the bottom, drifts or steams along, or sits on a vehicle. It hears the question, waits for its turn-around time and answers;
the answer is delivered when its sound arrives. All of them may move meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.environment.acoustics.channel import Path
from uwserver.frames import Quat, Vec3, multiply, rotate
from uwserver.modifiers.base import Memory, Number, Time
from uwserver.ports import Argument, Value
from uwserver.sensors.acoustic.link import Link, LinkTable, stages_of
from uwserver.sensors.base import Distance, Gain, Pose, Scope, Sensor, Settings, SoundSpeed, blank, earlier
from uwserver.sensors.traits import KnownBeacon, Named, Traits
from uwserver.table import Name, NonNegative, Positive, Probability, Table, Vector3
from uwserver.units import NANOSECONDS

IDLE: Final = 0
QUESTION: Final = 1
TURN_AROUND: Final = 2
ANSWER: Final = 3
"""What is under way."""
_CLOSING = 0.02
"""Beacon and device come nearer to each other at most with this part of the sound speed, or an arrival is noticed up to a little later."""
_STALE_S = 0.25
"""A device that was silent for longer has missed the sound."""
_EXACT_S = 1e-12
_LATER_NS = NANOSECONDS // 50
_Normal = Annotated[float, Meta(ge=-100, le=100)]


class Beacon(Table, kw_only=True, frozen=True):
    """A transponder: at a place of N (which may move), or on a vehicle.

    Attributes:
        position_ned_m, velocity_ned_mps: at t = 0, and as it drifts, or as the ship steams that carries it.
        vehicle: name of the one that carries it, at `position_frd_m` of its frame.
        survey_error_ned_m: the beacon is not where it is thought to be.
        turn_around_s: between question and answer; the device takes it off.
    """

    position_ned_m: Vector3 | UnsetType = UNSET
    velocity_ned_mps: Vector3 = (0.0, 0.0, 0.0)
    vehicle: Name | UnsetType = UNSET
    position_frd_m: Vector3 = (0.0, 0.0, 0.0)
    survey_error_ned_m: Vector3 = (0.0, 0.0, 0.0)
    turn_around_s: NonNegative = 0.0

    def __post_init__(self) -> None:
        """ValueError where it is not clear where the beacon is."""
        if (self.position_ned_m is UNSET) == (self.vehicle is UNSET):
            raise ValueError("give exactly one of position_ned_m and vehicle")

    def position(self, scope: Scope, ago: float = 0.0) -> Vec3 | None:
        """p_N (m), a little while ago (s); None when its vehicle is gone."""
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
        """The same, as others know it."""
        if isinstance(self.vehicle, str):
            return KnownBeacon(name, self.position_frd_m, self.vehicle, self.turn_around_s)
        assert isinstance(self.position_ned_m, tuple)
        return KnownBeacon(name, self.position_ned_m, None, self.turn_around_s, any(self.velocity_ned_mps))


class InterrogationTable(LinkTable, kw_only=True, frozen=True):
    """What an interrogator of beacons needs. `rate_hz` at most: a question waits for the answer to the last one, or until none can come any more.

    Attributes:
        beacons: by name; asked in this order, one at a time.
        max_range_m: a device setting; what comes from farther comes too late.
        fading_sigma_db: normal variation of the signal from question to question.
        assumed_sound_speed_mps: what the device believes; default: the truth where it is mounted.
        turn_around_sigma_s: white error of the beacon's turn-around time.
        multipath_probability: sound that comes later by the surface is taken for the one that is meant: late, never early.
        clearance_m: what stands nearer than this to the beacon does not hide it, so that its own vehicle does not.
        processing_s: from the arrival to the delivery.
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
        """Its beacons."""
        names = tuple(
            Named(("beacons", name, "vehicle"), "vehicles", beacon.vehicle)
            for name, beacon in self.beacons.items()
            if isinstance(beacon.vehicle, str)
        )
        beacons = tuple(beacon.known(name) for name, beacon in self.beacons.items())
        return Traits(stages_of(self.propagation), beacons=beacons, names=names)


class InterrogationSettings(Settings, frozen=True):
    """See `InterrogationTable`; `sound_speed` 0 stands for the truth."""

    max_range: Distance
    gain: Gain
    sound_speed: SoundSpeed


class Exchange(Memory):
    """Attributes:
    ready: time of the next question, s.
    beacon: number of the one that is asked then, or now.
    leg: what is under way: `IDLE`, `QUESTION`, `TURN_AROUND` or `ANSWER`.
    wake: when that may be over, s.
    asked: when the question was sent, s.
    left: when the sound left that is under way, s.
    p: where it left, in N, m.
    first: how long the first way took, s.
    away: how far it was, straight, m.
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
    """What comes back from a beacon.

    Attributes:
        p_BN: exact place in N from where the beacon answered, m.
        p_NS, q_NS: exact pose of the device when it heard that.
        distance: exact and straight, the mean of both ways, m.
        path: of the sound, seen from the device to the beacon.
        travel_time: of both ways with the errors, without the turn-around, s.
        snr: signal over noise, as a ratio; inf when ideal.
    """

    p_BN: Vec3
    p_NS: Vec3
    q_NS: Quat
    distance: float
    path: Path
    travel_time: float
    snr: float


class Outcome(NamedTuple):
    """How an exchange ended: name of the beacon, its answer (None: there is none), the time (s) from the question to the delivery of the
    reading, and when the question was sent (ns)."""

    name: str
    answer: Answer | None
    wait: float
    asked_ns: int


class Interrogator(Sensor):
    """The questions of one device; subclasses make readings of the answers.

    An exchange takes as long as its sound: question and answer each meet who hears them where he is by then, not where he was.
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
            Argument("sound_speed", "float", "what the device believes; 0 for the truth", "m/s", False, minimum=0, maximum=2000),
        )  # fmt: skip
        speed = 0.0 if config.assumed_sound_speed_mps is UNSET else config.assumed_sound_speed_mps
        super().__init__(InterrogationSettings(config.max_range_m, 0.0, speed))

    def turn_on(self) -> Exchange:
        """Ready at once, the first beacon first."""
        return Exchange()

    def load_kernels(self) -> None:
        self._link.load_kernels()

    def valid(self, record: Memory | Settings) -> None:
        """The beacon must be one of the table's."""
        super().valid(record)
        if isinstance(record, Exchange) and record.beacon >= len(self._names):
            raise ValueError(f'"beacon" is {record.beacon}, there are {len(self._names)} beacons')

    def believed(self, c: float) -> float:
        """The sound speed (m/s) that the device counts with, where it is c."""
        return c if self._table.ideal or not self.settings.sound_speed else self.settings.sound_speed

    @property
    def wake(self) -> float | None:
        return None if self.memory.leg == IDLE else self.memory.wake

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """A whole exchange at once, with device and vehicles where they are."""
        still = replace(scope, v_NB_B=(0.0, 0.0, 0.0), w_NB_B=(0.0, 0.0, 0.0))
        reading = self.sense(still)
        while reading is None and self.wake is not None:
            still.t_ns = max(still.t_ns, math.ceil(self.wake * NANOSECONDS)) + _LATER_NS
            reading = self.sense(still)
        return (False, blank(self.fields)) if reading is None else (reading.valid, reading.values)

    def exchange(self, scope: Scope) -> Outcome | None:
        """Go on with the exchange under way, or ask the next beacon when it is time; None until it is over."""
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
        return self._hear(scope, beacon)

    @property
    def _name(self) -> str:
        return self._names[self.memory.beacon]

    def _ask(self, scope: Scope) -> bool:
        """Send the question; False where no beacon will hear it."""
        m, table = self.memory, self._table
        # Drawn whether needed or not: what one beacon does must not shift another's errors.
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
        """How long ago (s) the sound under way met something that was at `where` so long ago; there, and by which way (None: by none). None while
        it is still under way."""
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

    def _hear(self, scope: Scope, beacon: Beacon) -> Outcome | None:
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

    def _over(self, scope: Scope, answer: Answer | None) -> Outcome:
        """End the exchange; the next question goes to the next beacon, when this reading is delivered."""
        m, table, name = self.memory, self._table, self._name
        turn_around, asked = table.beacons[name].turn_around_s, m.asked
        c = scope.water.sound_speed(scope.position(self._mount.p)[2])
        patience = 2.0 * self.settings.max_range / c + turn_around
        if answer is not None and answer.travel_time + turn_around > patience:
            answer = None
        wait = (patience if answer is None else answer.travel_time + turn_around) + table.processing_s
        m.leg, m.ready, m.beacon = IDLE, asked + wait, (m.beacon + 1) % len(self._names)
        return Outcome(name, answer, wait, round(asked * NANOSECONDS))

    @property
    def _gain(self) -> float:
        """Setting and fading, dB."""
        return self.settings.gain + self._table.fading_sigma_db * self.memory.draws[0]

    def _path(self, scope: Scope, a: Vec3, b: Vec3) -> Path | None:
        """The way of sound from a to b that is heard, which is that from b to a; None in silence."""
        return self._link.heard(self._link.paths(scope, a, b), self._gain)

    def _hidden(self, scope: Scope, p_NS: Vec3, p: Vec3, distance: float) -> bool:
        """Whether something solid stands between."""
        free = distance - self._table.clearance_m
        if free <= 0.0:
            return False
        direction = np.array([[(b - a) / distance for a, b in zip(p_NS, p, strict=True)]])
        return bool(scope.geometry.raycast(np.array([p_NS]), direction, free).distance[0] <= free)
