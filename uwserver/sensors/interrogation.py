"""Asking acoustic beacons for their range, one after the other: what long and ultra-short baselines have in common.

A beacon lies on the bottom, drifts or steams along, or sits on a vehicle. It hears the question, waits for its turn-around time and answers;
the answer is delivered when its sound arrives.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.environment.eigenray import Path, eigenray, straight
from uwserver.frames import Vec3, rotate
from uwserver.ports import Argument
from uwserver.sensors.base import Pose, Scope, SensorTable
from uwserver.sensors.echo import Absorption, submergence
from uwserver.sensors.instrument import Instrument, Settings
from uwserver.table import Name, NonNegative, Positive, Probability, Table, Vector3

READY, NEXT = range(2)
"""Places in the memory: time of the next question (s), and number of the beacon that it goes to."""


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

    def position(self, scope: Scope) -> Vec3 | None:
        """p_N (m) now; None when its vehicle is gone."""
        ex, ey, ez = self.survey_error_ned_m
        if isinstance(self.vehicle, str):
            place = scope.vehicles.get(self.vehicle)
            if place is None:
                return None
            (x, y, z), (dx, dy, dz) = place.p_NB, rotate(place.q_NB, self.position_frd_m)
            return (x + dx + ex, y + dy + ey, z + dz + ez)
        assert isinstance(self.position_ned_m, tuple)
        x, y, z = (p + v * scope.t for p, v in zip(self.position_ned_m, self.velocity_ned_mps, strict=True))
        return (x + ex, y + ey, z + ez)


class InterrogationTable(SensorTable, kw_only=True, frozen=True):
    """What asking beacons needs. `rate_hz` at most: a question waits for the answer to the last one, or until none can come any more.

    Attributes:
        ideal: exact ranges of all beacons in sight.
        beacons: by name; asked in this order, one at a time.
        propagation: along straight lines at the mean slowness, or by Snell's law through the layers of the water.
        frequency_hz, bandwidth_hz: of the signal.
        max_range_m: a device setting; what comes from farther comes too late.
        source_level_db: of both sides, dB re 1 uPa at 1 m.
        noise_level_db: dB re 1 uPa^2/Hz at the receiver.
        threshold_db: signal over noise that is needed.
        fading_sigma_db: normal variation of the signal from question to question.
        assumed_sound_speed_mps: what the device believes; default: the truth where it is mounted.
        turn_around_sigma_s: white error of the beacon's turn-around time.
        multipath_probability: the sound reflected by the surface is taken for the direct one: late, never early.
        clearance_m: what stands nearer than this to the beacon does not hide it, so that its own vehicle does not.
        processing_s: from the arrival to the delivery.
    """

    ideal: bool = False
    beacons: Annotated[dict[str, Beacon], Meta(min_length=1)]
    propagation: Literal["straight", "layered"] = "layered"
    frequency_hz: Positive = 26e3
    bandwidth_hz: Positive = 4e3
    max_range_m: Positive = 1000.0
    source_level_db: float = 185.0
    noise_level_db: float = 50.0
    threshold_db: float = 10.0
    fading_sigma_db: NonNegative = 0.0
    assumed_sound_speed_mps: Positive | UnsetType = UNSET
    turn_around_sigma_s: NonNegative = 0.0
    multipath_probability: Probability = 0.0
    clearance_m: NonNegative = 0.5
    processing_s: NonNegative = 0.0


class InterrogationSettings(Settings, frozen=True):
    """See `InterrogationTable`; `sound_speed` 0 stands for the truth."""

    max_range: float
    gain: float
    sound_speed: float


class Answer(NamedTuple):
    """What comes back from a beacon.

    Attributes:
        p_BN: exact place of the beacon in N at the time of the question, m.
        distance: exact and straight, m.
        path: of the sound from the device to the beacon.
        travel_time: of both ways with the errors, without the turn-around, s.
        arrival_s: from the question to the arrival.
        snr: signal over noise, as a ratio; inf when ideal.
    """

    p_BN: Vec3
    distance: float
    path: Path
    travel_time: float
    arrival_s: float
    snr: float


class Interrogator(Instrument):
    """The questions of one device; subclasses make readings of the answers."""

    paces = True
    settings: InterrogationSettings

    def __init__(self, mount: Pose, config: InterrogationTable) -> None:
        self._mount, self._table = mount, config
        self._names = tuple(config.beacons)
        self._absorption = Absorption(config.frequency_hz)
        self.arguments = (
            Argument("max_range", "float", "from how far answers are waited for", "m", False, minimum=1, maximum=config.max_range_m),
            Argument("gain", "float", "added to the source level of both sides", "dB", False, minimum=-60, maximum=0),
            Argument("sound_speed", "float", "what the device believes; 0 for the truth", "m/s", False, minimum=0, maximum=2000),
        )  # fmt: skip
        speed = 0.0 if config.assumed_sound_speed_mps is UNSET else config.assumed_sound_speed_mps
        super().__init__(InterrogationSettings(config.max_range_m, 0.0, speed))

    def turn_on(self) -> list[float]:
        """Ready at once, the first beacon first."""
        return [0.0, 0.0]

    def believed(self, c: float) -> float:
        """The sound speed (m/s) that the device counts with, where it is c."""
        return c if self._table.ideal or not self.settings.sound_speed else self.settings.sound_speed

    def is_ready(self, scope: Scope) -> bool:
        """Whether the last exchange is over."""
        return scope.t >= self.memory[READY] - 1e-6

    def ask(self, scope: Scope, p_NS: Vec3) -> tuple[str, Answer | None, float]:
        """Ask the next beacon: its name, its answer (None: there is none), and the time (s) until the reading is delivered."""
        table, reach = self._table, self.settings.max_range
        number = int(self.memory[NEXT]) % len(self._names)
        name = self._names[number]
        beacon = table.beacons[name]
        answer = self._answer(scope, p_NS, beacon)
        patience = 2.0 * reach / scope.water.sound_speed(p_NS[2]) + beacon.turn_around_s
        if answer is not None and answer.arrival_s > patience:
            answer = None
        wait = (patience if answer is None else answer.arrival_s) + table.processing_s
        self.memory = [scope.t + wait, float((number + 1) % len(self._names))]
        return name, answer, wait

    def _answer(self, scope: Scope, p_NS: Vec3, beacon: Beacon) -> Answer | None:
        p = beacon.position(scope)
        # Drawn whether needed or not: what one beacon does must not shift another's errors.
        fading, first, second, turn, luck = self.rng.standard_normal(5).tolist()
        if p is None or submergence(scope, p_NS) <= 0.0 or submergence(scope, p) <= 0.0:
            return None
        across, distance = math.hypot(p[0] - p_NS[0], p[1] - p_NS[1]), math.dist(p, p_NS)
        if distance > self.settings.max_range or self._hidden(scope, p_NS, p, distance):
            return None
        column = scope.water.column
        lead = eigenray if self._table.propagation == "layered" else straight
        path = lead(column.depth, column.sound_speed, across, p_NS[2], p[2])
        travel, snr = 2.0 * path.time, math.inf
        if not self._table.ideal:
            level = self._snr_db(scope, distance, p_NS[2]) + self._table.fading_sigma_db * fading
            if level < self._table.threshold_db:
                return None
            snr = 10.0 ** (0.1 * level)
            jitter = 1.0 / (self._table.bandwidth_hz * math.sqrt(snr))
            travel += jitter * (first + second) + self._table.turn_around_sigma_s * turn
            if 0.5 * math.erfc(luck / math.sqrt(2.0)) < self._table.multipath_probability:
                travel += 2.0 * (path.time * math.hypot(across, p_NS[2] + p[2]) / max(distance, 1e-6) - path.time)
        return Answer(p, distance, path, travel, travel + beacon.turn_around_s, snr)

    def _snr_db(self, scope: Scope, distance: float, z: float) -> float:
        """Spherical spreading and absorption over one way; white noise in the band."""
        loss = 20.0 * math.log10(max(distance, 1.0)) + self._absorption.at(scope, z) * distance
        noise = self._table.noise_level_db + 10.0 * math.log10(self._table.bandwidth_hz)
        return self._table.source_level_db + self.settings.gain - loss - noise

    def _hidden(self, scope: Scope, p_NS: Vec3, p: Vec3, distance: float) -> bool:
        """Whether something solid stands between."""
        free = distance - self._table.clearance_m
        if free <= 0.0:
            return False
        direction = np.array([[(b - a) / distance for a, b in zip(p_NS, p, strict=True)]])
        return bool(scope.geometry.raycast(np.array([p_NS]), direction, free).distance[0] <= free)


def carriers(sensor: SensorTable) -> Iterator[tuple[str, str]]:
    """Each beacon of a sensor that sits on a vehicle, and the vehicle's name."""
    if isinstance(sensor, InterrogationTable):
        for name, beacon in sensor.beacons.items():
            if isinstance(beacon.vehicle, str):
                yield name, beacon.vehicle
