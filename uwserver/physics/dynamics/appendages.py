"""The wrench of a body's appendages, and of the shape of its hull, at one instant: foils, propellers, weights, strips, derivatives (compiled)."""

from __future__ import annotations

import math
from typing import Any

from uwserver.physics.dynamics.appendage_forces import foil_force, propeller_force
from uwserver.physics.dynamics.fossen import find_water, gravity_over_surface
from uwserver.physics.dynamics.immersion import depth_below, disc_fraction, immersion, upward
from uwserver.physics.dynamics.scratch import ACTUATED, CENTER, NU, NU_R, PASSIVE, STREAM, UP, WATER
from uwserver.physics.dynamics.strips import along_hull, mount_velocity
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, inlined, separate
from uwserver.physics.kernel.layout import Fitted, Model
from uwserver.physics.kernel.linear import add_force, rotation, velocity_at


@compiled
def _velocity(body: Any, strips: Array, r: Array, R: Array, work: Array) -> tuple[float, float, float]:
    """Return the velocity (m/s, B) through the water of a point r (B, m) of the body whose nu_r is in work[NU_R]."""
    if body.strip_count > 0:
        return mount_velocity(body, strips, r[0], r[1], r[2], R, work)
    return velocity_at(work[NU_R], r[0], r[1], r[2])


@compiled
def _disc(r: Array, radius: float, depth: float, work: Array) -> float:
    """Return the submerged part of a part that reaches `radius` (m) about r (B, m). `depth` is that of the origin, and work[UP] the surface's
    normal in B."""
    return float(disc_fraction(depth - work[UP, 0] * r[0] - work[UP, 1] * r[1] - work[UP, 2] * r[2], radius))


@compiled
def _add_foil(
    foil: Any, velocity: tuple[float, float, float], angle: float, scale: float, work: Array, tau: int
) -> None:
    """Add to work[tau] the lift and drag of one FOIL row that moves through the water with a velocity (m/s, B), at an angle (rad)."""
    x, y, z = velocity
    c, n = foil.chord, foil.normal
    ahead, across = x * c[0] + y * c[1] + z * c[2], x * n[0] + y * n[1] + z * n[2]
    square = x * x + y * y + z * z if foil.whole != 0 else ahead * ahead + across * across
    along, normal = foil_force(foil, angle, ahead, across, square)
    along *= scale
    normal *= scale
    fx, fy, fz = along * c[0] + normal * n[0], along * c[1] + normal * n[1], along * c[2] + normal * n[2]
    add_force(work[tau], foil.r[0], foil.r[1], foil.r[2], fx, fy, fz)


@compiled
def _add_propeller(
    propeller: Any, velocity: tuple[float, float, float], speed: float, scale: float, work: Array
) -> None:
    """Add to work[ACTUATED] the thrust and reaction torque of one PROPELLER row that moves with a velocity (m/s, B), at a shaft speed (rad/s)."""
    x, y, z = velocity
    a = propeller.axis
    advance = math.sqrt(x * x + y * y + z * z) if propeller.whole != 0 else x * a[0] + y * a[1] + z * a[2]
    thrust, torque = propeller_force(propeller, speed, advance)
    thrust *= scale
    torque *= scale
    r = propeller.r
    add_force(work[ACTUATED], r[0], r[1], r[2], thrust * a[0], thrust * a[1], thrust * a[2])
    for i in range(3):
        work[ACTUATED, 3 + i] += torque * a[i]


@compiled
def _add_weight(weight: Any, value: float, R: Array, work: Array) -> None:
    """Add to work[ACTUATED] what one WEIGHT row adds to weight and buoyancy."""
    change = value - weight.zero
    zx, zy, zz = R[2, 0], R[2, 1], R[2, 2]
    m = weight.moment
    work[ACTUATED, 0] += change * weight.force * zx
    work[ACTUATED, 1] += change * weight.force * zy
    work[ACTUATED, 2] += change * weight.force * zz
    work[ACTUATED, 3] += change * (m[1] * zz - m[2] * zy)
    work[ACTUATED, 4] += change * (m[2] * zx - m[0] * zz)
    work[ACTUATED, 5] += change * (m[0] * zy - m[1] * zx)


