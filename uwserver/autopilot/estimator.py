"""Where the vehicle believes itself to be, from delivered samples of its own sensors: attitude, depth, velocity, position, altitude."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np

from uwserver.autopilot import tracks
from uwserver.autopilot.gains import Gains
from uwserver.autopilot.readings import Unusable, number, quaternion, vector
from uwserver.autopilot.state import NEVER, STILL, Estimate
from uwserver.environment.geodesy import north_east
from uwserver.frames import IDENTITY, Quat, Vec3, conjugate, multiply, quat_from_rpy, rotate, rpy_from_quat
from uwserver.ports import Field, Sample, Value
from uwserver.ports.checks import bind
from uwserver.units import NANOSECONDS

LEVELLING = 0.5
"""How fast the accelerometer turns tilt to the vertical where no device measures the attitude, 1/s."""
ALONE_NS = NANOSECONDS // 2
"""So long after the last attitude of a device the IMU keeps the tilt alone."""
QUIET = 0.3
"""Part of gravity by which a specific force may differ and still show the vertical."""
DRIFT_S, DRIFT_RADPS = 5.0, 0.05
"""Time constant with which the gyroscope's error is learnt where a device measures the attitude, and the largest that is believed."""
BOTTOM_S = 0.5
"""Time constant of the bottom's depth under the vehicle, s."""
STUBBORN = 8
"""So many unlikely fixes in a row are right after all."""
JUMP_MPS, FEW = 0.5, 3
"""A velocity so far from what is expected is a false echo, unless more follow."""
DEPTH_VARIANCE = 0.01**2
VELOCITY_VARIANCE = 0.02**2
COASTING_S = 2.0
"""Time constant with which a motion is taken to die away that nothing tells of, s."""
CERTAIN_MPS = 0.3
"""A velocity from positions alone counts where its standard deviation is less."""

_Update = Callable[..., None]
"""Of an estimate by one sample: estimator, estimate, time at which it was true (ns), source, age (s), and the values of the fields."""


class Source(NamedTuple):
    """One sensor that the autopilot listens to.

    Attributes:
        kind: of the sensor.
        fields: of its port.
        p, q: its mount, p_BS (m) and q_BS.
        sigma: standard deviation that the operator expects of its position, m.
        north: by how much its north is east of true north, rad.
        density, atmosphere: of a pressure sensor: rho g (Pa/m) and the pressure at the surface (Pa); 0 where it tells depth.
    """

    kind: str
    fields: tuple[Field, ...]
    p: Vec3 = STILL
    q: Quat = IDENTITY
    sigma: float = 0.05
    north: float = 0.0
    density: float = 0.0
    atmosphere: float = 0.0


@dataclass(frozen=True)
class Surroundings:
    """What the operator knows of the place.

    Attributes:
        gravity: m/s2.
        latitude, longitude: of the origin of N, rad.
        beacons: p_N (m) where beacons are thought to be, by name.
        start: p_N where the dead reckoning begins; None: at the origin of N, without being sure of it.
    """

    gravity: float = 9.81
    latitude: float = 0.0
    longitude: float = 0.0
    beacons: Mapping[str, Vec3] = field(default_factory=dict)
    start: Vec3 | None = None


