"""What sonars share that light all their beams at once: keys, settings, pace, and what a job needs of the instant of a ping."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.frames import Quat, Vec3, matrix, multiply
from uwserver.modifiers.base import Measurement, Memory, Time
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Argument, Value
from uwserver.sensors.acoustic.cross_talk import Sonar, believed_speed, describe
from uwserver.sensors.acoustic.echo import Absorption, load_kernels
from uwserver.sensors.acoustic.imaging import speckle
from uwserver.sensors.acoustic.imaging.kernels import load as load_pictures
from uwserver.sensors.acoustic.imaging.swath import Swath
from uwserver.sensors.acoustic.receiver import Echoes, Noise, Paths, Pulse, Ranges, Water, ranges
from uwserver.sensors.base import Distance, Gain, Pose, Scope, SensorTable, Settings, earlier
from uwserver.sensors.job import Begun, Job
from uwserver.sensors.traits import BYTES_OF_BIN, Traits
from uwserver.table import NonNegative, Positive
from uwserver.units import NANOSECONDS

_SOUND_MPS = 1500.0
"""About, where no water is known."""
STRAIGHT = Paths()
"""No ghosts, and no echoes of the ping before."""
STILL = 0.25
"""Beam widths that a sonar may turn in a ping and count as still; beyond, its echoes are blended of its first and its last pose."""


class PingTable(SensorTable, kw_only=True, frozen=True):
    """What a sonar needs that pings. `rate_hz` at most: a ping waits until the last one is over.

    Attributes:
        ideal: mean level without speckle, noise and wrong sound speed.
        frequency_hz, bandwidth_hz: of the sound; the bandwidth gives the resolution in range, at best that of a bin.
        pulse_s: its length; a swept pulse longer than 1 / bandwidth is compressed, which lifts the echo by bandwidth times length.
        bins: of a ping, equal ranges apart.
        range_m: at the start; changed by the service `set`.
        min_range_m, max_range_m: limits of the range.
        source_level_db: dB re 1 uPa at 1 m.
        noise_level_db: spectral level of the noise around, dB re 1 uPa^2/Hz.
        volume_backscatter_db: of a cubic metre of water, dB re 1/m; without it the water is clear.
        cross_talk_db: direct sound of other sonars of the vehicle whose bands overlap, beside that on their axis: -40 for two side lobes of -20 dB
            (a model); without it they are not heard.
        assumed_sound_speed_mps: what the device believes; default: the truth.
        sees_own_vehicle: whether what its own vehicle consists of stands in its field; else it looks through it, wherever it is mounted.
        overhead_s: between the end of a ping and the next one.
        processing_s: from the last echo to the delivery; in real time no more is there to compute it.
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
    volume_backscatter_db: float | UnsetType = UNSET
    cross_talk_db: Annotated[float, Meta(ge=-200, le=0)] | UnsetType = UNSET
    assumed_sound_speed_mps: Positive | UnsetType = UNSET
    sees_own_vehicle: bool = False
    overhead_s: NonNegative = 0.005
    processing_s: NonNegative = 0.02

    def __post_init__(self) -> None:
        """ValueError where keys do not go together."""
        check_range(self.range_m, self.min_range_m, self.max_range_m, "the sonar")

    def traits(self) -> Traits:
        """What all of them need, whose pings are computed beside the ticks."""
        return Traits(("echoes", "pictures"), picture_bytes=BYTES_OF_BIN * self.bins)

    @property
    def pings_hz(self) -> float:
        """About how many pings a second its range leaves time for, as it starts."""
        return 1.0 / (2.0 * self.range_m / _SOUND_MPS + self.overhead_s)

    @property
    def cores(self) -> float:
        """About the part of one core that its pings take in real time, as it starts, beside the ticks."""
        return min(self.rate_hz, self.pings_hz) * self.computing_s

    @property
    def computing_s(self) -> float:
        """About the processor time of a ping that is computed beside the ticks, as it starts, s; 0 of one that is read within its tick."""
        return 0.0

    @property
    def given_s(self) -> float:
        """About what a reading takes from its begin to its delivery, as it starts, s."""
        return 2.0 * self.range_m / _SOUND_MPS + self.processing_s + (self.latency_s or 0.0)


