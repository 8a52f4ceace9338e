"""The estimator: attitude, depth, velocity, position and altitude of a vehicle, from delivered samples of its own sensors.

Compiled code. In all functions `e` is the ESTIMATE of a vehicle, `c` its SPEC, `sensor` the SENSOR of a stream, `v` a sample of it as numbers,
`t_ns` the time of the measurement, and `late` its age, s.

Position, velocity and error of the acceleration along each axis have a Kalman filter: x = (p, v, b); p' = v, v' = a + b with a measured
acceleration a, b' = 0, each with white noise. The covariance is a tuple of its upper triangle (pp, pv, pb, vv, vb, bb). Both horizontal axes
share one covariance, because their measurements come together and are equally good.
"""

from __future__ import annotations

import math
from typing import Any

from uwserver.autopilot.bottom import correct_bottom, fall
from uwserver.autopilot.rows import (
    conjugate,
    four,
    multiply,
    quat_from_rpy,
    rotate,
    rpy_from_quat,
    set_four,
    set_six,
    set_three,
    six,
    three,
)
from uwserver.autopilot.state import NEVER, STILL, Estimate, Six
from uwserver.autopilot.sticks import follow_estimate
from uwserver.autopilot.vehicle_spec import (
    ALTIMETER,
    ATTITUDE,
    BATTERY,
    DVL,
    GPS,
    IMU,
    LBL,
    LEAK,
    MOTION_CAPTURE,
    PRESSURE,
    USBL,
)
from uwserver.environment import earth
from uwserver.frames import Quat, Vec3
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, separate
from uwserver.units import NANOSECONDS

DRIFT = 1e-4
"""Growth of the variance of b, m2/s5."""
SPREAD = 1e-4
"""Growth of the variance of p by errors of scale and heading, which are not in the model, m2/s."""

Measured = tuple[float, float, float, Six]
"""Effect of a measurement: the Kalman gains of p, v and b, and the covariance after it."""
LEVELLING = 0.5
"""Rate at which the accelerometer corrects the tilt if no device measures the attitude, 1/s."""
ALONE_NS = NANOSECONDS // 2
"""After this time without an attitude from a device, the IMU alone gives the tilt."""
QUIET = 0.3
"""A specific force shows the vertical if it differs from gravity by less than this part."""
DRIFT_S, DRIFT_RADPS = 5.0, 0.05
"""Time constant with which the error of the gyroscope is learnt if a device measures the attitude; largest error that is accepted."""
STUBBORN = 8
"""After this number of unlikely fixes in a row they are accepted."""
JUMP_MPS, FEW = 0.5, 3
"""A velocity that is off by more than this is rejected as a false echo, unless FEW have been rejected in a row."""
DEPTH_VARIANCE = 0.01**2
VELOCITY_VARIANCE = 0.02**2
COASTING_S = 2.0
"""Time constant with which a motion that no sensor measures is assumed to die away, s."""


@compiled
def predict(c: Six, dt: float, density: float) -> Six:
    """Return the covariance dt (s) later. `density` is `vehicle_spec.MEASURED` or `vehicle_spec.UNMEASURED`."""
    pp, pv, pb, vv, vb, bb = c
    # F = [[1, dt, dt^2/2], [0, 1, dt], [0, 0, 1]]; the noise of the acceleration reaches p in second order only.
    h = 0.5 * dt * dt
    pv1, vv1 = pv + dt * vv + h * vb, vv + dt * vb
    pb1, vb1 = pb + dt * vb + h * bb, vb + dt * bb
    return (
        pp + dt * pv + h * pb + dt * pv1 + h * pb1 + SPREAD * dt,
        pv1 + dt * pb1,
        pb1,
        vv1 + dt * vb1 + density * dt,
        vb1,
        bb + DRIFT * dt,
    )


@compiled
def measure_position(c: Six, variance: float) -> Measured:
    """Return the Kalman gains of p, v and b for a measured position, and the covariance after it. `variance` in m2."""
    pp, pv, pb, vv, vb, bb = c
    s = 1.0 / (pp + variance)
    k, m, n = pp * s, pv * s, pb * s
    rest = 1.0 - k
    return k, m, n, (rest * pp, rest * pv, rest * pb, vv - m * pv, vb - m * pb, bb - n * pb)


