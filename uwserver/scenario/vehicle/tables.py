"""The vehicle file: rigid body, hydrodynamics, thrusters, mounts, actuators and sensors. Each number has a source and a status.

The tables of fins, propellers, ballasts and the hull are in `appendage_tables`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType, field

from uwserver.actuators import ActuatorConfig
from uwserver.autopilot.config import Gains
from uwserver.scenario.solids.tables import Collision, Contact
from uwserver.scenario.vehicle.appendage_tables import (
    Ballast,
    Fin,
    Foil,
    Hull,
    MovingMass,
    ShaftPropeller,
    Six,
    Sourced,
)
from uwserver.sensors import SensorConfig
from uwserver.table import Name, NonNegative, Positive, Table, Vector3

Matrix3 = tuple[Vector3, Vector3, Vector3]
Matrix6 = tuple[Six, Six, Six, Six, Six, Six]


class RigidBody(Sourced, kw_only=True, frozen=True):
    """Mass properties, about axes of B.

    Attributes:
        center_of_mass_frd_m: r_g.
        inertia_kgm2: (Ixx, Iyy, Izz) about the point that `inertia_about` names. Give this or `inertia_matrix_kgm2`, whose off-diagonal elements
            are the negative products of inertia.
    """

    mass_kg: Positive
    center_of_mass_frd_m: Vector3 = (0.0, 0.0, 0.0)
    inertia_kgm2: Vector3 | UnsetType = UNSET
    inertia_matrix_kgm2: Matrix3 | UnsetType = UNSET
    inertia_about: Literal["center_of_mass", "origin"] = "center_of_mass"


class BoxShape(Table, tag="box", tag_field="kind", kw_only=True, frozen=True):
    """A box that displaces water, with its edges along the axes of B."""

    size_m: tuple[Positive, Positive, Positive]
    center_frd_m: Vector3 = (0.0, 0.0, 0.0)


class SphereShape(Table, tag="sphere", tag_field="kind", kw_only=True, frozen=True):
    """A sphere that displaces water."""

    radius_m: Positive
    center_frd_m: Vector3 = (0.0, 0.0, 0.0)


class Buoyancy(Sourced, kw_only=True, frozen=True):
    """Displaced volume and its centre r_b. `shapes` describe its form near the surface. They are shifted and scaled together so that, fully
    submerged, they displace `volume_m3` at `center_frd_m`. Without shapes the vehicle is always submerged.

    Attributes:
        length_m: length of the hull along x over which waves act, as on a hull of constant section; 0: they act at `center_frd_m` only.
            Default: from the second moment of the shapes along their longest axis (for a box: its edge); 0 without shapes.
    """

    volume_m3: Annotated[float, Meta(ge=0)]
    center_frd_m: Vector3 = (0.0, 0.0, 0.0)
    length_m: NonNegative | UnsetType = UNSET
    shapes: dict[str, BoxShape | SphereShape] = field(default_factory=dict)


class Coefficients(Sourced, kw_only=True, frozen=True):
    """A 6x6 matrix of positive magnitudes in SI, given in full or by its diagonal (surge, sway, heave, roll, pitch, yaw)."""

    diagonal: Six | UnsetType = UNSET
    matrix: Matrix6 | UnsetType = UNSET


class NearBoundary(Sourced, kw_only=True, frozen=True):
    """How added mass changes near the surface and above a flat seabed, by the method of images. It holds for a hull that is about level.

    Attributes:
        form: what the hull is approximated by: a cylinder along x, which changes all axes but surge and roll, or a sphere, which changes surge,
            sway and heave.
        radius_m: radius of that form; its depth and height are those of `center_frd_m` of the buoyancy.
    """

    form: Literal["cylinder", "sphere"]
    radius_m: Positive


class AddedMass(Coefficients, kw_only=True, frozen=True):
    """M_A at `reference_density_kgpm3`; `symmetrise` accepts a published asymmetric matrix and takes its symmetric part.

    Attributes:
        near_boundary: how added mass changes near the surface and the seabed; default: not at all.
    """

    reference_density_kgpm3: Positive = 1025.0
    symmetrise: bool = False
    near_boundary: NearBoundary | UnsetType = UNSET


class Damping(Table, kw_only=True, frozen=True):
    """D(nu_r) nu_r = (linear + at_rest) nu_r + quadratic (|nu_r| nu_r) + |u_r| speed nu_r, at `reference_density_kgpm3`.

    `at_rest` is added to `linear`; use it where a source leaves an axis undamped at rest.
    """

    reference_density_kgpm3: Positive = 1025.0
    linear: Coefficients | UnsetType = UNSET
    at_rest: Coefficients | UnsetType = UNSET
    quadratic: Coefficients | UnsetType = UNSET
    speed: Coefficients | UnsetType = UNSET


class Mount(Table, kw_only=True, frozen=True):
    """A named place on the vehicle that carries sensors.

    Attributes:
        tilt_deg: lowest and highest tilt of the cameras on it about its y axis, positive up; an actuator of kind ``camera_mount`` commands
            it. Other sensors on the mount do not tilt.
        tilt_rate_degps: speed of the tilt.
    """

    position_frd_m: Vector3 = (0.0, 0.0, 0.0)
    rpy_deg: Vector3 = (0.0, 0.0, 0.0)
    tilt_deg: tuple[Annotated[float, Meta(ge=-175, le=0)], Annotated[float, Meta(ge=0, le=175)]] | UnsetType = UNSET
    tilt_rate_degps: Positive = 60.0


class Lamp(Sourced, kw_only=True, frozen=True):
    """A lamp on a mount. It shines along the x axis of the mount.

    Attributes:
        mount: name of one of the vehicle's mounts.
        cone_deg: full angle of its light in water.
        lumens: luminous flux at full brightness.
    """

    mount: Name
    cone_deg: Annotated[float, Meta(gt=0, le=175)] = 135.0
    lumens: Positive


class Thruster(Sourced, kw_only=True, frozen=True):
    """Place of a thruster on the vehicle, and its device.

    Attributes:
        device: name of a shipped device file (``t200``), or path of a device file relative to the vehicle file.
        axis_frd: direction of the force at a positive command, of any length.
        handedness: sense of rotation, seen along `axis_frd` at a positive command: right (clockwise), left, or none (no reaction torque).
        voltage_V: supply voltage; default: that of the device.
        installed_factor: ratio of installed thrust to the open-water thrust of the device.
        inflow_factor: scales the loss of thrust with the inflow that the device file gives.
        damping_includes_stopped: whether the damping of the vehicle includes the drag of its stopped thrusters, as it does when it was found by
            towing or identification. If not, each thruster adds `stopped_drag` of its device.
        ventilates: whether ventilation reduces the thrust near the surface, by the factor 1 - 0.675 (1 - 0.769 h/R)^1.258 down to h = 1.3 R.
            The part of its disc that is out of the water always reduces it.
        cross_flow_loss_s2pm2: c in exp(-c V_t^2), the part of the thrust that is left in a stream V_t across the axis, which bends the jet
            towards the hull (tunnel thrusters).
    """

    device: Name
    position_frd_m: Vector3
    axis_frd: Vector3
    handedness: Literal["right", "left", "none"] = "none"
    voltage_V: Positive | UnsetType = UNSET
    installed_factor: Annotated[float, Meta(gt=0, le=1.5)] = 1.0
    inflow_factor: Annotated[float, Meta(ge=0)] = 1.0
    damping_includes_stopped: bool = True
    ventilates: bool = False
    cross_flow_loss_s2pm2: NonNegative = 0.0


class Autopilot(Sourced, kw_only=True, frozen=True):
    """Gains of the built-in autopilot for this vehicle, for scenarios that use it.

    Attributes:
        gains: those that differ from the defaults.
        max_wrench: largest surge, sway, heave (N), roll, pitch, yaw (N m) for a vehicle without thrusters.
    """

    gains: Gains = Gains()
    max_wrench: Six | UnsetType = UNSET


Quantity = Literal[
    "ahead_speed_mps", "astern_speed_mps", "sway_speed_mps", "descent_mps", "ascent_mps", "turning_diameter_m", "turn_rate_degps",
    "spot_turn_rate_degps", "roll_period_s", "pitch_period_s", "glide_speed_mps", "glide_angle_deg", "bollard_ahead_N", "bollard_down_N",
]  # fmt: skip
"""Published figures of a real vehicle; the name ends in the unit."""


class Published(Sourced, kw_only=True, frozen=True):
    """A published figure of the real vehicle, which `uwserver manoeuvres` compares with this file. The simulation does not use it.

    Attributes:
        throttle: part of full thrust at which the figure was found.
        rudder_deg: rudder angle of a turn; default: that of the manoeuvre.
    """

    quantity: Quantity
    value: NonNegative
    throttle: Annotated[float, Meta(gt=0, le=1)] = 1.0
    rudder_deg: Positive | UnsetType = UNSET


class VehicleFile(Table, kw_only=True, frozen=True):
    """A whole vehicle file.

    Attributes:
        looks: a .glb file, relative to this file, that viewers show instead of the shapes: y up, x forward, in m, with its origin at that of B.
        published: figures of the real vehicle, one ``[[published]]`` each.
    """

    schema: Literal[1]
    name: str
    description: str
    looks: Name | UnsetType = UNSET
    rigid_body: RigidBody
    buoyancy: Buoyancy
    added_mass: AddedMass
    damping: Damping
    mounts: dict[str, Mount] = field(default_factory=dict)
    lamps: dict[str, Lamp] = field(default_factory=dict)
    thrusters: dict[str, Thruster] = field(default_factory=dict)
    fins: dict[str, Fin] = field(default_factory=dict)
    foils: dict[str, Foil] = field(default_factory=dict)
    propellers: dict[str, ShaftPropeller] = field(default_factory=dict)
    ballasts: dict[str, Ballast] = field(default_factory=dict)
    moving_masses: dict[str, MovingMass] = field(default_factory=dict)
    hull: Hull = Hull()
    collision: dict[str, Collision] = field(default_factory=dict)
    contact: Contact = Contact()
    actuators: dict[str, ActuatorConfig] = field(default_factory=dict)
    sensors: dict[str, SensorConfig] = field(default_factory=dict)
    autopilot: Autopilot | UnsetType = UNSET
    published: tuple[Published, ...] = ()


class MeasuredCurve(Sourced, kw_only=True, frozen=True):
    """Measured static force at one supply voltage, linear between the points.

    Attributes:
        commands: rising from -1 to 1; include the edges of the dead band.
        forces_N: one for each command, not falling; 0 within the dead band.
    """

    voltage_V: Positive
    commands: tuple[float, ...]
    forces_N: tuple[float, ...]


class ForceCurve(Sourced, kw_only=True, frozen=True):
    """Static force at one supply voltage of which only limits and dead band are known. Between them the device's `shape` applies."""

    voltage_V: Positive
    max_forward_N: Positive
    max_reverse_N: Positive
    dead_band: tuple[float, float]