def check_range(range_m: float, low: float, high: float, what: str) -> None:
    """ValueError where `what`, of these limits (m), does not take a range."""
    if low > high:
        raise ValueError(f"min_range_m is {low:g} and max_range_m {high:g}: {what} takes no range")
    if not low <= range_m <= high:
        raise ValueError(f"range_m is {range_m:g}, {what} takes {low:g} to {high:g}")


class PingSettings(Settings, frozen=True):
    """See `PingTable`."""

    range: Distance
    gain: Gain


class PingMemory(Memory):
    """Attributes:
    ready: time of the next ping, s."""

    ready: Time = 0.0


def ping_arguments(table: PingTable) -> tuple[Argument, ...]:
    """Of the service ``set``."""
    return (
        Argument(
            "range", "float", "distance at the end of the last bin", "m", False, minimum=table.min_range_m, maximum=table.max_range_m
        ),
        Argument("gain", "float", "added to the level before compression", "dB", False, minimum=-60, maximum=60),
    )  # fmt: skip


class Instant(NamedTuple):
    """What a ping meets, for a job.

    Attributes:
        scope: of the ping; for a job one that stays as it is, without vehicles by name.
        p: of the transducer in N.
        poses: rotations of the swath in N at the start, and at the end where it differs.
        ranges, water: of the ping.
        noise: its random parts; None for the mean.
    """

    scope: Scope
    p: Vec3
    poses: tuple[FloatArray, ...]
    ranges: Ranges
    water: Water
    noise: Noise | None

    def energy(self, echoes: Echoes, paths: Paths = STRAIGHT) -> FloatArray:
        """(columns, gates) mean intensity, uPa^2; where the sonar turns, of its poses by the time at which each gate is heard."""
        each = [echoes.energy(self.scope.geometry, self.water, self.p, R, self.ranges, paths) for R in self.poses]
        if len(each) == 1:
            return each[0]
        passed = (np.arange(each[0].shape[1]) + 0.5) / each[0].shape[1]
        blended: FloatArray = (1.0 - passed) * each[0] + passed * each[1]
        return blended


class Lighting(NamedTuple):
    """How a sonar lights its field.

    Attributes:
        swath: of rays and beams.
        axes: (3, 3) whose columns are the axes of the swath, in the frame of the sensor.
        width: of the narrowest beam, rad: what counts as a turn.
        fade: a motion (m) and a turn (rad) that leave a speckle correlation of 1 / e.
    """

    swath: Swath
    axes: FloatArray
    width: float
    fade: tuple[float, float]


class Head(NamedTuple):
    """What pings: a sonar in one of its modes.

    Attributes:
        table: keys of the mode.
        lighting: of its field.
        pulse: its sound.
        absorption: of its frequency.
    """

    table: PingTable
    lighting: Lighting
    pulse: Pulse
    absorption: Absorption

    @classmethod
    def of(cls, table: PingTable, lighting: Lighting) -> Head:
        """Of a table."""
        pulse = Pulse(table.source_level_db, table.pulse_s, table.bandwidth_hz, table.noise_level_db)
        return cls(table, lighting, pulse, Absorption(table.frequency_hz))


class Sent(NamedTuple):
    """A ping that has begun.

    Attributes:
        values: range, gain, frequency and sound speed.
        delay_ns: until its delivery.
        instant: what it meets; None in the air.
    """

    values: list[Value]
    delay_ns: int
    instant: Instant | None


