"""Typed parameters of the parts that are fitted to a hull, and of the shape of the hull itself, and their rows in the kernel's arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import FloatArray, Records
from uwserver.physics.kernel.layout import DERIVATIVE, FOIL, HARMONICS, HULL, PROPELLER, PROPELLER_SIZE, SERVO, WEIGHT

Six = tuple[float, float, float, float, float, float]
Series = tuple[tuple[float, float, float, float], ...]
"""For each multiple k = 0, 1, ... of the advance angle the coefficients of cosine and sine, of C_T*, then of C_Q*."""


@dataclass(frozen=True)
class ServoParams:
    """Parameters of a servo, which moves a part: limits, largest rate (a second) and time constant (s). It starts at `neutral`. The units are
    those of the part."""

    name: str
    low: float
    high: float
    rate: float = math.inf
    tau: float = 0.0
    neutral: float = 0.0


@dataclass(frozen=True)
class FoilParams:
    """A lifting surface; see `layout.FOIL`.

    Attributes:
        servo: name of the servo that turns the foil; "" if it is fixed.
        r: centre of pressure, B, m.
        hinge: axis of positive rotation (right hand), B.
        chord: towards the leading edge at zero angle, B; made square to the hinge.
        pressure_area: rho A / 2, kg/m.
        slope, induced, cd0, cd90: coefficients.
        stall, stall_end: rad.
        whole: the dynamic pressure is that of the whole speed, including the part along the span.
        radius: half the span, m.
    """

    servo: str
    r: Vec3
    hinge: Vec3
    chord: Vec3
    pressure_area: float
    slope: float
    induced: float
    cd0: float
    cd90: float
    stall: float
    stall_end: float
    whole: bool = False
    radius: float = 0.05


@dataclass(frozen=True)
class PropellerParams:
    """A propeller, described by its `series` in four quadrants or by its open-water `curve` of (J, K_T, K_Q); all else as in `layout.PROPELLER`.

    Attributes:
        damping_includes_stopped: the hull's damping contains the drag of the stopped propeller, so that drag is subtracted from the series.
    """

    servo: str
    r: Vec3
    axis: Vec3
    diameter: float
    density: float
    curve: tuple[Vec3, ...] = ()
    wake: float = 1.0
    deduction: float = 1.0
    astern: float = 1.0
    sense: float = 0.0
    whole: bool = False
    series: Series = ()
    damping_includes_stopped: bool = False

    @property
    def line(self) -> Vec3:
        """K_T at rest; its fall with J, on a straight line to the end of the first quadrant; and thrust astern over thrust ahead, both at rest."""
        if not self.series:
            (j0, k0, _), (j1, k1, _) = self.curve[0], self.curve[-1]
            fall = (k0 - k1) / (j1 - j0) if j1 > j0 else 0.0
            return k0 + fall * j0, fall, self.astern
        beta = np.linspace(0.0, 0.5 * math.pi, 181)
        thrust, _ = quadrant_coefficients(self.series, np.append(beta, math.pi))
        rest = math.pi / 8.0 * (0.7 * math.pi) ** 2 * thrust[0]
        last = 0.7 * math.pi * math.tan(beta[np.argmax(thrust[:-1] < 0.0)])
        return rest, rest / last, -thrust[-1] / thrust[0]


@dataclass(frozen=True)
class WeightParams:
    """A force along z_N and a moment, both proportional to the value of a servo; see `layout.WEIGHT`."""

    servo: str
    force: float
    moment: Vec3
    displaces: bool = False


@dataclass(frozen=True)
class DerivativeParams:
    """One term of a hull's polynomial: tau[axis] += coefficient nu_r[j] nu_r[k], times a power (1 or 2) of the value of `servo` if that is given."""

    axis: int
    j: int
    k: int
    coefficient: float
    servo: str = ""
    power: int = 0


@dataclass(frozen=True)
class HullParams:
    """Linear damping that fades as exp(-fade U_r), and cross-flow drag in strips.

    Attributes:
        slow: (6) diagonal damping at rest.
        fade: s/m.
        length, center: total length of the strips, and x of their middle, m.
        strips: number of strips.
        sway, heave: rho C_d d / 2 per metre, kg/m2.
        joint: the drag depends on the resultant of both cross flows.
    """

    slow: Six = (0.0,) * 6
    fade: float = 0.0
    length: float = 0.0
    center: float = 0.0
    strips: int = 0
    sway: float = 0.0
    heave: float = 0.0
    joint: bool = False

    @property
    def spacing(self) -> float:
        """Length of a strip, m."""
        return self.length / self.strips if self.strips else 0.0

    @property
    def first(self) -> float:
        """x of the aftmost strip's middle, m."""
        return self.center - 0.5 * self.length + 0.5 * self.spacing


