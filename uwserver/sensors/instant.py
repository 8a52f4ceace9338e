"""What sensors in compiled code can ask about the world at one instant: the bodies, the water, the Earth, thrusters, and sound.

A kernel of a sensor gets `surroundings`, a table of addresses of all arrays (`surroundings.FORMS`), and its own `head`, which says on which body the
sensor sits and where. Imports numba.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver import frames
from uwserver.environment import column, earth
from uwserver.environment.acoustics.boundaries import SURFACE_DB
from uwserver.environment.column import DEPTH, PRESSURE, SALINITY, TEMPERATURE
from uwserver.frames import Quat, Vec3
from uwserver.physics.contact import touching
from uwserver.physics.dynamics.flow import ELEVATION, HEAD, POINT_SIZE, V, water_at
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, inlined
from uwserver.physics.kernel.handles import array_at
from uwserver.physics.kernel.layout import SeaRows
from uwserver.physics.rays.echoes import Ground, returned
from uwserver.physics.rays.raycast import NOTHING, SURFACE
from uwserver.sensors.surroundings import FORMS

state_at, nu_dot_at, tau_at = array_at(FORMS, "state"), array_at(FORMS, "nu_dot"), array_at(FORMS, "tau")
_bodies_at, _electrics_at = array_at(FORMS, "bodies"), array_at(FORMS, "electrics")
_thrusters_at, _lags_at = array_at(FORMS, "thrusters"), array_at(FORMS, "lags")
_lambert_at = array_at(FORMS, "lambert")
_places_at, _column_at = array_at(FORMS, "place"), array_at(FORMS, "column")
team_at = array_at(FORMS, "team")
voices_of = array_at(FORMS, "voices")
_touching_at = array_at(FORMS, "touching")
_body_a_at, _body_b_at, _point_at, _impulse_at, _counts_at = (
    array_at(touching.FORMS, name) for name in ("body_a", "body_b", "point", "impulse", "counts")
)
_uniform_at, _profiles_at, _waves_at = array_at(FORMS, "uniform"), array_at(FORMS, "profiles"), array_at(FORMS, "waves")

rotate, multiply = compiled(frames.rotate), compiled(frames.multiply)
_absorption = compiled(column.absorption)
latitude_longitude = compiled(earth.latitude_longitude)
_turns_of_level = compiled(earth.turns_of_level)
conjugate, quat_from_rpy, rpy_from_quat, spin = (
    compiled(frames.conjugate), compiled(frames.quat_from_rpy), compiled(frames.rpy_from_quat), compiled(frames.spin),
)  # fmt: skip


@inlined
def place_of(surroundings: Array) -> Any:
    """Return the PLACE of the world."""
    return _places_at(surroundings)[0]


@compiled
def p_NB(head: Any, surroundings: Array) -> Vec3:
    """Return the position of the body origin, m in N."""
    x = state_at(surroundings)[head.body]
    return x[0], x[1], x[2]


@compiled
def q_NB(head: Any, surroundings: Array) -> Quat:
    """Return the attitude of the body."""
    x = state_at(surroundings)[head.body]
    return x[3], x[4], x[5], x[6]


@compiled
def v_NB_B(head: Any, surroundings: Array) -> Vec3:
    """Return the velocity of the body origin, m/s in B."""
    x = state_at(surroundings)[head.body]
    return x[7], x[8], x[9]


@compiled
def w_NB_B(head: Any, surroundings: Array) -> Vec3:
    """Return the angular rate of the body, rad/s in B."""
    x = state_at(surroundings)[head.body]
    return x[10], x[11], x[12]


@compiled
def p_BS(head: Any) -> Vec3:
    """Return the position of the sensor on its body, m in B."""
    return head.p[0], head.p[1], head.p[2]


@compiled
def q_BS(head: Any) -> Quat:
    """Return the attitude of the sensor on its body."""
    return head.q[0], head.q[1], head.q[2], head.q[3]


@compiled
def q_SB(head: Any) -> Quat:
    """Return the inverse of q_BS."""
    return head.to_S[0], head.to_S[1], head.to_S[2], head.to_S[3]


@compiled
def p_NS(head: Any, surroundings: Array) -> Vec3:
    """Return the position of the sensor, m in N."""
    x, y, z = p_NB(head, surroundings)
    a, b, c = rotate(q_NB(head, surroundings), p_BS(head))
    return x + a, y + b, z + c


@compiled
def q_NS(head: Any, surroundings: Array) -> Quat:
    """Return the attitude of the sensor in N."""
    return multiply(q_NB(head, surroundings), q_BS(head))


@compiled
def velocity_of(head: Any, surroundings: Array) -> Vec3:
    """Return the velocity of the sensor's position over ground, m/s in B."""
    (vx, vy, vz), (wx, wy, wz), (rx, ry, rz) = v_NB_B(head, surroundings), w_NB_B(head, surroundings), p_BS(head)
    return vx + wy * rz - wz * ry, vy + wz * rx - wx * rz, vz + wx * ry - wy * rx