class PingingSonar(Sonar):
    """Begins a ping when the last one is over."""

    paces = True
    settings: PingSettings
    memory: PingMemory

    def __init__(
        self, mount: Pose, table: PingTable, lighting: Lighting | Mapping[str, Head], settings: PingSettings
    ) -> None:
        """Of a table, whose only mode has this lighting, or of the heads of its modes by name; with the settings of the start."""
        self._mount = mount
        self.heads = {"": Head.of(table, lighting)} if isinstance(lighting, Lighting) else lighting
        self.arguments = ping_arguments(table)
        super().__init__(settings)

    def load_kernels(self) -> None:
        load_kernels()
        load_pictures()

    def turn_on(self) -> PingMemory:
        """Ready at once."""
        return PingMemory()

    @property
    def head(self) -> Head:
        """Of its mode."""
        return self.heads[""]

    def speak(self, voice: Any) -> None:
        """As `Sonar.speak`, in its mode."""
        describe(voice, self.draws.key, self.head.table, self._mount.p, self.settings.range, self.memory.ready, self.dt)

    def begins(self, t: float) -> bool:
        """Whether the last ping is over."""
        return t >= self.memory.ready - 1e-6

    def ping(self, scope: Scope, computed: int, job: Callable[[Instant], Job]) -> Measurement | None:
        """A ping, whose first values are its range, gain, frequency and sound speed; None while the last one is not over.

        Args:
            scope: of its start.
            computed: number of the fields that follow.
            job: computes these.
        """
        if not self.begins(scope.t):
            return None
        sent = self.send(scope, self.head.lighting.axes)
        values = [*sent.values, *(None,) * computed]
        if sent.instant is None:
            return Measurement(values, False, delay_ns=sent.delay_ns)
        work = job(sent.instant._replace(scope=sent.instant.scope.still(with_vehicles=False)))
        return Begun(values, True, delay_ns=sent.delay_ns, job=work)

    def send(self, scope: Scope, axes: FloatArray) -> Sent:
        """Begin a ping, of a swath whose axes are the columns (3, 3) in the frame of the sensor."""
        table, _, pulse, absorption = self.head
        reach = self.settings.range
        p = scope.position(self._mount.p)
        c = scope.water.sound_speed(p[2])
        believed = believed_speed(table, c)
        duration = 2.0 * reach / believed
        self.memory.ready = scope.t + duration + table.overhead_s
        values: list[Value] = [reach, self.settings.gain, table.frequency_hz, believed]
        delay = round((duration + table.processing_s) * NANOSECONDS)
        height = scope.submergence(p)
        if height <= 0.0:
            return Sent(values, delay, None)
        scattering = table.volume_backscatter_db
        volume = 0.0 if scattering is UNSET else 10.0 ** (0.1 * scattering)
        water = Water(absorption.at(scope, p[2]), volume, height, scope.lambert)
        poses = self._poses(scope, axes, duration)
        divided = ranges(reach, table.bins, c, believed / c, pulse)
        noise = self._noise(scope, p, poses[0][:, 0], divided, c)
        seen = scope if table.sees_own_vehicle else scope.without_own_body()
        return Sent(values, delay, Instant(seen, p, poses, divided, water, noise))

    def _poses(self, scope: Scope, axes: FloatArray, duration: float) -> tuple[FloatArray, ...]:
        """Attitude of the swath at the start, and at the end where the sonar turns meanwhile."""
        attitudes: list[Quat] = [scope.attitude(self._mount.q)]
        if math.hypot(*scope.w_NB_B) * duration > STILL * self.head.lighting.width:
            _, q_NB = earlier(scope.p_NB, scope.q_NB, (*scope.v_NB_B, *scope.w_NB_B), -duration)
            attitudes.append(multiply(q_NB, self._mount.q))
        return tuple(np.array(matrix(q)) @ axes for q in attitudes)

    def _noise(self, scope: Scope, p: Vec3, axis: FloatArray, divided: Ranges, c: float) -> Noise | None:
        number = int(self.rng.integers(1 << 63))
        table, lighting, _, _ = self.head
        if table.ideal:
            return None
        faded, share = speckle.fading(p, axis, *lighting.fade)
        heard = self.overhear(scope, divided.gates, c, table.cross_talk_db)
        return Noise(self.draws.key, number, faded, share, heard)


def fade_of(width: float, frequency: float) -> tuple[float, float]:
    """A motion (m) and a turn (rad) that leave a speckle correlation of 1 / e, of a transducer with this beam (rad): half its length, 0.8 beams."""
    return 0.5 * 0.886 * 1500.0 / (frequency * width), 0.8 * width