@compiled
def _add_hull(hull: Any, body: Any, strips: Array, fraction: float, R: Array, work: Array) -> None:
    """Add to work[PASSIVE] the damping that fades with speed, and the cross-flow drag by the midpoint rule. The local velocities are sway v + x r
    and heave w - x q; on a hull with strips the local motion of the water is subtracted."""
    u, v, w, q, r = work[NU_R, 0], work[NU_R, 1], work[NU_R, 2], work[NU_R, 4], work[NU_R, 5]
    fading = fraction * math.exp(-hull.fade * math.sqrt(u * u + v * v + w * w))
    for i in range(6):
        work[PASSIVE, i] -= fading * hull.slow[i] * work[NU_R, i]
    for k in range(hull.strips):
        x = hull.first + k * hull.spacing
        sway, heave = v + x * r, w - x * q
        if body.strip_count > 0:
            _, sway, heave = mount_velocity(body, strips, x, 0.0, 0.0, R, work)
        if hull.joint != 0:
            speed = math.sqrt(sway * sway + heave * heave)
            drag = (hull.sway * sway * sway + hull.heave * heave * heave) / speed if speed > 0.0 else 0.0
            Y, Z = -fraction * drag * sway, -fraction * drag * heave
        else:
            Y, Z = -fraction * hull.sway * abs(sway) * sway, -fraction * hull.heave * abs(heave) * heave
        work[PASSIVE, 1] += Y
        work[PASSIVE, 2] += Z
        work[PASSIVE, 4] -= x * Z
        work[PASSIVE, 5] += x * Y


@inlined
def _subtract_water(
    body: Any, strips: Array, s: Array, source: int, t: float, flow: Array, R: Array, work: Array
) -> None:
    """Subtract the motion of the water, in B, from work[NU_R]."""
    if body.strip_count > 0:
        along_hull(body, strips, s, source, t, flow, R, work)
        for i in range(6):
            work[NU_R, i] -= work[STREAM, i]
    else:
        find_water(body, s, source, t, flow, R, work)
        for i in range(3):
            work[NU_R, i] -= R[0, i] * work[WATER, 0] + R[1, i] * work[WATER, 1] + R[2, i] * work[WATER, 2]


@separate
def appendages(model: Model, fitted: Fitted, body: Any, flow: Array, t: float, source: int, stage: int, w: Any) -> None:
    """Fill w.work[ACTUATED] (parts with a servo: fins, propellers, weights) and w.work[PASSIVE] (the hull), both in B about the origin.

    Args:
        model, fitted: rows of the world.
        body: BODY record.
        flow: (FLOW_SIZE) the water near the body.
        t: time of the instant, s.
        source: row of w.s that holds the state.
        stage: column of fitted.values, the value of each servo at t.
        w: SCRATCH record; R and rows of its work are overwritten. For a body without appendages it stays as it is, with zeros in both rows.
    """
    if body.fitted == 0:
        return
    s, work, R = w.s, w.work, w.R
    rotation(s[source, 3], s[source, 4], s[source, 5], s[source, 6], R)
    for i in range(6):
        work[NU, i] = work[NU_R, i] = s[source, 7 + i]
        work[ACTUATED, i] = work[PASSIVE, i] = 0.0
    _subtract_water(body, model.strips, s, source, t, flow, R, work)
    depth = depth_below(flow, s[source, 0], s[source, 1], s[source, 2], t)
    near_surface = body.shape_count > 0 and depth < body.radius
    fraction = 1.0
    if near_surface:
        upward(flow, R, work[UP])
        fraction = immersion(body, model.shapes, depth, work[CENTER], work[UP : UP + 2, 0:3])

    for k in range(body.foil_first, body.foil_first + body.foil_count):
        foil = fitted.foils[k]
        scale = _disc(foil.r, foil.radius, depth, work) if near_surface else 1.0
        velocity = _velocity(body, model.strips, foil.r, R, work)
        if foil.servo < 0:
            _add_foil(foil, velocity, 0.0, scale, work, PASSIVE)
        else:
            scale *= fitted.servos[foil.servo].efficiency
            _add_foil(foil, velocity, fitted.values[foil.servo, stage], scale, work, ACTUATED)
    for k in range(body.propeller_first, body.propeller_first + body.propeller_count):
        propeller = fitted.propellers[k]
        scale = _disc(propeller.r, 0.5 * propeller.diameter, depth, work) if near_surface else 1.0
        scale *= fitted.servos[propeller.servo].efficiency
        velocity = _velocity(body, model.strips, propeller.r, R, work)
        _add_propeller(propeller, velocity, fitted.values[propeller.servo, stage], scale, work)
    for k in range(body.weight_first, body.weight_first + body.weight_count):
        weight = fitted.weights[k]
        value = fitted.values[weight.servo, stage]
        if weight.displaces != 0:
            value = weight.zero + fraction * (value - weight.zero)
        _add_weight(weight, weight.zero + gravity_over_surface(body, s[source, 2]) * (value - weight.zero), R, work)
    for k in range(body.derivative_first, body.derivative_first + body.derivative_count):
        term = fitted.derivatives[k]
        force = fraction * term.coefficient * work[NU_R, term.j] * work[NU_R, term.k]
        if term.servo < 0:
            work[PASSIVE, term.axis] += force
        else:
            servo = fitted.servos[term.servo]
            value = fitted.values[term.servo, stage]
            work[ACTUATED, term.axis] += force * servo.efficiency * (value if term.power == 1 else value * value)
    for k in range(body.hull_first, body.hull_first + body.hull_count):
        _add_hull(fitted.hulls[k], body, model.strips, fraction, R, work)