@compiled
def measure_velocity(c: Six, variance: float) -> Measured:
    """Return the same for a measured velocity; `variance` in m2/s2."""
    pp, pv, pb, vv, vb, bb = c
    s = 1.0 / (vv + variance)
    k, m, n = pv * s, vv * s, vb * s
    rest = 1.0 - m
    return k, m, n, (pp - k * pv, rest * pv, pb - k * vb, rest * vv, rest * vb, bb - n * vb)


@compiled
def measure_bearing(c: Six, variance: float) -> Measured:
    """Return the same for a measured distance along one horizontal direction. It reduces the shared covariance by half as much as a position fix."""
    k, m, n, d = measure_position(c, variance)
    half = (
        0.5 * (c[0] + d[0]), 0.5 * (c[1] + d[1]), 0.5 * (c[2] + d[2]),
        0.5 * (c[3] + d[3]), 0.5 * (c[4] + d[4]), 0.5 * (c[5] + d[5]),
    )  # fmt: skip
    return k, m, n, half


@compiled
def is_likely(innovation: float, c: Six, variance: float) -> bool:
    """Return whether a difference of a measured position from the estimate (m) is within six standard deviations."""
    return abs(innovation) <= 6.0 * math.sqrt(c[0] + variance)


_north_east = compiled(earth.north_east)


# -- samples --------------------------------------------------------------------------------------------------------------------------------


@separate
def update(p: Any, sensor: Any, beacons: Array, v: Array, t_ns: int, now_ns: int) -> None:
    """Correct the estimate of a PILOT by a valid sample. Impossible values, which may come from a saved state, are ignored."""
    e = p.e
    deep, headed, placed = e.depth_ns == NEVER, e.heading_ns == NEVER, e.fix_ns == NEVER
    _take(p, sensor, beacons, v, t_ns, now_ns)
    deep, headed, placed = deep and e.depth_ns != NEVER, headed and e.heading_ns != NEVER, placed and e.fix_ns != NEVER
    if deep or headed or placed:
        follow_estimate(p.o, e, deep, headed, placed)


@compiled
def _take(p: Any, sensor: Any, beacons: Array, v: Array, t_ns: int, now_ns: int) -> None:
    """Correct the estimate, by the kind of the sensor."""
    e, c = p.e, p.c
    late = (now_ns - t_ns) / NANOSECONDS
    kind = sensor.kind
    if kind == IMU:
        _imu(e, c, sensor, v, t_ns)
    elif kind == ATTITUDE:
        _attitude(e, c, sensor, v, t_ns, late)
    elif kind == PRESSURE:
        _pressure(e, sensor, v, t_ns, late)
    elif kind == DVL:
        _dvl(e, sensor, v, t_ns, late)
    elif kind == ALTIMETER:
        correct_bottom(e, sensor, v[sensor.place[0]], t_ns, late)
    elif kind == GPS:
        _gps(e, c, sensor, v, t_ns, late)
    elif kind == MOTION_CAPTURE:
        _motion_capture(e, c, sensor, v, t_ns, late)
    elif kind == USBL:
        _usbl(e, sensor, beacons, v, t_ns, late)
    elif kind == LBL:
        _lbl(e, sensor, beacons, v, t_ns, late)
    elif kind == LEAK:
        e.leak = 1 if v[sensor.place[0]] == 1.0 else 0
    elif kind == BATTERY:
        charge = v[sensor.place[0]]
        if charge == charge:
            e.charge = charge


@compiled
def _is_vector(v: Vec3) -> bool:
    return abs(v[0]) + abs(v[1]) + abs(v[2]) < 1e9


@compiled
def _is_rotation(q: Quat) -> bool:
    return 0.9 < q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] < 1.1


@compiled
def _turned(q: Quat, w: Vec3, dt: float) -> Quat:
    """Return q after a turn with w (rad/s in B) for dt (s), normalised."""
    a, b, c, d = multiply(q, (1.0, 0.5 * dt * w[0], 0.5 * dt * w[1], 0.5 * dt * w[2]))
    n = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    return a * n, b * n, c * n, d * n


