"""What sonars share that light all their beams with one ping: keys, settings, pace, and the job that computes the ping beside the ticks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.frames import Quat, Vec3, matrix, multiply
from uwserver.modifiers.base import Measurement, Memory, Time
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Argument, Value
from uwserver.sensors.acoustic.cross_talk import Sonar, SonarTable, believed_speed, describe
from uwserver.sensors.acoustic.imaging import kernels, speckle
from uwserver.sensors.acoustic.imaging.fan import Swath
from uwserver.sensors.acoustic.receiver import Echoes, Noise, Paths, Pulse, Ranges, Water, gain_over_range, ranges
from uwserver.sensors.base import BYTES_OF_BIN, Distance, Gain, Pose, Scope, Settings, Traits, earlier
from uwserver.sensors.job import Job, PendingMeasurement
from uwserver.table import NonNegative, Positive
from uwserver.units import NANOSECONDS

_SOUND_MPS = 1500.0
"""Typical sound speed, for estimates made before the water is known."""
STRAIGHT = Paths()
"""Neither ghosts nor echoes of the ping before."""
STILL = 0.25
"""Part of a beam width by which a sonar may turn in a ping and still count as not turning. If it turns more, the echoes of its first and its last
attitude are blended."""


class PingTable(SonarTable, kw_only=True, frozen=True):
    """The keys of a sonar whose pings are computed with all their gates.

    Attributes:
        volume_backscatter_db: backscatter of a cubic metre of water, dB re 1/m; without it the water is clear.
        processing_s: time from the last echo to the delivery; in real time the ping must be computed within it.
    """

    volume_backscatter_db: float | UnsetType = UNSET
    processing_s: NonNegative = 0.02

    def traits(self) -> Traits:
        """Return the stages of compiled code and the size of a picture."""
        return Traits(("echoes", "pictures"), picture_bytes=BYTES_OF_BIN * self.bins)

    @property
    def pings_hz(self) -> float:
        """Return about how many pings a second the initial range allows."""
        return 1.0 / (2.0 * self.range_m / _SOUND_MPS + self.overhead_s)

    @property
    def cores(self) -> float:
        """Return about the part of one core that the pings take in real time at the initial range, beside the ticks."""
        return min(self.rate_hz, self.pings_hz) * self.computing_s

    @property
    def computing_s(self) -> float:
        """Return about the processor time of one ping beside the ticks at the start, s; 0 for a sonar that is read within its tick."""
        return 0.0

    @property
    def given_s(self) -> float:
        """Return about the time from the start of a ping to its delivery at the initial range, s."""
        return 2.0 * self.range_m / _SOUND_MPS + self.processing_s + (self.latency_s or 0.0)


class ImagingTable(PingTable, kw_only=True, frozen=True):
    """The keys of a sonar that gives the echo level in each bin.

    Attributes:
        output: 8-bit counts on a logarithmic scale; the sound pressure (amplitude, Pa); or the same as real and imaginary part.
        tvg_spreading, tvg_limit_db: k of the time-varied gain k lg r + 2 alpha r, and its upper limit.
        floor_db: level (dB re 1 uPa after time-varied gain and gain) of count 0.
        dynamic_range_db: range of the 255 counts.
        gain_db: gain at the start.
    """

    output: Literal["counts", "pressure", "complex"] = "counts"
    tvg_spreading: NonNegative = 30.0
    tvg_limit_db: NonNegative = 80.0
    floor_db: float = 118.0
    dynamic_range_db: Positive = 60.0
    gain_db: Annotated[float, Meta(ge=-60, le=60)] = 0.0

    def level(self, settings: PingSettings, alpha: float) -> FloatArray:
        """Return (bins) what is added to the level of each bin before compression, dB; `alpha`: absorption, dB/m."""
        gain = gain_over_range(settings.range, self.bins, self.tvg_spreading, alpha, self.tvg_limit_db)
        return gain + (settings.gain - self.floor_db)


class PingSettings(Settings, frozen=True):
    """See `SonarTable`."""

    range: Distance
    gain: Gain


class PingMemory(Memory):
    """Attributes:
    ready: time of the next ping, s."""

    ready: Time = 0.0


class Instant(NamedTuple):
    """What a job knows of the instant of a ping.

    Attributes:
        scope: the instant itself; a copy that does not change, without vehicles by name.
        p: position of the transducer in N, m.
        poses: rotation matrices from the swath to N at the start, and at the end if that differs.
        ranges, water: those of the ping.
        noise: its random parts; None for the mean.
    """

    scope: Scope
    p: Vec3
    poses: tuple[FloatArray, ...]
    ranges: Ranges
    water: Water
    noise: Noise | None

    def energy(self, echoes: Echoes, paths: Paths = STRAIGHT) -> FloatArray:
        """Return the mean intensity of the echoes (columns, gates), uPa^2.

        If the sonar turns during the ping, the intensities at both attitudes are blended by the time at which each gate is heard.
        """
        each = [echoes.energy(self.scope.geometry, self.water, self.p, R, self.ranges, paths) for R in self.poses]
        if len(each) == 1:
            return each[0]
        passed = (np.arange(each[0].shape[1]) + 0.5) / each[0].shape[1]
        blended: FloatArray = (1.0 - passed) * each[0] + passed * each[1]
        return blended


class _Compute(Job):
    def __init__(self, compute: Callable[[], tuple[Value, ...]]) -> None:
        self._compute = compute

    def run(self) -> tuple[Value, ...]:
        return self._compute()


class Lighting(NamedTuple):
    """How a sonar lights its field of view.

    Attributes:
        swath: its rays and beams.
        axes: (3, 3) matrix whose columns are the axes of the swath in the sensor frame.
        width: width of the narrowest beam, rad; the measure of how much the sonar turns.
        fade: motion (m) and turn (rad) after which the correlation of the speckle is 1 / e.
    """

    swath: Swath
    axes: FloatArray
    width: float
    fade: tuple[float, float]


class Head(NamedTuple):
    """A sonar in one of its modes: the keys of the mode, and how it lights the field of view."""

    table: PingTable
    lighting: Lighting


class PingingSonar(Sonar):
    """Starts a ping when the last one is over.

    Attributes:
        heads: one for each mode, by its name; a sonar without modes has one with the name "".
    """

    paces = True
    settings: PingSettings
    memory: PingMemory

    def __init__(
        self, mount: Pose, heads: Mapping[str, Head], arguments: tuple[Argument, ...], settings: PingSettings
    ) -> None:
        self._mount, self.heads, self.arguments = mount, heads, arguments
        super().__init__(settings)

    def load_kernels(self) -> None:
        # Imported here because numba takes half a second.
        from uwserver.physics.warm import echo_kernels

        echo_kernels()
        kernels.load()

    def turn_on(self) -> PingMemory:
        """Return the memory of a sonar that may ping at once."""
        return PingMemory()

    @property
    def head(self) -> Head:
        """Return the head of the present mode."""
        return self.heads[""]

    def speak(self, voice: Any) -> None:
        """Write into a VOICE how the sonar sounds in its present mode, as `Sonar.speak`."""
        describe(voice, self.draws.key, self.head.table, self._mount.p, self.settings.range, self.memory.ready, self.dt)

    def begins(self, t: float) -> bool:
        """Return whether the last ping is over at time t (s)."""
        return t >= self.memory.ready - 1e-6

    def ping(
        self, scope: Scope, computed: int, compute: Callable[..., tuple[Value, ...]], *given: Any
    ) -> Measurement | None:
        """Start a ping. Return its reading, whose first values are range, gain, frequency and sound speed; None while the last one is not over.

        Args:
            scope: the instant at which it starts.
            computed: number of the fields that follow.
            compute: called later in another thread, with the `Instant` and `given`; returns their values. It must not use what may change (`Job`).
            given: settings of the ping.
        """
        if not self.begins(scope.t):
            return None
        table, reach, p = self.head.table, self.settings.range, scope.position(self._mount.p)
        c = scope.water.sound_speed(p[2])
        believed = believed_speed(table, c)
        duration = 2.0 * reach / believed
        self.memory.ready = scope.t + duration + table.overhead_s
        values: list[Value] = [reach, self.settings.gain, table.frequency_hz, believed, *(None,) * computed]
        delay, height = round((duration + table.processing_s) * NANOSECONDS), scope.submergence(p)
        if height <= 0.0:
            return Measurement(values, False, delay_ns=delay)
        scattering = table.volume_backscatter_db
        volume = 0.0 if scattering is UNSET else 10.0 ** (0.1 * scattering)
        # Absorption changes so little that an instrument asks for it once a metre.
        water = Water(scope.water.absorption(table.frequency_hz, float(round(p[2]))), volume, height, scope.lambert)
        pulse = Pulse(table.source_level_db, table.pulse_s, table.bandwidth_hz, table.noise_level_db)
        divided, poses = ranges(reach, table.bins, c, believed / c, pulse), self._poses(scope, duration)
        noise = self._noise(scope, p, poses[0][:, 0], divided, c)
        seen = scope if table.sees_own_vehicle else scope.without_own_body()
        instant = Instant(seen.still(with_vehicles=False), p, poses, divided, water, noise)
        return PendingMeasurement(values, True, delay_ns=delay, job=_Compute(partial(compute, instant, *given)))

    def _poses(self, scope: Scope, duration: float) -> tuple[FloatArray, ...]:
        """Return the rotation matrix of the swath at the start, and at the end of a ping if the sonar turns during it."""
        lighting = self.head.lighting
        attitudes: list[Quat] = [scope.attitude(self._mount.q)]
        if math.hypot(*scope.w_NB_B) * duration > STILL * lighting.width:
            _, q_NB = earlier(scope.p_NB, scope.q_NB, (*scope.v_NB_B, *scope.w_NB_B), -duration)
            attitudes.append(multiply(q_NB, self._mount.q))
        return tuple(np.array(matrix(q)) @ lighting.axes for q in attitudes)

    def _noise(self, scope: Scope, p: Vec3, axis: FloatArray, divided: Ranges, c: float) -> Noise | None:
        # Drawn even if it is not needed, so that each ping takes as many random numbers.
        number = int(self.rng.integers(1 << 63))
        table, lighting = self.head
        if table.ideal:
            return None
        faded, share = speckle.fading(p, axis, *lighting.fade)
        heard = self.overhear(scope, divided.gates, c, table.cross_talk_db)
        return Noise(self.draws.key, number, faded, share, heard)


def fade_of(width: float, frequency: float) -> tuple[float, float]:
    """Return the motion (m) and the turn (rad) after which the correlation of the speckle is 1 / e: half the transducer's length, and 0.8 beams.

    Args:
        width: width of the beam between half-power points, rad; a line of length L has 0.886 wavelengths / L.
        frequency: frequency of the sound, Hz.
    """
    return 0.5 * 0.886 * 1500.0 / (frequency * width), 0.8 * width
