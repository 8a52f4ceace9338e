"""Converts the tables of solids to shapes that do not depend on an engine; reads the files that they name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from msgspec import UNSET

from uwserver.packages import install_command
from uwserver.physics.collision.engine import AUTO, missing_engine
from uwserver.physics.geometry.shapes import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Placed,
    Shape,
    Solid,
    Sphere,
    check_shape,
)
from uwserver.scenario.solids.assets import read_hull, read_mesh
from uwserver.scenario.solids.bathymetry import read_grid, triangulate
from uwserver.scenario.solids.tables import Collision, Contact, FlatSeabed, ObjectEntry, Seabed, Structure
from uwserver.sensors.base import Pose

Warn = Callable[[str], None]


Materials = dict[str, int]
"""Numbers of materials by name, in the order of their first use."""


def missing_engines(engine: str = AUTO) -> str | None:
    """Return what to install before a world can hold solids; None if everything is installed.

    Args:
        engine: for contacts, as in `[world]`.
    """
    if find_spec("scipy") is None:
        return f"solids need the package scipy: {install_command('uwserver[solid]')}"
    missing = missing_engine(engine)
    return f"solids need an engine for contacts: {missing}" if missing else None


def seabed_solid(table: Seabed, folder: Path, origin: tuple[float, float] | None, materials: Materials) -> Solid:
    """Return the seabed, in N.

    Args:
        table: table of the scenario.
        folder: where relative file names start.
        origin: latitude and longitude (deg) of N's origin, if the scenario has them.
        materials: the material is added to them.

    Raises:
        BadSolid: see `read_grid`.
    """
    if isinstance(table, FlatSeabed):
        return _solid("seabed", (Placed(HalfSpace(), (0.0, 0.0, table.depth_m)),), table, materials)
    meshes = triangulate(read_grid(table, folder / table.file, origin))
    return _solid("seabed", tuple(Placed(mesh) for mesh in meshes), table, materials)


def structure_solid(name: str, table: Structure, folder: Path, materials: Materials, warn: Warn) -> Solid:
    """Return a structure, in N. Raises BadSolid: see `read_mesh` and `read_hull`."""
    q = Pose.from_degrees(table.attitude_rpy_deg).q
    shapes = tuple(Placed(shape, table.position_ned_m, q) for shape in _shapes(table, folder, warn))
    return _solid(name, shapes, table, materials)


def collision_solid(
    name: str,
    tables: Mapping[str, Collision],
    contact: Contact,
    folders: Mapping[str, Path],
    materials: Materials,
    warn: Warn,
) -> Solid:
    """Return the collision shapes of a vehicle, in B; `folders` has the folder of each file name. Raises BadSolid: see `read_hull`."""
    shapes = tuple(
        Placed(shape, table.center_frd_m, Pose.from_degrees(table.rpy_deg).q)
        for key, table in tables.items()
        for shape in _shapes(table, folders[key], warn)
    )
    return _solid(name, shapes, contact, materials)


def object_solid(name: str, table: ObjectEntry, materials: Materials) -> Solid:
    """Return a free object, in its own B."""
    return _solid(name, tuple(Placed(shape) for shape in _shapes(table, Path(), lambda text: None)), table, materials)


def _solid(name: str, shapes: tuple[Placed, ...], contact: Contact, materials: Materials) -> Solid:
    for placed in shapes:
        check_shape(placed.shape)
    number = materials.setdefault(contact.material, len(materials))
    return Solid(name, shapes, contact.friction, contact.restitution, number)


def _shapes(table: Any, folder: Path, warn: Warn) -> tuple[Shape, ...]:
    kind = table.__struct_config__.tag
    if kind in ("mesh", "hull"):
        up = None if table.up is UNSET else table.up
        read = read_mesh if kind == "mesh" else read_hull
        made = read(folder / table.file, up, table.scale, warn)
        return made if isinstance(made, tuple) else (made,)
    if kind == "box":
        x, y, z = table.size_m
        return (Box((0.5 * x, 0.5 * y, 0.5 * z)),)
    if kind == "sphere":
        return (Sphere(table.radius_m),)
    round_shape = Cylinder if kind == "cylinder" else Capsule
    return (round_shape(table.radius_m, 0.5 * table.length_m),)
