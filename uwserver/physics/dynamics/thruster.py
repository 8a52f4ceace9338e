"""From the command of a thruster to its thrust: force table over command and voltage, lag with an exact transition, inflow, immersion (compiled)."""

from __future__ import annotations

import math
from typing import Any

from uwserver.physics.dynamics.immersion import disc_fraction
from uwserver.physics.dynamics.scratch import EXTRA, NU_R, UP
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, separate
from uwserver.physics.kernel.layout import FREE, STUCK, STUCK_AT
from uwserver.physics.kernel.linear import velocity_at

MOST_INFLOW = 2.0
"""Largest thrust against the inflow, over that at rest. The Wageningen B4-70 of pitch ratio 0.8 to 1 has, beyond the drag of the stopped
propeller, 1.6 to 1.7 at J = -1 and 2.1 to 2.3 at -1.5 (`scenario.vehicle.wageningen`)."""


@compiled
def _interpolate(u: float, xs: Array, ys: Array) -> float:
    """Return the piecewise linear y(u), constant beyond the ends; xs ascends."""
    n = xs.shape[0]
    if u <= xs[0]:
        return float(ys[0])
    if u >= xs[n - 1]:
        return float(ys[n - 1])
    low, high = 0, n - 1
    while high - low > 1:
        mid = (low + high) // 2
        if xs[mid] <= u:
            low = mid
        else:
            high = mid
    width = xs[high] - xs[low]
    if width <= 0.0:
        return float(ys[high])
    return float(ys[low] + (ys[high] - ys[low]) * (u - xs[low]) / width)


@compiled
def table_force(table: Any, u: float, voltage: float) -> float:
    """Return the static force (N) at command u (-1..1) and supply voltage (V): linear between the table's voltages, which are not exceeded."""
    n = table.n_voltages
    k = 0
    while k < n - 1 and table.voltage[k + 1] < voltage:
        k += 1
    low = _interpolate(u, table.u[k], table.force[k])
    if k == n - 1 or voltage <= table.voltage[k]:
        return low
    high = _interpolate(u, table.u[k + 1], table.force[k + 1])
    s = (voltage - table.voltage[k]) / (table.voltage[k + 1] - table.voltage[k])
    return low + s * (high - low)


@compiled
def set_demand(thruster: Any, tables: Array) -> None:
    """Set the static thrust for the command of this tick. It is computed only if the command or the voltage was set since.

    A stuck thruster keeps its demand, and the mark that a newer command waits.
    """
    if thruster.stuck == STUCK or (thruster.fresh == 0 and thruster.stuck == FREE):
        return
    table = tables[thruster.table]
    if thruster.stuck == STUCK_AT:
        thruster.demand = table_force(table, thruster.stuck_u, thruster.voltage) * thruster.installed
        return
    if thruster.by_force != 0:
        lowest = table_force(table, -1.0, thruster.voltage) * thruster.installed
        highest = table_force(table, 1.0, thruster.voltage) * thruster.installed
        thruster.demand = min(max(thruster.command, lowest), highest)
    else:
        thruster.demand = table_force(table, thruster.command, thruster.voltage) * thruster.installed
    thruster.fresh = 0


@compiled
def advance_lag(thruster: Any, lag: Any, level: int) -> float:
    """Advance the lag by half a sub-step of 2**-level ticks; exact, as the demand is constant in a tick. Return the lagged force, N."""
    F, G, x, u = lag.F[level], lag.G[level], thruster.x, thruster.demand
    x0 = F[0, 0] * x[0] + F[0, 1] * x[1] + F[0, 2] * x[2] + G[0] * u
    x1 = F[1, 0] * x[0] + F[1, 1] * x[1] + F[1, 2] * x[2] + G[1] * u
    x2 = F[2, 0] * x[0] + F[2, 1] * x[1] + F[2, 2] * x[2] + G[2] * u
    x[0], x[1], x[2] = x0, x1, x2
    return lagged(thruster, lag)


