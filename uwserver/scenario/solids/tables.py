"""Tables of the seabed, structures, free objects, and the collision shapes of a vehicle."""

from __future__ import annotations

from typing import Literal

from msgspec import UNSET, UnsetType

from uwserver.sensors.truth import Truth
from uwserver.table import Name, NonNegative, Positive, Probability, Table, Vector3

Edges = tuple[Positive, Positive, Positive]


class Contact(Table, kw_only=True, frozen=True):
    """Contact properties and material of a surface.

    Attributes:
        friction: Coulomb coefficient; a contact has the geometric mean of its two surfaces.
        restitution: a contact has the larger value of its two surfaces.
        material: name of the material, which decides what sonars and cameras see.
    """

    friction: NonNegative = 0.5
    restitution: Probability = 0.0
    material: Name = "default"


class FlatSeabed(Contact, tag="flat", tag_field="kind", kw_only=True, frozen=True):
    """A level seabed without borders."""

    depth_m: float


class GridSeabed(Contact, tag="grid", tag_field="kind", kw_only=True, frozen=True):
    """A seabed from a grid of depths.

    Attributes:
        file: relative to the scenario file. `.npy`: an array with rows to the north and columns to the east; `.nc`: NetCDF with latitude and
            longitude, as from GEBCO.
        values: whether the numbers are depths (m, positive down) or elevations (m, positive up); default: depth in .npy, elevation in .nc.
        spacing_m: distance of rows and of columns; .npy only.
        origin_north_east_m: position in N of the first row and column; .npy only. Default: the middle of the grid is at the origin of N.
        variable, latitude, longitude: names in the .nc file.
        extent_m: reads only what is at most this far north, south, east or west of the origin of N.
    """

    file: Name
    values: Literal["depth", "elevation"] | UnsetType = UNSET
    spacing_m: tuple[Positive, Positive] | UnsetType = UNSET
    origin_north_east_m: tuple[float, float] | UnsetType = UNSET
    variable: Name = "elevation"
    latitude: Name = "lat"
    longitude: Name = "lon"
    extent_m: Positive | UnsetType = UNSET


class InScenario(Contact, kw_only=True, frozen=True):
    """Place of something in N.

    Attributes:
        looks: a .glb file, relative to the scenario file, that viewers show instead of the shape: y up, x forward, in m, with its origin at
            that of the shape.
    """

    looks: Name | UnsetType = UNSET
    position_ned_m: Vector3 = (0.0, 0.0, 0.0)
    attitude_rpy_deg: Vector3 = (0.0, 0.0, 0.0)


class BoxStructure(InScenario, tag="box", tag_field="kind", kw_only=True, frozen=True):
    """A box; `size_m` has its full edge lengths."""

    size_m: Edges


class SphereStructure(InScenario, tag="sphere", tag_field="kind", kw_only=True, frozen=True):
    """A sphere."""

    radius_m: Positive


class CylinderStructure(InScenario, tag="cylinder", tag_field="kind", kw_only=True, frozen=True):
    """A cylinder along its x axis."""

    radius_m: Positive
    length_m: Positive


class CapsuleStructure(InScenario, tag="capsule", tag_field="kind", kw_only=True, frozen=True):
    """A cylinder of `length_m` along its x axis with a hemisphere at each end."""

    radius_m: Positive
    length_m: Positive


class AssetStructure(InScenario, kw_only=True, frozen=True):
    """A mesh file.

    Attributes:
        file: `.glb`, `.gltf`, `.obj`, `.stl` or `.ply`, relative to the scenario file.
        up: axis of the file that points up. Its axis x stays x. Default: y for glTF, z for others.
        scale: length of one unit of the file, m.
    """

    file: Name
    up: Literal["y", "z"] | UnsetType = UNSET
    scale: Positive = 1.0


class MeshStructure(AssetStructure, tag="mesh", tag_field="kind", kw_only=True, frozen=True):
    """A triangle mesh as it is. A mesh that is not closed acts as a sheet without thickness."""


class HullStructure(AssetStructure, tag="hull", tag_field="kind", kw_only=True, frozen=True):
    """The convex hull of a mesh file."""


class OnVehicle(Table, kw_only=True, frozen=True):
    """Place of a shape on the vehicle."""

    center_frd_m: Vector3 = (0.0, 0.0, 0.0)
    rpy_deg: Vector3 = (0.0, 0.0, 0.0)


class BoxCollision(OnVehicle, tag="box", tag_field="kind", kw_only=True, frozen=True):
    """A box; `size_m` has its full edge lengths."""

    size_m: Edges


class SphereCollision(OnVehicle, tag="sphere", tag_field="kind", kw_only=True, frozen=True):
    """A sphere."""

    radius_m: Positive


class CylinderCollision(OnVehicle, tag="cylinder", tag_field="kind", kw_only=True, frozen=True):
    """A cylinder along its x axis."""

    radius_m: Positive
    length_m: Positive


class CapsuleCollision(OnVehicle, tag="capsule", tag_field="kind", kw_only=True, frozen=True):
    """A cylinder of `length_m` along its x axis with a hemisphere at each end."""

    radius_m: Positive
    length_m: Positive


class HullCollision(OnVehicle, tag="hull", tag_field="kind", kw_only=True, frozen=True):
    """The convex hull of a mesh file; keys as for a structure. Moving bodies consist of convex shapes: describe a hollow one by several."""

    file: Name
    up: Literal["y", "z"] | UnsetType = UNSET
    scale: Positive = 1.0


class FreeObject(InScenario, kw_only=True, frozen=True):
    """Something that drifts, sinks and can be pushed. It is homogeneous, so its origin is its centre. Give `mass_kg` or `density_kgpm3`.

    With `present = false` it is left out at the start; ``world/spawn`` can add objects like it later.

    Its added mass and drag follow from its form; docs/how-to/seabed-and-structures.md has the coefficients.
    """

    present: bool = True
    truth: Truth | UnsetType = UNSET
    mass_kg: Positive | UnsetType = UNSET
    density_kgpm3: Positive | UnsetType = UNSET
    velocity_frd_mps: Vector3 = (0.0, 0.0, 0.0)


class BoxObject(FreeObject, tag="box", tag_field="kind", kw_only=True, frozen=True):
    """A box; `size_m` has its full edge lengths."""

    size_m: Edges


class SphereObject(FreeObject, tag="sphere", tag_field="kind", kw_only=True, frozen=True):
    """A sphere."""

    radius_m: Positive


class CylinderObject(FreeObject, tag="cylinder", tag_field="kind", kw_only=True, frozen=True):
    """A cylinder along its x axis."""

    radius_m: Positive
    length_m: Positive


Seabed = FlatSeabed | GridSeabed
Structure = BoxStructure | SphereStructure | CylinderStructure | CapsuleStructure | MeshStructure | HullStructure
Collision = BoxCollision | SphereCollision | CylinderCollision | CapsuleCollision | HullCollision
ObjectEntry = BoxObject | SphereObject | CylinderObject
