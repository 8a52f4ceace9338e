"""Typed parameters of bodies and thrusters, with the lags of thrusters, and their rows in the kernel's arrays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.dynamics.appendage_params import Appendages, appendage_rates
from uwserver.physics.dynamics.strip_params import HullLine, hull_line
from uwserver.physics.kernel.arrays import FloatArray, Records
from uwserver.physics.kernel.layout import (
    BODY,
    LAG,
    LAG_LEVELS,
    NEAR_NOTHING,
    SHAPE,
    TABLE,
    TABLE_SIZE,
    TABLE_VOLTAGES,
    THRUSTER,
    WRENCH,
)


@dataclass(frozen=True)
class Lag:
    """Linear lag of an actuator with the transfer function (b2 s2 + b1 s + b0) / (s3 + a2 s2 + a1 s + a0), or a first-order or no lag.

    Attributes:
        numerator: (b0, b1, b2).
        denominator: (a0, a1, a2) of the monic cubic; () for no lag; (1/tau,) for a first-order lag of time constant tau (s).
    """

    numerator: tuple[float, ...] = ()
    denominator: tuple[float, ...] = ()

    @classmethod
    def first_order(cls, tau: float) -> Lag:
        """Return the lag 1 / (tau s + 1); tau in s."""
        return cls((), (1.0 / tau,)) if tau > 0.0 else cls()

    def transition(self, dt: float) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Return the exact transition over half a sub-step, for each number of sub-steps 2**level of a tick of dt seconds.

        Returns:
            F (levels, 3, 3), G (levels, 3), C (3), D: x+ = F x + G u, y = C x + D u.
        """
        A, B, C, D = self._controllable_form()
        F, G = np.zeros((LAG_LEVELS, 3, 3)), np.zeros((LAG_LEVELS, 3))
        for level in range(LAG_LEVELS):
            h = 0.5 * dt / 2**level
            block = np.zeros((4, 4))
            block[:3, :3], block[:3, 3] = A * h, B * h
            exponential = expm(block)
            F[level], G[level] = exponential[:3, :3], exponential[:3, 3]
        return F, G, C, D

    def _controllable_form(self) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        A, B, C = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
        if not self.denominator:
            return A, B, C, 1.0
        if len(self.denominator) == 1:
            (rate,) = self.denominator
            A[0, 0], B[0], C[0] = -rate, rate, 1.0
            return A, B, C, 0.0
        a0, a1, a2 = self.denominator
        b0, b1, b2 = self.numerator
        # The states are scaled by a0, so that x[0] is the output of an all-pole lag. Comparable magnitudes make the exponential accurate.
        A[0, 1] = A[1, 2] = 1.0
        A[2] = -a0, -a1, -a2
        B[2] = a0
        C[:] = b0 / a0, b1 / a0, b2 / a0
        return A, B, C, 0.0


def expm(M: FloatArray) -> FloatArray:
    """Return a matrix exponential by scaling, a Taylor series of degree 18 and squaring, for the small matrices that are made at load.

    scipy has one, but importing scipy would take a third of the time that a start may take.
    """
    squarings = max(0, int(np.ceil(np.log2(max(1e-300, float(np.linalg.norm(M, 1)))))) + 1)
    scaled = M / 2.0**squarings
    result, term = np.eye(len(M)), np.eye(len(M))
    for k in range(1, 19):
        term = term @ scaled / k
        result = result + term
    for _ in range(squarings):
        result = result @ result
    return result


@dataclass(frozen=True)
class BuoyancyShape:
    """A box (`half` edges, m) or a sphere (radius in ``half[0]``) at `center` (B, m). `volume` (m3) is its weight relative to the other shapes."""

    kind: int
    center: Vec3
    half: Vec3
    volume: float


@dataclass(frozen=True)
class ForceTable:
    """Static force (N) of a thruster: for each supply voltage one curve of (u, force) points, both ascending; at most 8 curves of 48 points."""

    voltages: tuple[float, ...]
    curves: tuple[tuple[tuple[float, float], ...], ...]


@dataclass(frozen=True)
class ThrusterParams:
    """One thruster; frames and units as in `layout.THRUSTER`."""

    name: str
    r: Vec3
    axis: Vec3
    table: ForceTable
    voltage: float
    lag: Lag
    torque_per_force: float = 0.0
    inflow: float = 0.0
    drag: float = 0.0
    disc_radius: float = 0.05
    installed: float = 1.0
    cross_loss: float = 0.0
    ventilates: bool = False

    @property
    def reach(self) -> float:
        """Distance from the origin to the farthest place whose depth affects the thrust, m."""
        return float(np.linalg.norm(self.r)) + (1.3 if self.ventilates else 1.0) * self.disc_radius