@dataclass(frozen=True)
class Appendages:
    """All appendages of one body."""

    servos: tuple[ServoParams, ...] = ()
    foils: tuple[FoilParams, ...] = ()
    propellers: tuple[PropellerParams, ...] = ()
    weights: tuple[WeightParams, ...] = ()
    derivatives: tuple[DerivativeParams, ...] = ()
    hulls: tuple[HullParams, ...] = ()

    @property
    def reach(self) -> float:
        """Distance of the farthest part from the origin, m."""
        reach = [float(np.linalg.norm(foil.r)) + foil.radius for foil in self.foils]
        reach += [float(np.linalg.norm(propeller.r)) + 0.5 * propeller.diameter for propeller in self.propellers]
        return max(reach, default=0.0)


def servo_rows(appendages: Appendages) -> Records:
    """Return the SERVO rows, at rest at their neutral values."""
    rows = np.zeros(len(appendages.servos), SERVO)
    for row, servo in zip(rows, appendages.servos, strict=True):
        for name in ("low", "high", "rate", "tau"):
            row[name] = getattr(servo, name)
        row["command"] = row["value"] = servo.neutral
        row["efficiency"] = 1.0
    return rows


def appendage_rows(appendages: Appendages, first_servo: int) -> dict[str, Records]:
    """Return the rows of all kinds except servos, by the names of `layout.Fitted`. `first_servo` is the row of the body's first servo."""
    servos = {servo.name: first_servo + k for k, servo in enumerate(appendages.servos)}
    neutral = {servo.name: servo.neutral for servo in appendages.servos}
    return {
        "foils": _foil_rows(appendages.foils, servos),
        "propellers": _propeller_rows(appendages.propellers, servos),
        "weights": _rows(
            WEIGHT,
            [(servos[w.servo], neutral[w.servo], w.force, w.moment, int(w.displaces)) for w in appendages.weights],
        ),
        "derivatives": _rows(
            DERIVATIVE,
            [(d.axis, d.j, d.k, servos.get(d.servo, -1), d.power, d.coefficient) for d in appendages.derivatives],
        ),
        "hulls": _rows(
            HULL,
            [
                (h.slow, h.fade, h.strips, h.first, h.spacing, h.sway * h.spacing, h.heave * h.spacing, int(h.joint))
                for h in appendages.hulls
            ],
        ),
    }


def _rows(dtype: np.dtype[np.void], values: list[tuple[object, ...]]) -> Records:
    return np.array(values, dtype)


def _foil_rows(foils: tuple[FoilParams, ...], servos: Mapping[str, int]) -> Records:
    rows = np.zeros(len(foils), FOIL)
    for row, foil in zip(rows, foils, strict=True):
        for name in (
            "r", "pressure_area", "slope", "induced", "cd0", "cd90", "stall", "stall_end", "whole", "radius",
        ):  # fmt: skip
            row[name] = getattr(foil, name)
        hinge = np.array(foil.hinge) / np.linalg.norm(foil.hinge)
        chord = np.array(foil.chord) - np.dot(foil.chord, hinge) * hinge
        row["chord"] = chord / np.linalg.norm(chord)
        row["normal"] = np.cross(hinge, row["chord"])
        row["servo"] = servos[foil.servo] if foil.servo else -1
    return rows


def _propeller_rows(propellers: tuple[PropellerParams, ...], servos: Mapping[str, int]) -> Records:
    rows = np.zeros(len(propellers), PROPELLER)
    for row, propeller in zip(rows, propellers, strict=True):
        if propeller.series:
            _check_length("terms of its series", len(propeller.series), 1, HARMONICS)
        else:
            _check_length("points of its curves", len(propeller.curve), 2, PROPELLER_SIZE)
        for name in ("r", "diameter", "density", "wake", "deduction", "astern", "sense", "whole"):
            row[name] = getattr(propeller, name)
        if propeller.series:
            row["harmonics"] = len(propeller.series)
            row["series"][: len(propeller.series)] = propeller.series
            if propeller.damping_includes_stopped:
                row["stopped"] = np.ravel(quadrant_coefficients(propeller.series, np.array([0.5, -0.5]) * math.pi).T)
        else:
            row["points"] = len(propeller.curve)
            for name, values in zip(("J", "KT", "KQ"), zip(*propeller.curve, strict=True), strict=True):
                row[name][: len(values)] = values
        row["axis"] = np.array(propeller.axis) / np.linalg.norm(propeller.axis)
        row["servo"] = servos[propeller.servo]
    return rows