class Shape(Sourced, kw_only=True, frozen=True):
    """Force over its maximum as an odd polynomial: the sum of coefficients[k] v**(2k+1), scaled to 1 at v = 1. v is 0 at the edge of the dead band
    and 1 at full command."""

    coefficients: tuple[float, ...]


class LagTable(Sourced, kw_only=True, frozen=True):
    """Lag of the force: `time_constant_s`, or the transfer function numerator / denominator, coefficients from the highest power of s down."""

    time_constant_s: Positive | UnsetType = UNSET
    numerator: tuple[float, ...] | UnsetType = UNSET
    denominator: tuple[float, ...] | UnsetType = UNSET


class Propeller(Sourced, kw_only=True, frozen=True):
    """Propeller of a thruster.

    Attributes:
        diameter_m: diameter of the disc.
        torque_per_force_m: reaction torque per newton of thrust.
        inflow_sqrtN_spm: k in T = T0 - k sqrt(|T0|) V_a. T falls to zero at most with the inflow, and rises to 2 T0 at most against it.
        stopped_drag: drag coefficient of the stopped propeller, on the area of the disc and the speed along the axis.
    """

    diameter_m: Positive
    torque_per_force_m: Annotated[float, Meta(ge=0)] = 0.0
    inflow_sqrtN_spm: Annotated[float, Meta(ge=0)] = 0.0
    stopped_drag: Annotated[float, Meta(ge=0)] = 0.0