@compiled
def level_turns(head: Any, surroundings: Array) -> tuple[Vec3, Vec3]:
    """Return omega_ie and omega_el (rad/s in B): the rate of the Earth, and the rate at which the level axes turn as the body moves over it."""
    place, q = place_of(surroundings), q_NB(head, surroundings)
    rate, curvature = place.rate, place.curvature
    v = rotate(q, v_NB_B(head, surroundings))
    with_earth, transport = _turns_of_level(
        (rate[0], rate[1], rate[2]), (curvature[0], curvature[1]), p_NB(head, surroundings), v
    )
    to_B = conjugate(q)
    return rotate(to_B, with_earth), rotate(to_B, transport)


@compiled
def inertial_rate(head: Any, surroundings: Array) -> Vec3:
    """Return the angular rate of the body against the stars, w_IB (rad/s in B). If the Earth does not turn, it is the rate against N."""
    wx, wy, wz = w_NB_B(head, surroundings)
    if place_of(surroundings).rotating == 0:
        return wx, wy, wz
    (ex, ey, ez), (tx, ty, tz) = level_turns(head, surroundings)
    return wx + ex + tx, wy + ey + ty, wz + ez + tz


@compiled
def specific_force(head: Any, surroundings: Array) -> Vec3:
    """Return what an ideal accelerometer measures, f_S (m/s2): acceleration of its position minus gravity, in S.

    a = v_dot + w x v + w_dot x r + w x (w x r), all in B, from the equations of motion (not from differenced velocity); on a rotating Earth
    also (2 omega_ie + omega_el) x v (Groves 2013, eq. 5.53).
    """
    d, place = nu_dot_at(surroundings)[head.body], place_of(surroundings)
    (wx, wy, wz), (ux, uy, uz), (rx, ry, rz) = w_NB_B(head, surroundings), velocity_of(head, surroundings), p_BS(head)
    ax = d[0] + d[4] * rz - d[5] * ry + wy * uz - wz * uy
    ay = d[1] + d[5] * rx - d[3] * rz + wz * ux - wx * uz
    az = d[2] + d[3] * ry - d[4] * rx + wx * uy - wy * ux
    if place.rotating != 0:
        (ex, ey, ez), (tx, ty, tz) = level_turns(head, surroundings)
        tx, ty, tz = tx + 2.0 * ex, ty + 2.0 * ey, tz + 2.0 * ez
        ax, ay, az = ax + ty * uz - tz * uy, ay + tz * ux - tx * uz, az + tx * uy - ty * ux
    g = place.gravity * (1.0 + place.growth * max(0.0, p_NB(head, surroundings)[2]))
    gx, gy, gz = rotate(conjugate(q_NB(head, surroundings)), (0.0, 0.0, g))
    return rotate(q_SB(head), (ax - gx, ay - gy, az - gz))