@compiled
def _imu(e: Any, c: Any, sensor: Any, v: Array, t_ns: int) -> None:
    f_S, w_S = three(v[sensor.place[0] :]), three(v[sensor.place[1] :])
    if not (_is_vector(f_S) and _is_vector(w_S)):
        return
    f, (wx, wy, wz) = rotate(four(sensor.q), f_S), rotate(four(sensor.q), w_S)
    w = (wx - e.drift[0], wy - e.drift[1], wz - e.drift[2])
    dt = (t_ns - e.imu_ns) / NANOSECONDS if e.imu_ns != NEVER else 0.0
    e.imu_ns = t_ns
    g, q = c.gravity, four(e.q)
    force = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    quiet = abs(force - g) < QUIET * g
    # If no device measures the attitude, or not any more, the vertical gives the tilt.
    alone = t_ns - e.heading_ns > ALONE_NS
    if alone:
        if e.attitude_ns == NEVER and force > 0.0:
            # The first tilt is that of the first specific force, which points up.
            yaw = rpy_from_quat(q)[2]
            q = quat_from_rpy(math.atan2(-f[1], -f[2]), math.atan2(f[0], math.hypot(f[1], f[2])), yaw)
        if quiet:
            e.attitude_ns = t_ns
    set_three(e.w, w)
    if dt > 0.0:
        turn = w
        if alone and quiet:
            ux, uy, uz = rotate(conjugate(q), (0.0, 0.0, -1.0))
            k = LEVELLING / force
            turn = (
                w[0] + k * (f[1] * uz - f[2] * uy),
                w[1] + k * (f[2] * ux - f[0] * uz),
                w[2] + k * (f[0] * uy - f[1] * ux),
            )
        q = _turned(q, turn, min(dt, 0.5))
    set_four(e.q, q)
    ax, ay, az = rotate(q, f)
    for i, part in enumerate((ax, ay, az + g)):
        e.acceleration[i] += part
    e.count += 1


@compiled
def _attitude(e: Any, c: Any, sensor: Any, v: Array, t_ns: int, late: float) -> None:
    q_NS = four(v[sensor.place[0] :])
    if not _is_rotation(q_NS):
        return
    q = multiply(q_NS, conjugate(four(sensor.q)))
    if sensor.north != 0.0:
        q = multiply(quat_from_rpy(0.0, 0.0, sensor.north), q)
    _correct_attitude(e, c, q, t_ns, late)


@compiled
def _correct_attitude(e: Any, c: Any, q: Quat, t_ns: int, late: float) -> None:
    before = _turned(four(e.q), three(e.w), -late)
    if c.has_imu == 0 and e.attitude_ns != NEVER and t_ns > e.attitude_ns:
        # Without a gyroscope the rate is found from consecutive attitudes, and smoothed.
        d = multiply(conjugate(before), q)
        k = math.copysign(2.0 / ((t_ns - e.attitude_ns) / NANOSECONDS), d[0])
        for i in range(3):
            e.w[i] += 0.3 * (k * d[1 + i] - e.w[i])
    elif c.has_imu != 0 and 0 < t_ns - e.heading_ns < NANOSECONDS:
        # The angle by which the gyroscope has turned too far since the last attitude shows its drift. An uncorrected drift would make an error of
        # heading of the drift over `heading_p`.
        d = multiply(conjugate(q), before)
        k = math.copysign(2.0 / DRIFT_S, d[0])
        for i in range(3):
            e.drift[i] = max(-DRIFT_RADPS, min(DRIFT_RADPS, e.drift[i] + k * d[1 + i]))
    set_four(e.q, _turned(q, three(e.w), late))
    e.attitude_ns = e.heading_ns = t_ns


@compiled
def _pressure(e: Any, sensor: Any, v: Array, t_ns: int, late: float) -> None:
    reading = v[sensor.place[0]]
    if not abs(reading) < 1e9:
        return
    depth = (reading - sensor.atmosphere) / sensor.density if sensor.density != 0.0 else reading
    _correct_depth(e, depth - rotate(four(e.q), three(sensor.p))[2], late, DEPTH_VARIANCE)
    e.depth_ns = t_ns