class Electric(Sourced, kw_only=True, frozen=True):
    """Power and shaft speed of a propeller at rest, from its open-water thrust T.

    Attributes:
        power_WpN15: electric power is this times |T|**1.5.
        speed_radpspN05: shaft speed is this times sqrt(|T|).
        reverse_power_WpN15: the same for negative thrust; default: as forward.
        reverse_speed_radpspN05: the same for negative thrust; default: as forward.
    """

    power_WpN15: Positive
    speed_radpspN05: Positive
    reverse_power_WpN15: Positive | UnsetType = UNSET
    reverse_speed_radpspN05: Positive | UnsetType = UNSET


class ThrusterDevice(Table, kw_only=True, frozen=True):
    """A device file of a thruster: force curves at one or several supply voltages, linear in the voltage between them.

    Attributes:
        tables: curves that were measured point by point.
        curves: curves of which only the limits are known; they need `shape`.
    """

    schema: Literal[1]
    kind: Literal["thruster"]
    name: str
    default_voltage_V: Positive
    tables: dict[str, MeasuredCurve] = field(default_factory=dict)
    shape: Shape | UnsetType = UNSET
    curves: dict[str, ForceCurve] = field(default_factory=dict)
    lag: LagTable
    propeller: Propeller
    electric: Electric | UnsetType = UNSET
