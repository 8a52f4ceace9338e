"""What a world looks like, for those who draw or record it: shapes and places that rarely change, and where all bodies are at an instant.

Lengths in m, angles in rad, times in s. Positions and attitudes (w x y z) of what stands still are in N, of what a vehicle carries in B.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import UNSET, Struct, UnsetType

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]

ACHIEVED_FULL = 127
"""What an actuator has achieved when it gives all that it can, in `SceneState.achieved`."""
NOWHERE_M = 1e6
"""A body that stands this high above the water, or higher, is nowhere now: one that follows poses, and has none. Viewers leave it out."""


class ShapeView(Struct, frozen=True):
    """A solid shape. Cylinders and capsules lie about axis x of their frame.

    Attributes:
        kind: box (`size`, whole edges), sphere (`radius`), cylinder or capsule (`radius`, `length`; of a capsule without its half balls),
            plane (all of z >= 0), or mesh.
        p, q: of its frame in N or B.
        mesh: hash of its triangles, see `MeshView`.
        material: name.
        colour: red, green, blue, 0..1 (linear).
        name: of the part, "" where it has none.
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
    """Triangles that shapes name by their hash.

    Attributes:
        triangles: how many.
        low, high: corners of the box around its vertices.
        coarse: hash of about two thousand triangles to show until it is loaded; None where it is small.
    """

    triangles: int
    low: Vec3
    high: Vec3
    coarse: str | None = None


class LooksView(Struct, frozen=True):
    """A glTF file (.glb) that shows what the thing looks like; the shapes remain what it is.

    Attributes:
        sha256: of the file, under which it is served.
        size: bytes.
        p, q: of the file's frame in B; in this frame x is forward, y right, z down after `up` is applied.
        up: the file's axis that points up.
        scale: m of one unit.
    """

    sha256: str
    size: int
    p: Vec3 = (0.0, 0.0, 0.0)
    q: Quat = (1.0, 0.0, 0.0, 0.0)
    up: Literal["y", "z"] = "y"
    scale: float = 1.0


class SolidView(Struct, frozen=True):
    """Something that never moves: the seabed, or a structure. A seabed of a grid comes in tiles, one shape each."""

    name: str
    shapes: tuple[ShapeView, ...]
    looks: LooksView | None = None


class ActuatorView(Struct, frozen=True):
    """A part of a vehicle that moves or pushes; one number of `SceneState.achieved`.

    Attributes:
        name: in the vehicle's file.
        kind: thruster, propeller, fin, ballast or moving_mass.
        p: where it sits, B.
        axis: of a thruster or propeller: where the force points at a positive command; of a fin: hinge, right-handed; of a mass: of its way.
        chord: of a fin: towards its leading edge at angle zero.
        span: of a fin.
        diameter: of a propeller's disc.
        handedness: right (clockwise seen along `axis` at a positive command), left, or none.
        low, high: what -127 and 127 stand for: thrust (N), angle (rad), shaft speed (rad/s), volume (m3) or way (m). Where these are not
            opposite, the number is (value - middle) / (half the range), times 127; of a thruster value / `high` or value / -`low`.
        unit: of both.
        port, index: actuator port that commands it, and which element of its vector; None where there is none.
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
        width: whole angle of a cone; 0 for a ray.
        near, far: where it sees.
    """

    direction: Vec3
    width: float = 0.0
    near: float = 0.0
    far: float = 0.0


class FanView(Struct, frozen=True):
    """A sector that a sonar looks over, about axis x of the sensor, horizontal angle from x towards y.

    Attributes:
        horizontal: whole angle of one beam to either side together.
        vertical: likewise, up and down.
        step: between two pings of a scanning head; 0 where there is none.
        sector: first and last bearing of the scan at the start.
        bins: of one ping.
        near, far: where it sees.
    """

    horizontal: float
    vertical: float
    step: float
    sector: tuple[float, float]
    bins: int
    near: float
    far: float