class Estimator:
    """Turns samples into an `Estimate`, which holds all that it remembers.

    Attributes:
        sources: the sensors, by port path.
        has_imu: one of them is an IMU.
        UPDATES: what it does with a sample of each kind of sensor that it can listen to, and the fields that it takes; `depth` of a pressure
            sensor that tells that.
    """

    def __init__(self, sources: Mapping[str, Source], place: Surroundings, rate_hz: float) -> None:
        """Listen to these sensors, by port path."""
        self.sources = sources
        self._place = place
        self._dt = 1.0 / rate_hz
        kinds = [source.kind for source in sources.values()]
        self.has_imu = "imu" in kinds
        self._has_attitude = "attitude" in kinds
        self._density = tracks.MEASURED if self.has_imu else tracks.UNMEASURED
        self._updates: dict[str, tuple[_Update, tuple[int, ...]]] = {}
        for path, source in sources.items():
            update, names = self.UPDATES[source.kind]
            if source.kind == "pressure" and any(field.name == "depth" for field in source.fields):
                names = ("depth",)
            self._updates[path] = update, bind(path, source.fields, *names)

    def begin(self) -> Estimate:
        """The estimate before the first sample."""
        start = self._place.start
        if start is None:
            return Estimate()
        return Estimate(p=start, flat=(1.0, 0.0, 0.0, 1.0, 0.0, 0.01))

    def update(self, e: Estimate, sample: Sample, now_ns: int) -> None:
        """Correct the estimate by a delivered sample; an invalid one tells nothing."""
        if sample.valid:
            update, places = self._updates[sample.port]
            values = [sample.value[k] for k in places]
            with contextlib.suppress(Unusable):
                update(self, e, sample.t_ns, self.sources[sample.port], (now_ns - sample.t_ns) / NANOSECONDS, *values)

    def step(self, e: Estimate, drifts: bool, sinks: bool) -> None:
        """Go on by one step of the autopilot.

        Args:
            e: changed in place.
            drifts: nothing tells of the horizontal motion, which is then taken to die away rather than integrated from tilt errors.
            sinks: likewise of the vertical one.
        """
        dt, n = self._dt, e.count
        if n:
            ax, ay, az = (a / n for a in e.acceleration)
            e.acceleration, e.count = STILL, 0
        else:
            ax = ay = az = 0.0
        (x, y, z), (vx, vy, vz), (bx, by, bz) = e.p, e.v, e.bias
        ax, ay, az = ax + bx, ay + by, az + bz
        if drifts:
            ax, ay = -vx / COASTING_S, -vy / COASTING_S
            e.flat = (e.flat[0], 0.0, 0.0, 1.0, 0.0, 0.01)
        if sinks:
            az = -vz / COASTING_S
            e.steep = (e.steep[0], 0.0, 0.0, 1.0, 0.0, 0.01)
        h = 0.5 * dt * dt
        e.p = (x + vx * dt + ax * h, y + vy * dt + ay * h, z + vz * dt + az * h)
        e.v = (vx + ax * dt, vy + ay * dt, vz + az * dt)
        e.flat = tracks.predict(e.flat, dt, self._density)
        e.steep = tracks.predict(e.steep, dt, self._density)

    # -- sensors --------------------------------------------------------------------------------------------------------------------

    def _imu(self, e: Estimate, t_ns: int, source: Source, late: float, f_S: Value, w_S: Value) -> None:
        f, (wx, wy, wz), (dx, dy, dz) = rotate(source.q, vector(f_S)), rotate(source.q, vector(w_S)), e.drift
        w = (wx - dx, wy - dy, wz - dz)
        dt = (t_ns - e.imu_ns) / NANOSECONDS if e.imu_ns != NEVER else 0.0
        e.imu_ns = t_ns
        g = self._place.gravity
        force = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
        # Nothing measures the attitude, or not any more: the vertical shows the tilt.
        alone = t_ns - e.heading_ns > ALONE_NS
        if alone:
            if e.attitude_ns == NEVER and force > 0.0:
                # Level as the first specific force says, which points up.
                yaw = rpy_from_quat(e.q)[2]
                e.q = quat_from_rpy(math.atan2(-f[1], -f[2]), math.atan2(f[0], math.hypot(f[1], f[2])), yaw)
            if abs(force - g) < QUIET * g:
                e.attitude_ns = t_ns
        e.w = w
        if dt > 0.0:
            turn = w
            if alone and abs(force - g) < QUIET * g:
                ux, uy, uz = rotate(conjugate(e.q), (0.0, 0.0, -1.0))
                k = LEVELLING / force
                turn = (
                    w[0] + k * (f[1] * uz - f[2] * uy),
                    w[1] + k * (f[2] * ux - f[0] * uz),
                    w[2] + k * (f[0] * uy - f[1] * ux),
                )
            e.q = _turned(e.q, turn, min(dt, 0.5))
        a = rotate(e.q, f)
        sx, sy, sz = e.acceleration
        e.acceleration = (sx + a[0], sy + a[1], sz + a[2] + g)
        e.count += 1

    def _attitude(self, e: Estimate, t_ns: int, source: Source, late: float, q_NS: Value) -> None:
        q = multiply(quaternion(q_NS), conjugate(source.q))
        if source.north:
            q = multiply(quat_from_rpy(0.0, 0.0, source.north), q)
        self._correct_attitude(e, q, t_ns, late)

    def _correct_attitude(self, e: Estimate, q: Quat, t_ns: int, late: float) -> None:
        if not self.has_imu and e.attitude_ns != NEVER and t_ns > e.attitude_ns:
            # No gyroscope: the rate from two attitudes, smoothed over some of them.
            dt = (t_ns - e.attitude_ns) / NANOSECONDS
            d = multiply(conjugate(_turned(e.q, e.w, -late)), q)
            sign = math.copysign(2.0 / dt, d[0])
            e.w = tuple(w + 0.3 * (sign * c - w) for w, c in zip(e.w, d[1:], strict=True))  # type: ignore[assignment]
        elif self.has_imu and 0 < t_ns - e.heading_ns < NANOSECONDS:
            # What the gyroscope has turned too far since the last attitude: left alone, the heading would stand off by that over heading_p.
            w, x, y, z = multiply(conjugate(q), _turned(e.q, e.w, -late))
            k = math.copysign(2.0 / DRIFT_S, w)
            drift = (bias + k * turn for bias, turn in zip(e.drift, (x, y, z), strict=True))
            e.drift = tuple(max(-DRIFT_RADPS, min(DRIFT_RADPS, bias)) for bias in drift)  # type: ignore[assignment]
        e.q = _turned(q, e.w, late)
        e.attitude_ns = e.heading_ns = t_ns

    def _pressure(self, e: Estimate, t_ns: int, source: Source, late: float, reading: Value) -> None:
        reading = number(reading)
        depth = (reading - source.atmosphere) / source.density if source.density else reading
        self._correct_depth(e, depth - rotate(e.q, source.p)[2], late, DEPTH_VARIANCE)
        e.depth_ns = t_ns

    def _correct_depth(self, e: Estimate, z: float, late: float, variance: float) -> None:
        k, m, n, e.steep = tracks.measure_position(e.steep, variance)
        d = z - (e.p[2] - e.v[2] * late)
        e.p = (e.p[0], e.p[1], e.p[2] + k * d)
        e.v = (e.v[0], e.v[1], e.v[2] + m * d)
        e.bias = (e.bias[0], e.bias[1], e.bias[2] + n * d)

    def _dvl(
        self, e: Estimate, t_ns: int, source: Source, late: float, v_S: Value, altitude: Value, merit: Value
    ) -> None:
        v, (wx, wy, wz), (rx, ry, rz) = rotate(source.q, vector(v_S)), e.w, source.p
        v_N = rotate(e.q, (v[0] - wy * rz + wz * ry, v[1] - wz * rx + wx * rz, v[2] - wx * ry + wy * rx))
        if e.velocity_ns != NEVER and math.dist(v_N, e.v) > JUMP_MPS and e.doubted < FEW:
            e.doubted += 1
            return
        e.doubted = 0
        variance = max(VELOCITY_VARIANCE, merit * merit) if isinstance(merit, float) else VELOCITY_VARIANCE
        self._correct_velocity(e, v_N, variance)
        e.velocity_ns = t_ns
        self._correct_bottom(e, t_ns, source, altitude, late)

    def _correct_velocity(self, e: Estimate, v_N: Vec3, variance: float) -> None:
        dx, dy, dz = v_N[0] - e.v[0], v_N[1] - e.v[1], v_N[2] - e.v[2]
        k, m, n, e.flat = tracks.measure_velocity(e.flat, variance)
        s, t, u, e.steep = tracks.measure_velocity(e.steep, variance)
        e.p = (e.p[0] + k * dx, e.p[1] + k * dy, e.p[2] + s * dz)
        e.v = (e.v[0] + m * dx, e.v[1] + m * dy, e.v[2] + t * dz)
        e.bias = (e.bias[0] + n * dx, e.bias[1] + n * dy, e.bias[2] + u * dz)

    def _altimeter(self, e: Estimate, t_ns: int, source: Source, late: float, reach: Value) -> None:
        self._correct_bottom(e, t_ns, source, reach, late)

    def _correct_bottom(self, e: Estimate, t_ns: int, source: Source, reach: Value, late: float) -> None:
        if not isinstance(reach, float):
            return
        x, y, z = rotate(source.q, (0.0, 0.0, reach))
        below = rotate(e.q, (x + source.p[0], y + source.p[1], z + source.p[2]))[2]
        bottom = e.p[2] - e.v[2] * late + below
        dt = (t_ns - e.altitude_ns) / NANOSECONDS
        share = 1.0 if math.isnan(e.bottom) or dt > 5.0 else dt / (BOTTOM_S + dt)
        e.bottom = bottom if share == 1.0 else e.bottom + share * (bottom - e.bottom)
        e.altitude_ns = t_ns

    def _gps(
        self, e: Estimate, t_ns: int, source: Source, late: float, latitude: Value, longitude: Value, accuracy: Value
    ) -> None:
        latitude, longitude, place = number(latitude), number(longitude), self._place
        north, east = north_east(np.array(latitude), np.array(longitude), place.latitude, place.longitude)
        sigma = accuracy if isinstance(accuracy, float) and accuracy > 0.0 else source.sigma
        self._correct_place(e, t_ns, float(north), float(east), source.p, sigma, late)

    def _motion_capture(self, e: Estimate, t_ns: int, source: Source, late: float, p_NS: Value, q_NS: Value) -> None:
        (x, y, z), q = vector(p_NS), quaternion(q_NS)
        if not self._has_attitude:
            self._correct_attitude(e, multiply(q, conjugate(source.q)), t_ns, late)
        self._correct_place(e, t_ns, x, y, source.p, source.sigma, late)
        self._correct_depth(e, z - rotate(e.q, source.p)[2], late, source.sigma**2)
        e.depth_ns = t_ns

    def _usbl(
        self, e: Estimate, t_ns: int, source: Source, late: float, name: Value, reach: Value, p_beacon_S: Value
    ) -> None:
        beacon = self._place.beacons.get(str(name))
        if beacon is None or not isinstance(reach, float):
            return
        towards = rotate(e.q, rotate(source.q, vector(p_beacon_S)))
        sigma = math.hypot(source.sigma, 0.02 * reach)
        self._correct_place(e, t_ns, beacon[0] - towards[0], beacon[1] - towards[1], source.p, sigma, late)

    def _lbl(self, e: Estimate, t_ns: int, source: Source, late: float, name: Value, reach: Value) -> None:
        beacon = self._place.beacons.get(str(name))
        if beacon is None or not isinstance(reach, float):
            return
        arm = rotate(e.q, source.p)
        x, y, z = (p - v * late + a - b for p, v, a, b in zip(e.p, e.v, arm, beacon, strict=True))
        flat = math.hypot(x, y)
        level = math.sqrt(max(reach * reach - z * z, 0.0))
        if flat < 1.0 or level < 1.0:
            return  # right above the beacon its range says nothing of the place
        variance = (source.sigma * reach / level) ** 2
        d = level - flat
        if not tracks.is_likely(d, e.flat, variance) and e.refused < STUBBORN:
            e.refused += 1
            return
        e.refused = 0
        k, m, n, e.flat = tracks.measure_bearing(e.flat, variance)
        self._shift(e, d * x / flat, d * y / flat, k, m, n)
        e.fix_ns = t_ns

    def _correct_place(
        self, e: Estimate, t_ns: int, north: float, east: float, arm: Vec3, sigma: float, late: float
    ) -> None:
        x, y, _ = rotate(e.q, arm)
        dx, dy = north - x - (e.p[0] - e.v[0] * late), east - y - (e.p[1] - e.v[1] * late)
        variance = sigma * sigma
        if not tracks.is_likely(math.hypot(dx, dy), e.flat, variance):
            e.refused += 1
            if e.refused < STUBBORN:
                return
            e.flat = (1e6, 0.0, 0.0, e.flat[3], e.flat[4], e.flat[5])
        e.refused = 0
        k, m, n, e.flat = tracks.measure_position(e.flat, variance)
        self._shift(e, dx, dy, k, m, n)
        e.fix_ns = t_ns

    @staticmethod
    def _shift(e: Estimate, dx: float, dy: float, k: float, m: float, n: float) -> None:
        e.p = (e.p[0] + k * dx, e.p[1] + k * dy, e.p[2])
        e.v = (e.v[0] + m * dx, e.v[1] + m * dy, e.v[2])
        e.bias = (e.bias[0] + n * dx, e.bias[1] + n * dy, e.bias[2])

    def _leak(self, e: Estimate, t_ns: int, source: Source, late: float, leak: Value) -> None:
        e.leak = bool(leak)

    def _battery(self, e: Estimate, t_ns: int, source: Source, late: float, charge: Value) -> None:
        if isinstance(charge, float):
            e.charge = charge

    UPDATES: ClassVar[Mapping[str, tuple[_Update, tuple[str, ...]]]] = {
        "imu": (_imu, ("f_S", "w_S")),
        "attitude": (_attitude, ("q_NS",)),
        "pressure": (_pressure, ("pressure",)),
        "dvl": (_dvl, ("v_S", "altitude", "figure_of_merit")),
        "altimeter": (_altimeter, ("range",)),
        "gps": (_gps, ("latitude", "longitude", "horizontal_accuracy")),
        "motion_capture": (_motion_capture, ("p_NS", "q_NS")),
        "usbl": (_usbl, ("beacon", "range", "p_beacon_S")),
        "lbl": (_lbl, ("beacon", "range")),
        "leak": (_leak, ("leak",)),
        "battery": (_battery, ("charge",)),
    }