def _check_length(noun: str, length: int, least: int, most: int) -> None:
    if not least <= length <= most:
        raise ValueError(f"a propeller takes {least}..{most} {noun}, not {length}")


def quadrant_coefficients(series: Series, beta: FloatArray) -> FloatArray:
    """Return C_T* and C_Q* (2, n) of a series at advance angles (n), rad; in plain numpy, for checks and bounds."""
    multiples = np.outer(np.arange(len(series)), beta)
    A_T, B_T, A_Q, B_Q = np.array(series).T
    cos, sin = np.cos(multiples), np.sin(multiples)
    return np.stack([A_T @ cos + B_T @ sin, A_Q @ cos + B_Q @ sin])


def appendage_rates(appendages: Appendages, root: FloatArray) -> tuple[float, FloatArray, float]:
    """Return the bounds of the damping rate that appendages add, as `params.damping_rates` does.

    Args:
        appendages: appendages of the body.
        root: (6, 6) inverse square root of M.
    """
    rate_L, rate_Q, rate_S = 0.0, np.zeros(6), 0.0
    size = np.linalg.norm(root, axis=0)
    high = {servo.name: max(abs(servo.low), abs(servo.high)) for servo in appendages.servos}

    def at(r: Vec3) -> float:
        x, y, z = r
        J = np.hstack([np.eye(3), np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])]) @ root
        return float(np.linalg.norm(J @ J.T, 2))

    for foil in appendages.foils:
        steepest = max(foil.slope, foil.cd90) + foil.cd0 + foil.cd90
        rate = 2.0 * foil.pressure_area * steepest * at(foil.r)
        rate_S += rate
        rate_Q += rate * np.array([0.0, 1.0, 1.0, *[float(np.linalg.norm(foil.r))] * 3])
    for propeller in appendages.propellers:
        slow, fast = _propeller_slopes(propeller, high[propeller.servo])
        rate_L += slow * at(propeller.r)
        rate_Q += fast * at(propeller.r) * np.array([1.0, 1.0, 1.0, *[float(np.linalg.norm(propeller.r))] * 3])
    for term in appendages.derivatives:
        factor = abs(term.coefficient) * (high[term.servo] ** term.power if term.servo else 1.0)
        rate_Q[term.j] += factor * size[term.axis] * size[term.k]
        rate_Q[term.k] += factor * size[term.axis] * size[term.j]
    for hull in appendages.hulls:
        rate_L += float(np.max(np.array(hull.slow) * size**2))
        for k in range(hull.strips):
            x = hull.first + k * hull.spacing
            rate = 2.0 * max(hull.sway, hull.heave) * hull.spacing * at((x, 0.0, 0.0))
            rate_Q += rate * np.array([0.0, 1.0, 1.0, 0.0, abs(x), abs(x)])
    return rate_L, rate_Q, rate_S


def _propeller_slopes(propeller: PropellerParams, speed: float) -> tuple[float, float]:
    """Return a and b of the bound a + b |V| for the thrust that a speed V along the axis takes away, N s/m, at shaft speeds up to `speed` (rad/s)."""
    if not propeller.series:
        J, KT, _ = np.array(propeller.curve).T
        slope = float(np.abs(np.diff(KT) / np.diff(J)).max())
        return propeller.density * propeller.diameter**3 * slope * speed / (2.0 * math.pi) * propeller.wake, 0.0
    beta = np.linspace(-math.pi, math.pi, 721)
    thrust, _ = quadrant_coefficients(propeller.series, beta)
    slope, largest = float(np.abs(np.diff(thrust)).max() / (beta[1] - beta[0])), float(np.abs(thrust).max())
    scale = 0.125 * math.pi * propeller.density * propeller.diameter**2 * propeller.wake
    # T = scale (V_a^2 + V_t^2) C_T*(beta), and dbeta/dV_a = V_t / (V_a^2 + V_t^2).
    return scale * slope * 0.35 * speed * propeller.diameter, 4.0 * scale * largest * propeller.wake