@compiled
def _correct_depth(e: Any, z: float, late: float, variance: float) -> None:
    d = z - (e.p[2] - e.v[2] * late)
    _correct_down(e, measure_position(six(e.steep), variance), d)


@compiled
def _dvl(e: Any, sensor: Any, v: Array, t_ns: int, late: float) -> None:
    v_S, merit = three(v[sensor.place[0] :]), v[sensor.place[2]]
    if not _is_vector(v_S):
        return
    (x, y, z), (wx, wy, wz), (rx, ry, rz) = rotate(four(sensor.q), v_S), three(e.w), three(sensor.p)
    v_N = rotate(four(e.q), (x - wy * rz + wz * ry, y - wz * rx + wx * rz, z - wx * ry + wy * rx))
    dx, dy, dz = v_N[0] - e.v[0], v_N[1] - e.v[1], v_N[2] - e.v[2]
    if e.velocity_ns != NEVER and math.sqrt(dx * dx + dy * dy + dz * dz) > JUMP_MPS and e.doubted < FEW:
        e.doubted += 1
        return
    e.doubted = 0
    variance = max(VELOCITY_VARIANCE, merit * merit) if merit == merit else VELOCITY_VARIANCE
    _correct_level(e, measure_velocity(six(e.flat), variance), dx, dy)
    _correct_down(e, measure_velocity(six(e.steep), variance), dz)
    e.velocity_ns = t_ns
    correct_bottom(e, sensor, v[sensor.place[1]], t_ns, late)


@compiled
def _gps(e: Any, c: Any, sensor: Any, v: Array, t_ns: int, late: float) -> None:
    latitude, longitude, accuracy = v[sensor.place[0]], v[sensor.place[1]], v[sensor.place[2]]
    if not (abs(latitude) < 1e9 and abs(longitude) < 1e9):
        return
    north, east = _north_east(latitude, longitude, c.latitude, c.longitude)
    _correct_place(e, north, east, three(sensor.p), accuracy if accuracy > 0.0 else sensor.sigma, t_ns, late)


@compiled
def _motion_capture(e: Any, c: Any, sensor: Any, v: Array, t_ns: int, late: float) -> None:
    p_NS, q_NS = three(v[sensor.place[0] :]), four(v[sensor.place[1] :])
    if not (_is_vector(p_NS) and _is_rotation(q_NS)):
        return
    if c.has_attitude == 0:
        _correct_attitude(e, c, multiply(q_NS, conjugate(four(sensor.q))), t_ns, late)
    _correct_place(e, p_NS[0], p_NS[1], three(sensor.p), sensor.sigma, t_ns, late)
    _correct_depth(e, p_NS[2] - rotate(four(e.q), three(sensor.p))[2], late, sensor.sigma**2)
    e.depth_ns = t_ns


@compiled
def _usbl(e: Any, sensor: Any, beacons: Array, v: Array, t_ns: int, late: float) -> None:
    number, reach, p_beacon_S = int(v[sensor.place[0]]), v[sensor.place[1]], three(v[sensor.place[2] :])
    if number < 0 or reach != reach or not _is_vector(p_beacon_S):
        return
    beacon = beacons[sensor.beacon_first + number]
    towards = rotate(four(e.q), rotate(four(sensor.q), p_beacon_S))
    sigma = math.hypot(sensor.sigma, 0.02 * reach)
    _correct_place(e, beacon[0] - towards[0], beacon[1] - towards[1], three(sensor.p), sigma, t_ns, late)


@compiled
def _lbl(e: Any, sensor: Any, beacons: Array, v: Array, t_ns: int, late: float) -> None:
    number, reach = int(v[sensor.place[0]]), v[sensor.place[1]]
    if number < 0 or reach != reach:
        return
    arm, beacon = rotate(four(e.q), three(sensor.p)), beacons[sensor.beacon_first + number]
    x = e.p[0] - e.v[0] * late + arm[0] - beacon[0]
    y = e.p[1] - e.v[1] * late + arm[1] - beacon[1]
    z = e.p[2] - e.v[2] * late + arm[2] - beacon[2]
    flat = math.hypot(x, y)
    level = math.sqrt(max(reach * reach - z * z, 0.0))
    if flat < 1.0 or level < 1.0:
        return  # straight above the beacon its range does not depend on the place
    variance = (sensor.sigma * reach / level) ** 2
    d = level - flat
    if not is_likely(d, six(e.flat), variance) and e.refused < STUBBORN:
        e.refused += 1
        return
    e.refused = 0
    _correct_level(e, measure_bearing(six(e.flat), variance), d * x / flat, d * y / flat)
    e.fix_ns = t_ns