class SensorView(Struct, frozen=True):
    """A sensor of a vehicle: path of its port, kind, pose in B, what it sends out, and how exact it is.

    Attributes:
        sigmas: field -> configured 1-sigma of a sample, in the field's unit: of each axis, or one number for all; absent where it is unknown.
        address: that a modem begins with, where its packets tell one.
    """

    path: str
    kind: str
    p: Vec3
    q: Quat
    beams: tuple[BeamView, ...] = ()
    fan: FanView | None = None
    sigmas: dict[str, tuple[float, ...]] | UnsetType = UNSET
    address: int | UnsetType = UNSET


class LampView(Struct, frozen=True):
    """A lamp of a vehicle.

    Attributes:
        name: in the vehicle's file.
        p, q: pose in B; it shines along its x axis.
        cone: whole angle of its light.
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
        model: name of the vehicle's file, or "object".
        like: what of the scenario it is a copy of.
        shapes: in B. Where the vehicle's file has no collision shapes, those of its displaced volume, or a capsule of this volume.
        lamps: what it can light.
        external: it follows poses from elsewhere (a log, another server, a robot at sea), and may be nowhere (`NOWHERE_M`).
        ghost: nothing touches it and no sensor sees it; it is drawn translucent.
        colour: red, green, blue, 0..1 (linear), of a ghost and of the trail of what is external; None for the usual one.
    """

    name: str
    model: str
    like: str
    shapes: tuple[ShapeView, ...]
    mass: float = 0.0
    looks: LooksView | None = None
    actuators: tuple[ActuatorView, ...] = ()
    sensors: tuple[SensorView, ...] = ()
    lamps: tuple[LampView, ...] = ()
    external: bool = False
    ghost: bool = False
    colour: Vec3 | None = None


class BeaconView(Struct, frozen=True):
    """An acoustic beacon: where it stands (N), or on which body it sits (B), and the sensor that asks it."""

    name: str
    sensor: str
    p: Vec3
    body: str | None = None
    delay: float = 0.0


class WaveView(NamedTuple):
    """One component: elevation (up, m) = amplitude cos(kx x + ky y - omega t + phase), x north, y east; `depth` None for deep water."""

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
        waves: components as the physics sums them.
        surface_level: m, up: of the still surface above z = 0.
        current: uniform part at the time of asking, N, m/s.
        profiles: further currents by depth, each a row of (depth, velocity in N), constant above the first and below the last.
        jerlov: water type, I to 9C.
        attenuation: of light along a beam, red, green, blue, 1/m.
        colour: of the veil, red, green, blue, the greatest 1.
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
    """Where N lies: WGS84, rad."""

    latitude: float
    longitude: float


class SceneView(Struct, frozen=True):
    """A whole world, as it looks until its revision changes.

    Attributes:
        schema: version of this form.
        revision: rises when bodies come or go.
        scenario, title, epoch, rate_hz: of the world.
        origin: where N lies on the Earth; None where the scenario does not say.
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
    """A body that is in the world: its name, and what of the scenario it is a copy of."""

    name: str
    like: str


class Cast(NamedTuple):
    """Who is in the world; the same object until somebody comes or goes, or the current is set to another.

    Attributes:
        revision: rises then.
        vehicles, objects: in the order of the poses.
    """

    revision: int
    vehicles: tuple[Present, ...]
    objects: tuple[Present, ...]


class SceneState(NamedTuple):
    """Where all bodies are after a tick.

    Attributes:
        cast: who they are.
        t_ns: simulation time.
        poses: (n, 7) p_NB (m) and q_NB (w x y z), vehicles first.
        achieved: (m) int8: what the actuators of all vehicles achieve, in the order of `BodyView.actuators`, of -127..127.
        current: uniform part of it, N, m/s.
    """

    cast: Cast
    t_ns: int
    poses: npt.NDArray[np.float64]
    achieved: npt.NDArray[np.int8]
    current: tuple[Any, ...]