def place_at(e: Estimate, north: float, east: float, down: float | None) -> None:
    """Correct the dead reckoning: the vehicle is here (m), within half a metre; None where the depth is measured."""
    e.p = (north, east, e.p[2] if down is None else down)
    e.flat = (0.25, 0.0, 0.0, e.flat[3], e.flat[4], e.flat[5])
    e.refused = 0


class Known(NamedTuple):
    """What of an estimate can be trusted at an instant; `motion`: anything tells of the horizontal one."""

    attitude: bool
    heading: bool
    depth: bool
    velocity: bool
    position: bool
    altitude: bool
    motion: bool


def known(e: Estimate, gains: Gains, now_ns: int) -> Known:
    """What was heard within its time-out."""

    def fresh(t_ns: int, timeout_s: float) -> bool:
        return now_ns - t_ns <= timeout_s * NANOSECONDS

    velocity = fresh(e.velocity_ns, gains.velocity_timeout_s)
    fixed = fresh(e.fix_ns, gains.position_timeout_s)
    motion = velocity or fixed
    if fixed and not velocity:
        velocity = e.flat[3] < CERTAIN_MPS**2
    heading = fresh(e.heading_ns, gains.attitude_timeout_s)
    return Known(
        attitude=fresh(e.attitude_ns, gains.attitude_timeout_s),
        heading=heading,
        depth=fresh(e.depth_ns, gains.depth_timeout_s),
        velocity=velocity and heading,
        position=(velocity or fixed) and heading,
        altitude=fresh(e.altitude_ns, gains.altitude_timeout_s) and not math.isnan(e.bottom),
        motion=motion,
    )


def _turned(q: Quat, w: Vec3, dt: float) -> Quat:
    """q after turning with w (rad/s in B) for dt (s); normalised."""
    x, y, z = 0.5 * dt * w[0], 0.5 * dt * w[1], 0.5 * dt * w[2]
    a, b, c, d = multiply(q, (1.0, x, y, z))
    n = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    return (a * n, b * n, c * n, d * n)
