"""Reads the solid parts of a scenario (seabed, structures, objects, vehicles) from tables and files, and checks them against each other."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from msgspec import UnsetType

from uwserver.physics.collision.engine import AUTO
from uwserver.physics.geometry.shapes import (
    BadSolid,
    Box,
    Capsule,
    ConvexHull,
    HalfSpace,
    Placed,
    Solid,
    Sphere,
    TriangleMesh,
)
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.files.convert import Node, Report, check_name, is_one_of
from uwserver.scenario.files.documents import Document
from uwserver.scenario.files.errors import KeyPath
from uwserver.scenario.load.resolved import ResolvedObject
from uwserver.scenario.solids.appearance import read_model_file
from uwserver.scenario.solids.memory import check_memory
from uwserver.scenario.solids.objects import object_params
from uwserver.scenario.solids.shapes import (
    Materials,
    collision_solid,
    missing_engines,
    object_solid,
    seabed_solid,
    structure_solid,
)
from uwserver.scenario.solids.tables import Collision, Contact, HullCollision, ObjectEntry, Seabed, Structure
from uwserver.scenario.vehicle.entry import MergedFile, starts
from uwserver.scenario.world.tables import Environment, WorldTable


class SolidFiles:
    """Solids of one scenario. Everything without errors is read, so that one error does not hide others.

    Attributes:
        static: seabed and structures, in N, by name.
        objects: free objects by name.
        vehicles: collision shapes of vehicles by name.
        ghosts: collision shapes of external vehicles that nothing can touch.
        looks: .glb files by table and name.
        materials: numbers of materials.
    """

    def __init__(self, document: Document, scenario: Node, report: Report, warn: Report) -> None:
        self.static: dict[str, Solid] = {}
        self.objects: dict[str, ResolvedObject] = {}
        self.vehicles: dict[str, Solid] = {}
        self.ghosts: dict[str, Solid] = {}
        self.looks: dict[tuple[str, str], bytes] = {}
        self.materials: Materials = {}
        self._scenario, self._report = scenario, report
        self._folder = document.folder
        self._reported = False
        world: WorldTable | None = scenario.at("world").value
        self._engine = world.engine if world is not None else AUTO
        self._read_seabed(world)
        for name, node in scenario.at("structures").parts.items():
            table: Structure | None = node.value
            path: KeyPath = ("structures", name)
            if name == "seabed":
                report(path, "the table [seabed] has this name already: choose another name")
            elif table is not None and self._engines(path, report):
                with _reporting(path, report):
                    told = partial(warn, path)
                    self.static[name] = structure_solid(name, table, self._folder, self.materials, told)
                self._read_model_file(path, table.looks, self._folder, report)
        self._check_memory()
        for name, node in scenario.at("objects").parts.items():
            self._read_object(name, node.value, scenario.at("environment").value)

    def read_vehicle(self, name: str, merged: MergedFile, tree: Node, report: Report, warn: Report) -> None:
        """Read the collision shapes and looks of a vehicle; `tree` is its converted file."""
        if tree.value is not None:
            self._read_model_file(
                ("vehicles", name), tree.value.looks, merged.folder_of(("looks",)), report, ("looks",)
            )
        tables: dict[str, Collision] = tree.values("collision")
        folders = {key: merged.folder_of(("collision", key, "file")) for key in tables}
        contact: Contact | None = tree.at("contact").value
        if not tables or contact is None:
            return
        path: KeyPath = ("collision",)
        if any(isinstance(table, HullCollision) for table in tables.values()) and not self._engines(path, report):
            return
        solids = self.ghosts if self._is(name, "external") and not self._is(name, "solid") else self.vehicles
        with _reporting(path, report):
            solids[name] = collision_solid(name, tables, contact, folders, self.materials, partial(warn, path))

    def check_places(self) -> None:
        """Report vehicles and objects that start inside a solid."""
        for table in ("vehicles", "objects"):
            for key, _, p in starts(self._scenario, table):
                if p is None or self._is(key, "external"):  # poses of external vehicles come from outside
                    continue
                for solid in self.static.values():
                    what = _buried(solid, np.array(p))
                    if what is not None:
                        self._report((table, key, "position_ned_m"), f'it starts inside "{solid.name}": {what}')

    def check_engines(self) -> None:
        """Report missing engines if several vehicles can touch each other; one alone needs none."""
        if sum(key in self.vehicles for key, _, _ in starts(self._scenario, "vehicles")) > 1:
            self._engines(("vehicles",), self._report)

    def _is(self, name: str, what: Literal["external", "solid"]) -> bool:
        """Return whether the table of a vehicle has kind = "external", or solid = true."""
        node = self._scenario.at("vehicles", name)
        return node.at("kind").value == "external" if what == "external" else node.at("solid").value is True

    def _read_seabed(self, world: WorldTable | None) -> None:
        origin = None if world is None else world.origin
        table: Seabed | None = self._scenario.at("seabed").value
        if table is not None and world is not None and self._engines(("seabed",), self._report):
            with _reporting(("seabed",), self._report):
                self.static["seabed"] = seabed_solid(table, self._folder, origin, self.materials)

    def _read_object(self, name: str, table: ObjectEntry | None, environment: Environment | None) -> None:
        path: KeyPath = ("objects", name)
        if not check_name(path, self._report):
            return
        if name == "world" or name in self._scenario.at("vehicles").parts:
            self._report(
                path,
                f'"{name}" is taken, as paths of {"services" if name == "world" else "a vehicle"} begin with it: choose another name',
            )
        if table is None or environment is None or not self._engines(path, self._report):
            return
        if not is_one_of(table, ("mass_kg", "density_kgpm3"), path, self._report):
            return
        solid = object_solid(name, table, self.materials)
        self._read_model_file(path, table.looks, self._folder, self._report)
        looks = self.looks.get(("objects", name), b"")
        self.objects[name] = ResolvedObject(name, table, object_params(table, environment), solid, looks)

    def _read_model_file(
        self, owner: KeyPath, looks: str | UnsetType, folder: Path, report: Report, place: KeyPath | None = None
    ) -> None:
        """Read the file that viewers show of a vehicle, a structure or an object."""
        if isinstance(looks, UnsetType):
            return
        with _reporting(place or (*owner, "looks"), report):
            self.looks[str(owner[0]), str(owner[1])] = read_model_file(folder / looks)

    def _check_memory(self) -> None:
        """Report if all files together take too much memory; each alone has been checked."""
        counts = {name: sum(_triangles(placed) for placed in solid.shapes) for name, solid in self.static.items()}
        largest = max(counts, key=counts.__getitem__, default="seabed")
        with _reporting(("seabed",) if largest == "seabed" else ("structures", largest), self._report):
            check_memory("seabed and structures", sum(counts.values()))

    def _engines(self, path: KeyPath, report: Report) -> bool:
        """Return whether the packages that solids need are installed; report it once if not."""
        missing = missing_engines(self._engine)
        if missing is not None and not self._reported:
            self._reported = True
            report(path, missing)
        return missing is None


@contextmanager
def _reporting(path: KeyPath, report: Report) -> Iterator[None]:
    """Report at a key that a solid cannot be made."""
    try:
        yield
    except BadSolid as error:
        report(path, str(error))


def _triangles(placed: Placed) -> int:
    return len(placed.shape.faces) if isinstance(placed.shape, TriangleMesh) else 0


def _buried(solid: Solid, p: FloatArray) -> str | None:
    """Say how a point p (3, in N) is inside a static solid and what to do; None if it is outside."""
    meshes = [placed.shape for placed in solid.shapes if isinstance(placed.shape, TriangleMesh)]
    if solid.name == "seabed" and meshes:
        depths = [d for mesh in meshes if (d := _depth_under(mesh, p[0], p[1])) is not None]
        if depths and p[2] > min(depths):
            return f"the seabed is {min(depths):.2f} m deep there; choose a smaller depth"
        return None
    for placed in solid.shapes:
        local = placed.R.T @ (p - placed.p)
        if isinstance(placed.shape, HalfSpace) and local[2] > 0.0:
            return f"the seabed is {placed.p[2]:.2f} m deep; choose a smaller depth"
        if not isinstance(placed.shape, HalfSpace | TriangleMesh) and _is_inside(placed, local):
            return "choose another position"
    closed = [mesh for mesh in meshes if mesh.oriented]
    if closed and sum(_winding(mesh, solid.shapes[0].R.T @ (p - solid.shapes[0].p)) for mesh in closed) > 0.5:
        return "choose another position"
    return None


def _is_inside(placed: Placed, x: FloatArray) -> bool:
    shape = placed.shape
    if isinstance(shape, Box):
        return bool((np.abs(x) < shape.half).all())
    if isinstance(shape, Sphere):
        return float(x @ x) < shape.radius**2
    if isinstance(shape, ConvexHull):
        from scipy.spatial import Delaunay

        return bool(Delaunay(shape.points).find_simplex(x) >= 0)
    if isinstance(shape, Capsule):
        along = max(abs(x[0]) - shape.half_length, 0.0)
        return math.hypot(along, x[1], x[2]) < shape.radius
    assert not isinstance(shape, HalfSpace | TriangleMesh)
    return bool(abs(x[0]) < shape.half_length and math.hypot(x[1], x[2]) < shape.radius)


def _depth_under(mesh: TriangleMesh, north: float, east: float) -> float | None:
    """Return the depth of a seabed mesh at a place, m; None outside its area."""
    corners = mesh.vertices[mesh.faces]
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    x, y = north - a[:, 0], east - a[:, 1]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    s, t = (x * v[:, 1] - y * v[:, 0]) / area, (u[:, 0] * y - u[:, 1] * x) / area
    under = np.flatnonzero((s >= -1e-9) & (t >= -1e-9) & (s + t <= 1.0 + 1e-9))
    if not len(under):
        return None
    k = int(under[0])
    return float(a[k, 2] + s[k] * u[k, 2] + t[k] * v[k, 2])


def _winding(mesh: TriangleMesh, p: FloatArray) -> float:
    """Return the winding number of a closed surface about p: 1 inside, 0 outside. By solid angles: van Oosterom and Strackee 1983."""
    corners = mesh.vertices[mesh.faces] - p
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", v, w) for v, w in ((a, b), (b, c), (c, a)))
    angles = 2.0 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return float(angles.sum() / (4.0 * math.pi))