@compiled
def lagged(thruster: Any, lag: Any) -> float:
    """Return the force for the present state of the lag, N."""
    C, x = lag.C, thruster.x
    return float(thruster.efficiency * (C[0] * x[0] + C[1] * x[1] + C[2] * x[2] + lag.D * thruster.demand))


@compiled
def ventilated(submergence: float) -> float:
    """Return the thrust of a ventilating propeller over that deep below, for the depth of its hub in radii.

    1 - 0.675 (1 - 0.769 h/R)^1.258 from -0.48, where nothing is left, to 1.3: loss of disc area and ventilation together (Minsaas, Faltinsen
    and Persson 1983; Smogeli 2006; quoted from memory), for a propeller under heavy load, in calm water. How ventilation comes and goes
    in time is neglected.
    """
    if submergence >= 1.3:
        return 1.0
    return float(max(0.0, 1.0 - 0.675 * (1.0 - 0.769 * submergence) ** 1.258))


@separate
def _across(thruster: Any, va: float, moved: bool, work: Array) -> float:
    """Return the squared speed of the mount through the water across the axis; `va` is its speed along the axis."""
    if moved:
        x, y, z = work[EXTRA, 0], work[EXTRA, 1], work[EXTRA, 2]
    else:
        r = thruster.r
        x, y, z = velocity_at(work[NU_R], r[0], r[1], r[2])
    return float(max(0.0, x * x + y * y + z * z - va * va))


@compiled
def thrust(thruster: Any, force: float, depth: float, near_surface: bool, moved: bool, work: Array) -> float:
    """Return the force of one thruster along its axis (N), from that at rest; work[NU_R] is the velocity through the water.

    Inflow takes T = T0 - k sqrt(|T0|) V_a, the linear part of K_T(J) at the shaft speed that gives T0 at rest; V_a is the speed of the
    mount through the water along the axis. It takes at most the whole thrust, and inflow against the propeller adds at most what MOST_INFLOW
    allows. A stopped propeller has its drag, unless the hull's damping contains it. A stream across the axis bends the jet
    to the hull (Coanda): exp(-c V_t^2) of the thrust remains, for a thruster with c (Palmer, Hearn and Stevenson 2008, for tunnels).
    Thrust scales with the submerged part of the disc, or by `ventilated`; `depth` (m) is that of the body origin below the surface and
    work[UP] the surface's normal in B. Where the water differs along the hull (`moved`), work[EXTRA, :3] has the velocity of the mount.
    """
    if force == 0.0 and thruster.drag == 0.0:
        return 0.0
    if thruster.inflow != 0.0 or thruster.drag != 0.0 or thruster.cross_loss != 0.0:
        c = thruster.per_velocity
        if moved:
            va = c[0] * work[EXTRA, 0] + c[1] * work[EXTRA, 1] + c[2] * work[EXTRA, 2]
        else:
            va = c[0] * work[NU_R, 0] + c[1] * work[NU_R, 1] + c[2] * work[NU_R, 2]
            va = va + c[3] * work[NU_R, 3] + c[4] * work[NU_R, 4] + c[5] * work[NU_R, 5]
        if thruster.cross_loss != 0.0:
            force *= math.exp(-thruster.cross_loss * _across(thruster, va, moved, work))
        most = MOST_INFLOW * force
        force -= thruster.inflow * math.sqrt(abs(force)) * va
        force = min(max(force, min(most, 0.0)), max(most, 0.0)) - thruster.drag * abs(va) * va
    if near_surface:
        r = thruster.r
        hub = depth - work[UP, 0] * r[0] - work[UP, 1] * r[1] - work[UP, 2] * r[2]
        if thruster.ventilates != 0:
            force *= ventilated(hub / thruster.disc_radius)
        else:
            force *= disc_fraction(hub, thruster.disc_radius)
    return force