@compiled
def _correct_place(e: Any, north: float, east: float, arm: Vec3, sigma: float, t_ns: int, late: float) -> None:
    x, y, _ = rotate(four(e.q), arm)
    dx, dy = north - x - (e.p[0] - e.v[0] * late), east - y - (e.p[1] - e.v[1] * late)
    variance = sigma * sigma
    if not is_likely(math.hypot(dx, dy), six(e.flat), variance):
        e.refused += 1
        if e.refused < STUBBORN:
            return
        e.flat[0], e.flat[1], e.flat[2] = 1e6, 0.0, 0.0
    e.refused = 0
    _correct_level(e, measure_position(six(e.flat), variance), dx, dy)
    e.fix_ns = t_ns


@compiled
def _correct_level(e: Any, measured: Measured, dx: float, dy: float) -> None:
    """Correct the horizontal motion by an innovation north and east, and its covariance. `measured` is the result of a `measure_` function."""
    k, m, n, after = measured
    set_six(e.flat, after)
    _shift(e, 0, dx, k, m, n)
    _shift(e, 1, dy, k, m, n)


@compiled
def _correct_down(e: Any, measured: Measured, dz: float) -> None:
    """Correct the vertical motion by an innovation, and its covariance. `measured` is the result of a `measure_` function."""
    k, m, n, after = measured
    set_six(e.steep, after)
    _shift(e, 2, dz, k, m, n)


@compiled
def _shift(e: Any, axis: int, d: float, k: float, m: float, n: float) -> None:
    """Correct position, velocity and bias along an axis of N by an innovation d, with these gains."""
    e.p[axis] += k * d
    e.v[axis] += m * d
    e.bias[axis] += n * d


# -- time -----------------------------------------------------------------------------------------------------------------------------------


@compiled
def go_on(e: Any, c: Any, drifts: bool, sinks: bool) -> None:
    """Predict the estimate after one step of the autopilot.

    Args:
        e, c: those of the vehicle.
        drifts: no sensor measures the horizontal motion. It is then assumed to die away, because its integral would consist of errors of tilt.
        sinks: the same for the vertical motion.
    """
    dt, share = c.dt, 1.0 / e.count if e.count else 0.0
    ax, ay, az = (
        share * e.acceleration[0] + e.bias[0], share * e.acceleration[1] + e.bias[1], share * e.acceleration[2] + e.bias[2],
    )  # fmt: skip
    set_three(e.acceleration, STILL)
    e.count = 0
    if drifts:
        ax, ay = -e.v[0] / COASTING_S, -e.v[1] / COASTING_S
        set_six(e.flat, (e.flat[0], 0.0, 0.0, 1.0, 0.0, 0.01))
    if sinks:
        az = -e.v[2] / COASTING_S
        set_six(e.steep, (e.steep[0], 0.0, 0.0, 1.0, 0.0, 0.01))
    h = 0.5 * dt * dt
    e.bottom += fall(e) * dt
    for i, a in enumerate((ax, ay, az)):
        e.p[i] += e.v[i] * dt + a * h
        e.v[i] += a * dt
    set_six(e.flat, predict(six(e.flat), dt, c.restlessness))
    set_six(e.steep, predict(six(e.steep), dt, c.restlessness))


def place_at(e: Estimate, north: float, east: float, down: float | None) -> None:
    """Correct dead reckoning: the vehicle is at this place (m), with a standard deviation of 0.5 m. `down` is None if the depth is measured."""
    e.p = (north, east, e.p[2] if down is None else down)
    e.flat = (0.25, 0.0, 0.0, e.flat[3], e.flat[4], e.flat[5])
    e.refused = 0