@compiled
def _interpolated(column: Array, key: int, k: int, x: float) -> float:
    """Interpolate column k of a table whose column `key` ascends, linearly. Beyond the ends the first or last interval is extended."""
    low, high = 0, len(column)
    while low < high:
        middle = (low + high) // 2
        if x < column[middle, key]:
            high = middle
        else:
            low = middle + 1
    n = min(max(low, 1), len(column) - 1)
    x0, y0 = column[n - 1, key], column[n - 1, k]
    return float(y0 + (column[n, k] - y0) * ((x - x0) / (column[n, key] - x0)))


@compiled
def water_property(surroundings: Array, k: int, depth: float) -> float:
    """Return column k (`TEMPERATURE` to `SOUND_SPEED`) of the water column at a depth below z = 0, m."""
    return _interpolated(_column_at(surroundings), DEPTH, k, max(0.0, depth))


@compiled
def depth_of(surroundings: Array, gauge: float) -> float:
    """Return the depth (m) at which the water above has this pressure, Pa."""
    return _interpolated(_column_at(surroundings), PRESSURE, DEPTH, gauge)


@compiled
def _point(surroundings: Array, p: Vec3, t: float, point: Array) -> None:
    water_at(
        SeaRows(_uniform_at(surroundings), _profiles_at(surroundings), _waves_at(surroundings)),
        p[0],
        p[1],
        p[2],
        t,
        point,
    )


@compiled
def water_velocity(surroundings: Array, p: Vec3, t: float) -> Vec3:
    """Return the velocity of the water at a point of N (m) and time t (s) in the present tick, m/s in N."""
    place = place_of(surroundings)
    if place.moves == 0:
        return place.current[0], place.current[1], place.current[2]
    point = np.empty(POINT_SIZE)
    _point(surroundings, p, t, point)
    return point[V], point[V + 1], point[V + 2]


@compiled
def submergence(surroundings: Array, p: Vec3, t: float) -> float:
    """Return how far a point of N is below the sea surface, m; negative in air."""
    if place_of(surroundings).moves == 0:
        return p[2]
    point = np.empty(POINT_SIZE)
    _point(surroundings, (p[0], p[1], 0.0), t, point)
    return float(p[2] + point[ELEVATION])


@compiled
def gauge_pressure(surroundings: Array, p: Vec3, t: float) -> float:
    """Return the pressure of the water (Pa, above the atmospheric one) at a point of N (m) and time t (s), as `Water.pressure` does."""
    head = p[2]
    if place_of(surroundings).moves != 0:
        point = np.empty(POINT_SIZE)
        _point(surroundings, p, t, point)
        head += point[HEAD]
    return _interpolated(_column_at(surroundings), DEPTH, PRESSURE, max(0.0, head))


@compiled
def magnetic_field(surroundings: Array, p: Vec3) -> Vec3:
    """Return the magnetic field of the Earth (T, in N) at a point of N (m), as `Earth.magnetic_field` does."""
    m, (x, y, z) = place_of(surroundings).magnetic, p
    return (
        m[0, 0] + m[1, 0] * x + m[2, 0] * y + m[3, 0] * z,
        m[0, 1] + m[1, 1] * x + m[2, 1] * y + m[3, 1] * z,
        m[0, 2] + m[1, 2] * x + m[2, 2] * y + m[3, 2] * z,
    )


@compiled
def thrust(surroundings: Array, k: int) -> float:
    """Return the open-water thrust of a row of thrusters at rest, N: after the lag, before inflow and installation."""
    thruster = _thrusters_at(surroundings)[k]
    lag = _lags_at(surroundings)[thruster.lag]
    force = lag.D * thruster.demand
    for i in range(3):
        force += lag.C[i] * thruster.x[i]
    return float(force * thruster.efficiency / thruster.installed)


@compiled
def shaft_speed(head: Any, surroundings: Array, number: int) -> float:
    """Return the shaft speed of a thruster of the vehicle, by its number there: rad/s, with the sign of the thrust; NaN if it is not known."""
    body = _bodies_at(surroundings)[head.body]
    if not 0 <= number < body.thruster_count:
        return math.nan
    k = body.thruster_first + number
    electric, force = _electrics_at(surroundings)[k], thrust(surroundings, k)
    if electric.wired == 0:
        return math.nan
    return math.copysign(electric.speed[1 if force < 0.0 else 0] * math.sqrt(abs(force)), force)


