"""Tables of the vehicle file for fins, propellers, ballasts and moving masses, and for hull forces beyond the matrices."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType, field

from uwserver.table import Name, NonNegative, Positive, Table, Vector3

Four = tuple[float, float, float, float]
Six = tuple[float, float, float, float, float, float]
Status = Literal["measured", "paper", "datasheet", "derived", "guess"]
Fraction = Annotated[float, Meta(ge=0, lt=1)]


class Sourced(Table, kw_only=True, frozen=True):
    """Base of tables of numbers. `source` says where they come from, `status` how far to trust them."""

    source: Name
    status: Status


class Foil(Sourced, kw_only=True, frozen=True):
    """A fixed lifting surface, or a hull modelled as one: linear lift up to the stall, a flat plate beyond it.

    Attributes:
        position_frd_m: centre of pressure.
        hinge_frd: direction of the span; lift points along hinge x chord.
        chord_frd: towards the leading edge.
        area_m2: planform area; 0 for a fin that is described by its `derivatives` only.
        lift_slope_prad: dC_L/dalpha; default from the aspect ratio A: pi A / (1 + sqrt(1 + A^2 / 4)).
        aspect_ratio: span^2 / area. It gives the induced drag C_L^2 / (pi e A), which is zero without it.
        oswald: e of the induced drag.
        drag: C_D at zero lift.
        plate_drag: normal force coefficient of the stalled foil at right angles to the flow.
        stall_deg, stall_width_deg: angle of attack up to which the flow is attached, and range of angles over which it separates.
        inflow: speed that the dynamic pressure is taken from: that in the plane across the span, or the whole speed.
        span_m: used for the loss of force near the surface; default: from area and aspect ratio.
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
        rate_degps: largest rate of the angle; default: no limit.
        time_constant_s: time constant of its first-order lag.
        derivatives: published coefficients of further forces, in SI, in addition to the foil or instead of it. A name is an axis, two velocities,
            and d or dd for the angle, such as ``Yuud = 9.5`` for Y = 9.5 u u delta; at `reference_density_kgpm3`.
    """

    limit_deg: Positive
    rate_degps: NonNegative | UnsetType = UNSET
    time_constant_s: NonNegative = 0.0
    derivatives: dict[str, float] = field(default_factory=dict)
    reference_density_kgpm3: Positive = 1025.0


class ShaftPropeller(Sourced, kw_only=True, frozen=True):
    """A propeller on a shaft whose speed is commanded.

    Without `curve` it is a Wageningen B4-70 in all four quadrants: ahead and astern, with and against the inflow, windmilling, and stopped, when
    it has drag. With `curve` it is the first quadrant of its source, linear between and beyond the points. Outside that quadrant this is an
    extrapolation: astern the propeller is its own mirror image, against the inflow the first segment is continued, and a stopped propeller has
    no drag.

    Attributes:
        axis_frd: direction of the thrust at a positive speed.
        pitch_ratio: P/D of the B4-70, linear between the measured ones; default: 1.0. K_T at rest is 0.19 at 0.5, 0.45 at 1.0, 0.59 at 1.4.
        quadrants: another propeller in four quadrants, instead of the B4-70: its Fourier series over the advance angle, with rows A_T, B_T, A_Q,
            B_Q for k = 0, 1, .. of C_T* = sum A_T cos(k beta) + B_T sin(k beta), and the same for C_Q*.
        damping_includes_stopped: whether the damping of the vehicle was found with the stopped propeller on it, as in a towing test; its drag is
            then not counted again.
        curve: points [J, K_T, K_Q], J rising; two points make the usual linear form.
        astern_factor: ratio of thrust and torque astern to those ahead, with `curve`.
        wake_fraction: w in the speed of advance (1 - w) u.
        thrust_deduction: t in the thrust on the vehicle (1 - t) T.
        handedness: right (clockwise seen along the axis) turns the vehicle to the left; none: no reaction torque.
        inflow: speed of the inflow: that along the axis, or, with `curve`, the whole speed in whatever direction.
        max_speed_radps: largest shaft speed, ahead and astern.
        rate_radps2: largest rate of the shaft speed; default: no limit.
        time_constant_s: time constant of its first-order lag.
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
    """A volume that a pump changes. Mass and inertia of the body stay constant. That is exact for a bladder that is filled with oil of the vehicle;
    for a tank it neglects the water taken in.

    Attributes:
        form: bladder (its volume displaces water, so more volume lifts) or tank (its volume is sea water taken in, so more volume sinks).
        neutral_volume_m3: volume that is included in mass_kg and volume_m3 of the vehicle; the watchdog returns to it.
        rate_m3ps: rate of the pump.
    """

    position_frd_m: Vector3
    form: Literal["bladder", "tank"]
    min_volume_m3: NonNegative = 0.0
    max_volume_m3: Positive
    neutral_volume_m3: NonNegative = 0.0
    rate_m3ps: Positive
    time_constant_s: NonNegative = 0.0


class MovingMass(Sourced, kw_only=True, frozen=True):
    """A part of the vehicle's mass that slides along an axis. It moves the centre of gravity (the moment of its weight is exact). M_RB remains that
    of position 0. The error is mass times distance: a few per cent of the coupling terms of M_A for a battery that moves centimetres.

    Attributes:
        mass_kg: included in mass_kg of the vehicle.
        axis_frd: direction of a positive position.
        min_position_m, max_position_m: limits of the position; position 0 is the one that center_of_mass_frd_m of the vehicle assumes.
    """

    mass_kg: Positive
    axis_frd: Vector3 = (1.0, 0.0, 0.0)
    min_position_m: float
    max_position_m: float
    rate_mps: Positive
    time_constant_s: NonNegative = 0.0


class CrossFlow(Sourced, kw_only=True, frozen=True):
    """Cross-flow drag by strips along x. Each strip has its own sway v + x r and heave w - x q.

    Attributes:
        length_m, center_m: total length of the strips, and x of their middle.
        height_m, width_m: those of a strip, as seen by sway and by heave.
        sway_drag, heave_drag: two-dimensional drag coefficients.
        joint: drag from the resultant of both cross flows (Healey and Lienard 1993) instead of from each alone.
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
    """Linear damping (surge, sway, heave, roll, pitch, yaw) that acts at rest and fades as exp(-speed through the water / `fading_mps`)."""

    diagonal: tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative, NonNegative]
    fading_mps: Positive


class HullDerivatives(Sourced, kw_only=True, frozen=True):
    """Published hydrodynamic derivatives of the hull in SI, with the signs of the equation of forces. A name is an axis and two velocities through
    the water, such as ``Yur = 5.0`` for Y = 5.0 u r. They are added to the Coriolis terms of M_A, which always act: give only what the source has
    beyond those."""

    terms: dict[str, float]
    reference_density_kgpm3: Positive = 1025.0


class Hull(Table, kw_only=True, frozen=True):
    """Forces on the hull beyond the matrices of `damping`. Dimensionless coefficients act with the density of the scenario."""

    cross_flow: CrossFlow | UnsetType = UNSET
    slow_damping: SlowDamping | UnsetType = UNSET
    derivatives: HullDerivatives | UnsetType = UNSET
