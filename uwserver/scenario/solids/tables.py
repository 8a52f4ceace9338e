"""Tables of solid things: seabed, structures, free objects, and the collision shapes of a vehicle."""

from __future__ import annotations

from typing import Literal

from msgspec import UNSET, UnsetType

from uwserver.sensors.truth import Truth
from uwserver.table import Name, NonNegative, Positive, Probability, Table, Vector3

Edges = tuple[Positive, Positive, Positive]


class Contact(Table, kw_only=True, frozen=True):
    """How a surface touches, and what it is for sensors.

    Attributes:
        friction: Coulomb coefficient; two surfaces have the geometric mean of theirs.
        restitution: of two surfaces the larger counts.
        material: a name; sensors tell materials apart.
    """

    friction: NonNegative = 0.5
    restitution: Probability = 0.0
    material: Name = "default"


class FlatSeabed(Contact, tag="flat", tag_field="kind", kw_only=True, frozen=True):
    """A level seabed without end."""

    depth_m: float


class GridSeabed(Contact, tag="grid", tag_field="kind", kw_only=True, frozen=True):
    """A seabed from a grid of depths.

    Attributes:
        file: `.npy`: an array of rows to the north and columns to the east; `.nc`: NetCDF with latitude and longitude, as of GEBCO. Relative
            to the scenario file.
        values: whether the file's numbers are depths (m, positive down) or elevations (m, positive up); default: depth in .npy, elevation
            in .nc.
        spacing_m: of rows and columns; .npy only.
        origin_north_east_m: position of the first row and column in N; .npy only. Default: the grid's middle is N's origin.
        variable, latitude, longitude: names in the .nc file.
        extent_m: takes only what is not farther north, south, east or west of N's origin.
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
    """Where something stands in N.

    Attributes:
        looks: a .glb file that viewers show instead of the shape, relative to the scenario file: y up, x forward, in m, about the origin of
            the shape.
    """

    looks: Name | UnsetType = UNSET
    position_ned_m: Vector3 = (0.0, 0.0, 0.0)
    attitude_rpy_deg: Vector3 = (0.0, 0.0, 0.0)


class BoxStructure(InScenario, tag="box", tag_field="kind", kw_only=True, frozen=True):
    """A box; `size_m` are its whole edges."""

    size_m: Edges


class SphereStructure(InScenario, tag="sphere", tag_field="kind", kw_only=True, frozen=True):
    """A ball."""

    radius_m: Positive


class CylinderStructure(InScenario, tag="cylinder", tag_field="kind", kw_only=True, frozen=True):
    """A cylinder about its axis x."""

    radius_m: Positive
    length_m: Positive


class CapsuleStructure(InScenario, tag="capsule", tag_field="kind", kw_only=True, frozen=True):
    """A cylinder of `length_m` about its axis x with a half ball at each end."""

    radius_m: Positive
    length_m: Positive


class AssetStructure(InScenario, kw_only=True, frozen=True):
    """A mesh file.

    Attributes:
        file: `.glb`, `.gltf`, `.obj`, `.stl` or `.ply`, relative to the scenario file.
        up: the asset's axis that points up. Its axis x stays x. Default: y for glTF, z for others.
        scale: metres of one of the asset's units.
    """

    file: Name
    up: Literal["y", "z"] | UnsetType = UNSET
    scale: Positive = 1.0


class MeshStructure(AssetStructure, tag="mesh", tag_field="kind", kw_only=True, frozen=True):
    """A triangle mesh as it is. One that is not closed is a sheet without thickness."""


class HullStructure(AssetStructure, tag="hull", tag_field="kind", kw_only=True, frozen=True):
    """The convex hull of a mesh file."""


class OnVehicle(Table, kw_only=True, frozen=True):
    """Where a shape sits on the vehicle."""

    center_frd_m: Vector3 = (0.0, 0.0, 0.0)
    rpy_deg: Vector3 = (0.0, 0.0, 0.0)


class BoxCollision(OnVehicle, tag="box", tag_field="kind", kw_only=True, frozen=True):
    """A box; `size_m` are its whole edges."""

    size_m: Edges


class SphereCollision(OnVehicle, tag="sphere", tag_field="kind", kw_only=True, frozen=True):
    """A ball."""

    radius_m: Positive


class CylinderCollision(OnVehicle, tag="cylinder", tag_field="kind", kw_only=True, frozen=True):
    """A cylinder about its axis x."""

    radius_m: Positive
    length_m: Positive


class CapsuleCollision(OnVehicle, tag="capsule", tag_field="kind", kw_only=True, frozen=True):
    """A cylinder of `length_m` about its axis x with a half ball at each end."""

    radius_m: Positive
    length_m: Positive


class HullCollision(OnVehicle, tag="hull", tag_field="kind", kw_only=True, frozen=True):
    """The convex hull of a mesh file; keys as of a structure. What moves is made of convex shapes: give a hollow thing several."""

    file: Name
    up: Literal["y", "z"] | UnsetType = UNSET
    scale: Positive = 1.0


class FreeObject(InScenario, kw_only=True, frozen=True):
    """Something that drifts, sinks and is pushed; homogeneous, so its origin is its centre. Give `mass_kg` or `density_kgpm3`.

    With `present = false` it is not there at the start; ``world/spawn`` can add objects like it.

    Its added mass and drag follow from its form; docs/how-to/seabed-and-structures.md has the coefficients.
    """

    present: bool = True
    truth: Truth | UnsetType = UNSET
    mass_kg: Positive | UnsetType = UNSET
    density_kgpm3: Positive | UnsetType = UNSET
    velocity_frd_mps: Vector3 = (0.0, 0.0, 0.0)


class BoxObject(FreeObject, tag="box", tag_field="kind", kw_only=True, frozen=True):
    """A box; `size_m` are its whole edges."""

    size_m: Edges


class SphereObject(FreeObject, tag="sphere", tag_field="kind", kw_only=True, frozen=True):
    """A ball."""

    radius_m: Positive


class CylinderObject(FreeObject, tag="cylinder", tag_field="kind", kw_only=True, frozen=True):
    """A cylinder about its axis x."""

    radius_m: Positive
    length_m: Positive


Seabed = FlatSeabed | GridSeabed
Structure = BoxStructure | SphereStructure | CylinderStructure | CapsuleStructure | MeshStructure | HullStructure
Collision = BoxCollision | SphereCollision | CylinderCollision | CapsuleCollision | HullCollision
ObjectEntry = BoxObject | SphereObject | CylinderObject
