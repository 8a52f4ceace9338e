"""Views of a world for viewers and recorders: shapes and places, which rarely change, and the poses of all bodies at an instant.

Lengths are in m, angles in rad, times in s. Positions and attitudes (w x y z) of static things are in N, those of parts of a vehicle in B.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import UNSET, Struct, UnsetType

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]

ACHIEVED_FULL = 127
"""Value in `SceneState.achieved` of an actuator at its limit."""
NOWHERE_M = 1e6
"""A body at this height above the water or higher is nowhere at present: it follows poses, and has none. Viewers leave it out."""


class ShapeView(Struct, frozen=True):
    """A solid shape. Cylinders and capsules lie along the x axis of their frame.

    Attributes:
        kind: box (`size`, full edges), sphere (`radius`), cylinder or capsule (`radius`, `length`; that of a capsule without its hemispheres),
            plane (everything at z >= 0), or mesh.
        p, q: pose of its frame in N or B.
        mesh: hash of its triangles, see `MeshView`.
        material: name.
        colour: red, green, blue, 0..1 (linear).
        name: name of the part; "" if it has none.
    """

    kind: Literal["box", "sphere", "cylinder", "capsule", "plane", "mesh"]
    p: Vec3 = (0.0, 0.0, 0.0)
    q: Quat = (1.0, 0.0, 0.0, 0.0)
    size: Vec3 | None = None
    radius: float | None = None
    length: float | None = None
    mesh: str | None = None
    material: str = "default"
    colour: Vec3 = (0.6, 0.6, 0.6)
    name: str = ""


class MeshView(Struct, frozen=True):
    """A triangle mesh, which shapes refer to by its hash.

    Attributes:
        triangles: number of triangles.
        low, high: corners of the box around its vertices.
        coarse: hash of a mesh of about two thousand triangles to show until this one is loaded; None if this one is small.
    """

    triangles: int
    low: Vec3
    high: Vec3
    coarse: str | None = None


class ModelFileView(Struct, frozen=True):
    """A glTF file (.glb) that viewers show instead of the shapes.

    Attributes:
        sha256: hash of the file; it is served under this name.
        size: size of the file, bytes.
        p, q: pose of the file's frame in B; in that frame x is forward, y right, z down after `up` is applied.
        up: axis of the file that points up.
        scale: length of one unit of the file, m.
    """

    sha256: str
    size: int
    p: Vec3 = (0.0, 0.0, 0.0)
    q: Quat = (1.0, 0.0, 0.0, 0.0)
    up: Literal["y", "z"] = "y"
    scale: float = 1.0


class SolidView(Struct, frozen=True):
    """Something that never moves: the seabed, or a structure. A seabed from a grid has one shape for each tile."""

    name: str
    shapes: tuple[ShapeView, ...]
    looks: ModelFileView | None = None


class ActuatorView(Struct, frozen=True):
    """A part of a vehicle that moves or pushes. It has one value in `SceneState.achieved`.

    Attributes:
        name: in the vehicle file.
        kind: thruster, propeller, fin, ballast or moving_mass.
        p: place in B.
        axis: axis of a thruster or propeller: direction of the force at a positive command; of a fin: hinge, right-handed; of a moving mass:
            direction of its motion.
        chord: chord of a fin: direction of its leading edge at angle zero.
        span: span of a fin.
        diameter: diameter of a propeller's disc.
        handedness: right (clockwise seen along `axis` at a positive command), left, or none.
        low, high: thrust (N), angle (rad), shaft speed (rad/s), volume (m3) or position (m) at -127 and at 127. If they are not opposite, the
            number is 127 (value - middle) / (half the range); for a thruster 127 value / `high` or 127 value / -`low`.
        unit: of `low` and `high`.
        port, index: actuator port that commands it, and the element of its vector; None if there is none.
    """

    name: str
    kind: Literal["thruster", "propeller", "fin", "ballast", "moving_mass"]
    p: Vec3
    axis: Vec3 | None = None
    chord: Vec3 | None = None
    span: float | None = None
    diameter: float | None = None
    handedness: str = "none"
    low: float = -1.0
    high: float = 1.0
    unit: str = "1"
    port: str | None = None
    index: int | None = None


class BeamView(Struct, frozen=True):
    """A ray or cone that a sensor sends out, in the sensor's frame.

    Attributes:
        direction: unit vector of its axis.
        width: full angle of a cone; 0 for a ray.
        near, far: limits of its range.
    """

    direction: Vec3
    width: float = 0.0
    near: float = 0.0
    far: float = 0.0


class FanView(Struct, frozen=True):
    """A sector that a sonar covers, about the x axis of the sensor. Horizontal angles count from x towards y.

    Attributes:
        horizontal: full horizontal angle of one beam.
        vertical: full vertical angle.
        step: angle between two pings of a scanning head; 0 if it does not scan.
        sector: first and last bearing of the scan at the start.
        bins: number of bins of one ping.
        near, far: limits of its range.
    """

    horizontal: float
    vertical: float
    step: float
    sector: tuple[float, float]
    bins: int
    near: float
    far: float


class SensorView(Struct, frozen=True):
    """A sensor of a vehicle: path of its port, kind, pose in B, beams, and accuracy.

    Attributes:
        sigmas: configured standard deviation of a sample by field, in the unit of the field: for each axis, or one number for all; absent if it
            is unknown.
        address: address of a modem at the start, if its packets carry one.
        message: the same as that of its port.
    """

    path: str
    kind: str
    p: Vec3
    q: Quat
    beams: tuple[BeamView, ...] = ()
    fan: FanView | None = None
    sigmas: dict[str, tuple[float, ...]] | UnsetType = UNSET
    address: int | UnsetType = UNSET
    message: str | UnsetType = UNSET


class LampView(Struct, frozen=True):
    """A lamp of a vehicle.

    Attributes:
        name: in the vehicle file.
        p, q: pose in B; it shines along its x axis.
        cone: full angle of its light.
        lumens: luminous flux at full brightness.
    """

    name: str
    p: Vec3
    q: Quat
    cone: float
    lumens: float


class BodyView(Struct, frozen=True):
    """A vehicle or a free object.

    Attributes:
        name: first level of its paths.
        model: name of the vehicle file, or "object".
        like: name of the table of the scenario that it is a copy of.
        shapes: in B. If the vehicle file has no collision shapes: those of its displaced volume, or a capsule of this volume.
        lamps: lamps of the vehicle.
        external: whether it follows poses from outside (a log, another server, a robot at sea); it may be nowhere (`NOWHERE_M`).
        ghost: whether nothing touches it and no sensor sees it; viewers draw it translucent.
        colour: red, green, blue, 0..1 (linear), of a ghost and of the trail of an external body; None for the usual one.
    """

    name: str
    model: str
    like: str
    shapes: tuple[ShapeView, ...]
    mass: float = 0.0
    looks: ModelFileView | None = None
    actuators: tuple[ActuatorView, ...] = ()
    sensors: tuple[SensorView, ...] = ()
    lamps: tuple[LampView, ...] = ()
    external: bool = False
    ghost: bool = False
    colour: Vec3 | None = None


class BeaconView(Struct, frozen=True):
    """An acoustic beacon: its place in N, or in B of the body that carries it, and the sensor that interrogates it."""

    name: str
    sensor: str
    p: Vec3
    body: str | None = None
    delay: float = 0.0


class WaveView(NamedTuple):
    """One wave component: elevation (up, m) = amplitude cos(kx x + ky y - omega t + phase), x north, y east; `depth` is None for deep water."""

    amplitude: float
    kx: float
    ky: float
    omega: float
    phase: float
    depth: float | None


class WaterView(Struct, frozen=True):
    """The sea.

    Attributes:
        density: kg/m3.
        sound_speed: m/s near the surface.
        waves: the components that the physics sums.
        surface_level: height of the still surface above z = 0, m.
        current: uniform part at the time of the request, N, m/s.
        profiles: further currents by depth, each a row of (depth, velocity in N), constant above the first and below the last depth.
        jerlov: water type, I to 9C.
        attenuation: attenuation of a light beam, red, green, blue, 1/m.
        colour: colour of the veil (light scattered by the water), red, green, blue; the greatest is 1.
    """

    density: float
    sound_speed: float
    waves: tuple[WaveView, ...]
    surface_level: float
    current: Vec3
    profiles: tuple[tuple[tuple[float, Vec3], ...], ...]
    jerlov: str
    attenuation: Vec3
    colour: Vec3


class OriginView(Struct, frozen=True):
    """Place of the origin of N: WGS84, rad."""

    latitude: float
    longitude: float


class SceneView(Struct, frozen=True):
    """View of a whole world, valid until its revision changes.

    Attributes:
        schema: version of this format.
        revision: rises when bodies come or go.
        scenario, title, epoch, rate_hz: those of the world.
        origin: place of N on the Earth; None if the scenario has none.
        seabed: None for open water.
        vehicles, objects: in the order of `SceneState.poses`, vehicles first.
        meshes: by hash.
    """

    schema: int
    revision: int
    scenario: str
    title: str
    epoch: str
    rate_hz: float
    origin: OriginView | None
    water: WaterView
    seabed: SolidView | None
    structures: tuple[SolidView, ...]
    vehicles: tuple[BodyView, ...]
    objects: tuple[BodyView, ...]
    beacons: tuple[BeaconView, ...]
    meshes: dict[str, MeshView]


class Present(NamedTuple):
    """A body that is in the world: its name, and the name of the table that it is a copy of."""

    name: str
    like: str


class EntityList(NamedTuple):
    """The bodies in the world. It is the same object until a body comes or goes, or the current is set.

    Attributes:
        revision: rises at each of these changes.
        vehicles, objects: in the order of the poses.
    """

    revision: int
    vehicles: tuple[Present, ...]
    objects: tuple[Present, ...]


class SceneState(NamedTuple):
    """Poses of all bodies after a tick.

    Attributes:
        entities: the bodies.
        t_ns: simulation time.
        poses: (n, 7) p_NB (m) and q_NB (w x y z), vehicles first.
        achieved: (m) int8, -127..127: state of the actuators of all vehicles, in the order of `BodyView.actuators`.
        current: uniform part of the current, N, m/s.
    """

    entities: EntityList
    t_ns: int
    poses: npt.NDArray[np.float64]
    achieved: npt.NDArray[np.int8]
    current: tuple[Any, ...]
