"""Tables of the vehicle file for what is fitted to a hull, and for the hull's shape beyond its matrices."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType, field

from uwserver.table import Name, NonNegative, Positive, Table, Vector3

Four = tuple[float, float, float, float]
Six = tuple[float, float, float, float, float, float]
Status = Literal["measured", "paper", "datasheet", "derived", "guess"]
Fraction = Annotated[float, Meta(ge=0, lt=1)]


class Sourced(Table, kw_only=True, frozen=True):
    """A table of numbers: where they come from, and how far to trust them."""

    source: Name
    status: Status


class Foil(Sourced, kw_only=True, frozen=True):
    """A fixed lifting surface, also a hull taken as one: linear lift up to the stall, a flat plate beyond.

    Attributes:
        position_frd_m: centre of pressure.
        hinge_frd: along the span; lift points along hinge x chord.
        chord_frd: towards the leading edge.
        area_m2: plan form; 0 for a fin that is described by its `derivatives` alone.
        lift_slope_prad: dC_L/dalpha; default from the aspect ratio A: pi A / (1 + sqrt(1 + A^2 / 4)).
        aspect_ratio: span^2 / area; gives the induced drag C_L^2 / (pi e A), which is left out without it.
        oswald: e of the induced drag.
        drag: C_D without lift.
        plate_drag: normal force coefficient of the stalled foil across the flow.
        stall_deg, stall_width_deg: angle of attack up to which the flow is attached, and over which it lets go.
        inflow: dynamic pressure of the flow across the span, or of the whole speed.
        span_m: for the loss of force near the surface; default from area and aspect ratio.
    """

    position_frd_m: Vector3
    hinge_frd: Vector3
    chord_frd: Vector3 = (1.0, 0.0, 0.0)
    area_m2: NonNegative = 0.0
    lift_slope_prad: NonNegative | UnsetType = UNSET
    aspect_ratio: Positive | UnsetType = UNSET
    oswald: Positive = 0.7
    drag: NonNegative = 0.0
    plate_drag: NonNegative = 1.2
    stall_deg: Annotated[float, Meta(gt=0, lt=179)] = 15.0
    stall_width_deg: Positive = 10.0
    inflow: Literal["plane", "speed"] = "plane"
    span_m: Positive | UnsetType = UNSET


class Fin(Foil, kw_only=True, frozen=True):
    """A foil that turns about its hinge by the right-hand rule: a positive angle lifts it towards hinge x chord.

    Attributes:
        limit_deg: largest angle to either side.
        rate_degps: largest speed of the hinge; default: no limit.
        time_constant_s: of its first-order lag.
        derivatives: forces as published coefficients, in SI, beside or instead of the foil's: axis, two velocities, and d or dd for the angle,
            such as ``Yuud = 9.5`` for Y = 9.5 u u delta; at `reference_density_kgpm3`.
    """

    limit_deg: Positive
    rate_degps: NonNegative | UnsetType = UNSET
    time_constant_s: NonNegative = 0.0
    derivatives: dict[str, float] = field(default_factory=dict)
    reference_density_kgpm3: Positive = 1025.0


class ShaftPropeller(Sourced, kw_only=True, frozen=True):
    """A propeller on a shaft whose speed is commanded.

    Without `curve` it is one of the Wageningen B4-70, in all four quadrants: ahead and astern, with and against the inflow, windmilling, and
    stopped, when it drags. With `curve` it is what its source gives of the first quadrant, straight between and beyond the points. Beyond that
    quadrant this is an extrapolation: astern the propeller is the mirror of itself, against the inflow the first piece goes on, and a stopped
    one has no drag.

    Attributes:
        axis_frd: direction of the thrust at a positive speed.
        pitch_ratio: P/D of the B4-70, linear between those measured; 1.0 unless given. It decides K_T at rest: 0.19 at 0.5, 0.45 at 1.0, 0.59 at 1.4.
        quadrants: another propeller in four quadrants, in place of the B4-70: its Fourier series over the advance angle, rows A_T, B_T, A_Q,
            B_Q for k = 0, 1, .. of C_T* = sum A_T cos(k beta) + B_T sin(k beta), likewise C_Q*.
        damping_includes_stopped: whether the vehicle's damping was found with the propeller on and stopped, as by towing; its drag is then not
            counted again.
        curve: points [J, K_T, K_Q], J rising; two make the usual linear form.
        astern_factor: thrust and torque astern over those ahead, with `curve`.
        wake_fraction: w of the speed of advance (1 - w) u.
        thrust_deduction: t of the thrust on the vehicle, (1 - t) T.
        handedness: right (clockwise seen along the axis) turns the vehicle to the left; none: no reaction torque.
        inflow: advances with the speed along the axis, or, with `curve`, with the whole speed, whatever its direction.
        max_speed_radps: largest shaft speed, ahead and astern.
        rate_radps2: largest change of the shaft speed; default: no limit.
        time_constant_s: of its first-order lag.
    """

    position_frd_m: Vector3
    axis_frd: Vector3 = (1.0, 0.0, 0.0)
    diameter_m: Positive
    pitch_ratio: Annotated[float, Meta(ge=0.5, le=1.4)] | UnsetType = UNSET
    quadrants: Annotated[tuple[Four, ...], Meta(min_length=1, max_length=31)] | UnsetType = UNSET
    damping_includes_stopped: bool = False
    curve: Annotated[tuple[Vector3, ...], Meta(min_length=2, max_length=24)] | UnsetType = UNSET
    astern_factor: NonNegative = 1.0
    wake_fraction: Fraction = 0.0
    thrust_deduction: Fraction = 0.0
    handedness: Literal["right", "left", "none"] = "none"
    inflow: Literal["axial", "speed"] = "axial"
    max_speed_radps: Positive
    rate_radps2: NonNegative | UnsetType = UNSET
    time_constant_s: NonNegative = 0.0


class Ballast(Sourced, kw_only=True, frozen=True):
    """A volume that a pump changes. Mass and inertia of the body stay as they are: exact for a bladder filled with the vehicle's own oil; for a
    tank an approximation by the water that it takes.

    Attributes:
        form: bladder (its volume displaces water: more of it lifts) or tank (its volume is sea water taken in: more of it sinks).
        neutral_volume_m3: volume that mass_kg and volume_m3 of the vehicle count already; the watchdog goes back to it.
        rate_m3ps: of the pump.
    """

    position_frd_m: Vector3
    form: Literal["bladder", "tank"]
    min_volume_m3: NonNegative = 0.0
    max_volume_m3: Positive
    neutral_volume_m3: NonNegative = 0.0
    rate_m3ps: Positive
    time_constant_s: NonNegative = 0.0


class MovingMass(Sourced, kw_only=True, frozen=True):
    """A part of the vehicle's mass that slides along an axis. It moves the centre of gravity (the moment of its weight is exact); M_RB stays that
    of position 0, an approximation by mass times way, a few per cent of the coupling terms of M_A for a battery that moves centimetres.

    Attributes:
        mass_kg: counted in the vehicle's mass already.
        axis_frd: of a positive position.
        min_position_m, max_position_m: 0 is where the vehicle's centre_of_mass counts it.
    """

    mass_kg: Positive
    axis_frd: Vector3 = (1.0, 0.0, 0.0)
    min_position_m: float
    max_position_m: float
    rate_mps: Positive
    time_constant_s: NonNegative = 0.0


class CrossFlow(Sourced, kw_only=True, frozen=True):
    """Cross-flow drag by strips along x: each has its own sway v + x r and heave w - x q.

    Attributes:
        length_m, center_m: of the strips together, and x of their middle.
        height_m, width_m: that the sway and the heave meet.
        sway_drag, heave_drag: two-dimensional drag coefficients.
        joint: drag by the resultant of both cross flows (Healey and Lienard 1993) instead of by each alone.
    """

    length_m: Positive
    center_m: float = 0.0
    strips: Annotated[int, Meta(ge=1, le=100)] = 20
    height_m: Positive
    width_m: Positive
    sway_drag: NonNegative
    heave_drag: NonNegative = 0.0
    joint: bool = False


class SlowDamping(Sourced, kw_only=True, frozen=True):
    """Linear damping (surge, sway, heave, roll, pitch, yaw) that holds at rest and fades as exp(-speed through the water / `fading_mps`)."""

    diagonal: tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative, NonNegative]
    fading_mps: Positive


class HullDerivatives(Sourced, kw_only=True, frozen=True):
    """Published hydrodynamic derivatives of the hull in SI, signs as in the equation of forces: axis and two velocities through the water, such as
    ``Yur = 5.0`` for Y = 5.0 u r. They come on top of M_A, whose Coriolis terms are always there: give what the source has beyond them."""

    terms: dict[str, float]
    reference_density_kgpm3: Positive = 1025.0


class Hull(Table, kw_only=True, frozen=True):
    """Shape of the hull beyond the matrices of `damping`, at the scenario's density where coefficients have no dimension."""

    cross_flow: CrossFlow | UnsetType = UNSET
    slow_damping: SlowDamping | UnsetType = UNSET
    derivatives: HullDerivatives | UnsetType = UNSET