@dataclass(frozen=True)
class NearBoundary:
    """The shape as which a hull is treated where surface or bottom change its added mass: `form` of `layout`, and the radius (m)."""

    form: int = NEAR_NOTHING
    radius: float = 0.0


@dataclass(frozen=True, eq=False)
class BodyParams:
    """One rigid body in water of the scenario's density. All is about its origin, in B.

    Attributes:
        M_RB, M_A: (6, 6) rigid-body inertia and added mass.
        D_L, D_Q, D_S: (6, 6) linear, quadratic and speed-proportional damping.
        weight, buoyancy: N, at the surface.
        r_g, r_b: centre of gravity and of buoyancy, m.
        shapes: geometry of the displaced volume; a body without shapes is always submerged.
        gravity_growth: relative growth of weight and buoyancy with depth, 1/m.
        displaced: mass of the displaced water, kg, which matters in unsteady water; default: buoyancy over 9.81 m/s2.
        appendages: fins, propellers, ballast, and terms of the hull's shape beside the matrices.
        length: length of the hull along x over which waves act, m; None: that of the shapes; 0: waves act at r_b alone.
        near: how surface and bottom change M_A.
    """

    M_RB: FloatArray
    M_A: FloatArray
    D_L: FloatArray
    D_Q: FloatArray
    D_S: FloatArray
    weight: float
    buoyancy: float
    r_g: Vec3
    r_b: Vec3
    shapes: tuple[BuoyancyShape, ...] = ()
    thrusters: tuple[ThrusterParams, ...] = field(default=())
    wrenches: int = 1
    displaced: float | None = None
    gravity_growth: float = 0.0
    appendages: Appendages = field(default=Appendages())
    length: float | None = None
    near: NearBoundary = field(default=NearBoundary())


def rigid_body_inertia(mass: float, inertia_com: FloatArray, r_g: Vec3) -> FloatArray:
    """Return M_RB (6, 6) about the origin from mass (kg), inertia about the centre of mass (3, 3, kg m2) and r_g (m). Fossen 2011, eq. 3.44."""
    x, y, z = r_g
    S = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    M = np.zeros((6, 6))
    M[:3, :3] = mass * np.eye(3)
    M[:3, 3:] = -mass * S
    M[3:, :3] = mass * S
    M[3:, 3:] = inertia_com - mass * S @ S
    return M


def damping_rates(body: BodyParams) -> tuple[float, FloatArray, float]:
    """Return bounds of the fastest damping rate: rate_L (1/s), rate_Q (6) and rate_S, for `layout.BODY`.

    Spectral norms in the metric of M, so that metres and radians may be mixed: ||M^-1/2 D M^-1/2||; the quadratic term contributes its
    slope, 2 D_Q |nu_j|, column by column, the speed-proportional one at most 2 |u| D_S.
    """
    values, vectors = np.linalg.eigh(body.M_RB + body.M_A)
    root = vectors @ np.diag(values**-0.5) @ vectors.T

    def norm(D: FloatArray) -> float:
        return float(np.linalg.norm(root @ D @ root, 2))

    def column(D: FloatArray, j: int) -> float:
        return float(np.linalg.norm(root @ D[:, j]) * np.linalg.norm(root[j]))

    rate_L, rate_Q, rate_S = appendage_rates(body.appendages, root)
    for thruster in body.thrusters:
        line = _line(thruster)
        rate_Q += 2.0 * thruster.drag * float(np.linalg.norm(root @ line)) ** 2 * np.abs(line)
    quadratic = np.array([2.0 * column(body.D_Q, j) for j in range(6)])
    return rate_L + norm(body.D_L), rate_Q + quadratic, rate_S + 2.0 * norm(body.D_S)


def _form(M: FloatArray) -> int:
    """Return 0 for a zero matrix, 1 for a diagonal one, 2 for any other."""
    if not M.any():
        return 0
    return 2 if (M - np.diag(np.diag(M))).any() else 1