@compiled
def power(head: Any, surroundings: Array) -> float:
    """Return the electric power that all thrusters of the vehicle draw, W."""
    body, electrics = _bodies_at(surroundings)[head.body], _electrics_at(surroundings)
    total = 0.0
    for k in range(body.thruster_first, body.thruster_first + body.thruster_count):
        if electrics[k].wired != 0:
            force = thrust(surroundings, k)
            total += electrics[k].power[1 if force < 0.0 else 0] * abs(force) ** 1.5
    return total


@compiled
def supply_voltage(head: Any, surroundings: Array) -> float:
    """Return the supply voltage of the vehicle's first wired thruster, V; 0 without any."""
    body, electrics = _bodies_at(surroundings)[head.body], _electrics_at(surroundings)
    for k in range(body.thruster_first, body.thruster_first + body.thruster_count):
        if electrics[k].wired != 0:
            return float(_thrusters_at(surroundings)[k].voltage)
    return 0.0


@compiled
def supply(head: Any, surroundings: Array, voltage: float) -> None:
    """Set the supply voltage of the vehicle's wired thrusters, V. 0 stops them."""
    body, electrics, thrusters = (
        _bodies_at(surroundings)[head.body],
        _electrics_at(surroundings),
        _thrusters_at(surroundings),
    )
    for k in range(body.thruster_first, body.thruster_first + body.thruster_count):
        if electrics[k].wired != 0:
            thrusters[k].voltage, thrusters[k].fresh = voltage, 1
            if voltage == 0.0:
                thrusters[k].efficiency = 0.0


@inlined
def touched(surroundings: Array) -> tuple[Array, Array, Array, Array, int]:
    """Return the contacts of the last tick: rows of the bodies a and b (-1 for something that does not move), points (m) and impulses on a (N s),
    both in N; and how many there are, as the arrays are longer."""
    table = _touching_at(surroundings)
    count = _counts_at(table)[touching.KEPT]
    return _body_a_at(table), _body_b_at(table), _point_at(table), _impulse_at(table), count


MU_SURFACE = 10.0 ** (0.1 * SURFACE_DB)


@compiled
def absorption(surroundings: Array, frequency: float, depth: float) -> float:
    """Return the absorption of sound of a frequency (Hz), dB/m, at a depth (m)."""
    temperature, salinity = (
        water_property(surroundings, TEMPERATURE, depth),
        water_property(surroundings, SALINITY, depth),
    )
    return _absorption(frequency, temperature, salinity, depth, place_of(surroundings).ph)


@compiled
def ground_of(surroundings: Array) -> Ground:
    """Return how strongly the things that rays hit scatter sound back."""
    return Ground(_lambert_at(surroundings), MU_SURFACE)


@compiled
def echo_of(surroundings: Array, direction: Array, normal: Array, body: int, material: int) -> float:
    """Return the intensity that a square metre of the hit surface scatters back at 1 m, per unit of incident intensity."""
    return returned(direction, normal, body, material, ground_of(surroundings))


@compiled
def meet_surface(height: float, direction: Array, limit: float, k: int, hits: Any) -> None:
    """Correct the hit of ray k: nothing beyond a limit (m), because other rays may have been cast farther; and the sea surface, if that is nearer.
    The surface is level, and `height` (m) above the start of the ray."""
    if hits.distance[k] > limit:
        hits.distance[k], hits.body[k] = math.inf, NOTHING
    if direction[k, 2] < 0.0:
        reached = -height / direction[k, 2]
        if reached < hits.distance[k] and reached <= limit:
            hits.distance[k] = reached
            hits.normal[k, 0], hits.normal[k, 1], hits.normal[k, 2] = 0.0, 0.0, 1.0
            hits.body[k] = hits.material[k] = SURFACE