def body_row(body: BodyParams) -> Records:
    """Return the BODY row (1) of a body, without its ranges."""
    row = np.zeros(1, BODY)
    for name in ("M_RB", "M_A", "D_L", "D_Q", "D_S", "weight", "buoyancy", "gravity_growth", "r_g", "r_b"):
        row[name] = getattr(body, name)
    row["displaced"] = body.buoyancy / 9.81 if body.displaced is None else body.displaced
    row["M_inv"] = np.linalg.inv(body.M_RB + body.M_A)
    for name in ("M_RB", "M_A", "D_L", "D_Q", "D_S"):
        row[f"form_{name}"] = _form(getattr(body, name))
    row["rate_L"], row["rate_Q"], row["rate_S"] = damping_rates(body)
    # The shapes at their final places, moved to r_b.
    reach = [
        float(
            np.linalg.norm(shape["center"])
            + (shape["half"][0] if shape["kind"] == 1 else np.linalg.norm(shape["half"]))
        )
        for shape in shape_rows(body)
    ]
    reach += [thruster.reach for thruster in body.thrusters] + [body.appendages.reach]
    row["fitted"] = int(body.appendages != Appendages())
    row["radius"] = max(reach, default=0.0)
    line = line_of(body)
    row["strip_axis"], row["strip_half"] = line.axis, line.half
    row["strip_turn"], row["strip_moment"] = line.turn, line.moment
    row["near_form"], row["near_radius"], row["floor"] = body.near.form, body.near.radius, np.inf
    return row


def line_of(body: BodyParams) -> HullLine:
    """Return the line along which a body has strips in waves."""
    return hull_line(shape_rows(body), body.r_b, body.length)


def shape_rows(body: BodyParams) -> Records:
    """Return the SHAPE rows, moved together so that their common centre is r_b, with shares that add up to 1."""
    rows = np.zeros(len(body.shapes), SHAPE)
    total = sum(shape.volume for shape in body.shapes)
    if not body.shapes:
        return rows
    centre = sum(np.array(shape.center) * shape.volume for shape in body.shapes) / total
    for row, shape in zip(rows, body.shapes, strict=True):
        row["kind"] = shape.kind
        row["center"] = np.array(shape.center) - centre + np.array(body.r_b)
        row["half"] = shape.half
        row["share"] = shape.volume / total
    return rows


def _line(params: ThrusterParams) -> FloatArray:
    """Return (6) axis and moment of a unit force of a thruster, about the origin in B."""
    axis = np.array(params.axis) / np.linalg.norm(params.axis)
    return np.concatenate([axis, np.cross(params.r, axis)])


def thruster_row(params: ThrusterParams, table: int, lag: int) -> Records:
    """Return the THRUSTER row (1), at rest, with the rows of its force table and lag."""
    row = np.zeros(1, THRUSTER)
    for name in ("r", "voltage", "inflow", "drag", "disc_radius", "installed", "cross_loss", "ventilates"):
        row[name] = getattr(params, name)
    row["per_velocity"] = row["per_force"] = _line(params)
    row["per_force"][0, 3:] += params.torque_per_force * row["per_force"][0, :3]
    row["table"], row["lag"] = table, lag
    row["efficiency"] = 1.0
    return row


def lag_row(lag: Lag, dt: float) -> Records:
    """Return the LAG row (1) of a lag for a tick of dt seconds."""
    row = np.zeros(1, LAG)
    row["F"], row["G"], row["C"], row["D"] = lag.transition(dt)
    return row


def table_row(table: ForceTable) -> Records:
    """Return the TABLE row (1) of a force table. Curves with fewer points are padded with their last point."""
    if not 1 <= len(table.voltages) <= TABLE_VOLTAGES or any(not 1 < len(c) <= TABLE_SIZE for c in table.curves):
        raise ValueError(f"a force table takes 1..{TABLE_VOLTAGES} voltages and 2..{TABLE_SIZE} points each")
    row = np.zeros(1, TABLE)
    row["n_voltages"] = len(table.voltages)
    for k, (voltage, curve) in enumerate(zip(table.voltages, table.curves, strict=True)):
        points = np.array(curve + (curve[-1],) * (TABLE_SIZE - len(curve)))
        row["voltage"][0, k] = voltage
        row["u"][0, k], row["force"][0, k] = points[:, 0], points[:, 1]
    return row


def wrench_rows(count: int) -> Records:
    """Return `count` WRENCH rows of zero force in B."""
    return np.zeros(count, WRENCH)
