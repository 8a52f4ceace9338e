"""Shapes of the physics, as viewers get them."""

from __future__ import annotations

import hashlib
import math
import struct
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from uwserver.adapter import installed_adapters
from uwserver.physics.geometry.shapes import (
    Box,
    Capsule,
    ConvexHull,
    Cylinder,
    HalfSpace,
    Placed,
    Solid,
    Sphere,
    TriangleMesh,
)
from uwserver.ports import ShapeView
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.load.scenario import load
from uwserver.scenario.scene.shapes import Meshes, displaced_shapes, shape_views
from uwserver.scenario.solids.appearance import MATERIALS

GREY = (0.5, 0.5, 0.5)
CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])


def views(*shapes: object, materials: tuple[str, ...] = ("default",)) -> tuple[ShapeView, ...]:
    placed = tuple(Placed(shape, (1.0, 2.0, 3.0)) for shape in shapes)  # type: ignore[arg-type]  # all are shapes
    return shape_views(Solid("x", placed), materials, GREY, Meshes())


def test_sizes_are_whole_edges_and_lengths() -> None:
    box, sphere, cylinder, capsule, plane = views(
        Box((1.0, 2.0, 3.0)), Sphere(0.5), Cylinder(0.1, 2.0), Capsule(0.2, 3.0), HalfSpace()
    )
    assert (box.kind, box.size, box.p) == ("box", (2.0, 4.0, 6.0), (1.0, 2.0, 3.0))
    assert (sphere.kind, sphere.radius) == ("sphere", 0.5)
    assert (cylinder.kind, cylinder.radius, cylinder.length) == ("cylinder", 0.1, 4.0)
    assert (capsule.kind, capsule.radius, capsule.length) == ("capsule", 0.2, 6.0)
    assert plane.kind == "plane"


def test_materials_have_their_colours_and_unknown_ones_that_of_the_thing() -> None:
    solid = Solid(
        "x", (Placed(Sphere(1.0), material=1), Placed(Sphere(1.0)), Placed(Sphere(1.0), material=9)), material=0
    )
    steel, foam, unknown = shape_views(solid, ("foam", "steel"), GREY, Meshes())
    assert (steel.material, steel.colour) == ("steel", MATERIALS["steel"])
    assert (foam.material, foam.colour) == ("foam", GREY)
    assert unknown.material == "default"


def test_triangles_go_by_the_hash_of_their_bytes() -> None:
    meshes = Meshes()
    mesh = TriangleMesh(CORNERS[:4], np.array([[0, 1, 2], [1, 3, 2]]))
    name = meshes.add(mesh)
    data = meshes.data[name]
    assert hashlib.sha256(data).hexdigest() == name
    assert struct.unpack_from("<II", data) == (4, 2)
    assert np.frombuffer(data, "<f4", 12, 8).reshape(4, 3).tolist() == CORNERS[:4].tolist()
    assert np.frombuffer(data, "<u4", 6, 56).tolist() == [0, 1, 2, 1, 3, 2]
    assert (meshes.views[name].triangles, meshes.views[name].high) == (2, (0.0, 1.0, 1.0))
    assert meshes.add(mesh) == name == meshes.add(TriangleMesh(mesh.vertices.copy(), mesh.faces.copy()))
    assert len(meshes.data) == 1


def test_a_hull_is_closed_and_seen_from_outside() -> None:
    meshes = Meshes()
    data = meshes.data[meshes.add(ConvexHull(CORNERS))]
    n, m = struct.unpack_from("<II", data)
    points = np.frombuffer(data, "<f4", 3 * n, 8).reshape(n, 3).astype(float)
    faces = np.frombuffer(data, "<u4", 3 * m, 8 + 12 * n).reshape(m, 3)
    a, b, c = (points[faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", np.cross(a, b), c) / 6.0 == pytest.approx(1.0), (
        "the volume of the cube, counted outwards"
    )


def test_a_vehicle_without_collision_shapes_has_those_of_its_volume() -> None:
    vehicle = load("bluerov2_pool", adapters=installed_adapters()).vehicles["bluerov2"].vehicle
    boxes = displaced_shapes(vehicle, GREY)
    assert len(boxes) == len(vehicle.buoyancy.shapes) > 0
    (capsule,) = displaced_shapes(replace(vehicle, buoyancy=replace(vehicle.buoyancy, shapes={})), GREY)
    assert capsule.kind == "capsule"
    assert capsule.radius is not None
    assert capsule.length is not None
    volume = math.pi * capsule.radius**2 * (capsule.length + 4.0 / 3.0 * capsule.radius)
    assert volume == pytest.approx(vehicle.buoyancy.volume_m3)


def hills(side: int) -> TriangleMesh:
    """A seabed of side x side points over 100 m, its outside up."""
    x, y = np.meshgrid(np.linspace(0.0, 100.0, side), np.linspace(0.0, 100.0, side), indexing="ij")
    depth = 20.0 + 2.0 * np.sin(0.1 * x) * np.cos(0.07 * y)
    k = np.arange(side * side).reshape(side, side)
    a, b, c, d = k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]
    faces = np.concatenate([np.stack([a, d, b], axis=-1).reshape(-1, 3), np.stack([b, d, c], axis=-1).reshape(-1, 3)])
    return TriangleMesh(np.stack([x, y, depth], axis=-1).reshape(-1, 3), faces)


def test_a_large_mesh_has_a_coarse_form_that_lies_where_it_does() -> None:
    mesh, meshes = hills(280), Meshes()
    view = meshes.views[meshes.add(mesh)]
    assert view.triangles == 2 * 279 * 279
    assert view.coarse is not None
    data = meshes.data[view.coarse]
    count, triangles = struct.unpack_from("<II", data)
    assert 1000 < triangles < 5000
    points = np.frombuffer(data, "<f4", 3 * count, 8).reshape(-1, 3)
    faces = np.frombuffer(data, "<u4", 3 * triangles, 8 + 12 * count).reshape(-1, 3)
    x, y, depth = points.T
    assert depth == pytest.approx(20.0 + 2.0 * np.sin(0.1 * x) * np.cos(0.07 * y), abs=0.05)
    a, b, c = (points[faces[:, k]] for k in range(3))
    areas = 0.5 * np.cross(b - a, c - a)
    assert np.all(areas[:, 2] < 0.0), "each triangle still faces up"
    assert 0.9 * 100.0**2 < -areas[:, 2].sum() < 100.0**2, "without holes, but for half a cell at the edge"


def test_a_small_mesh_has_none() -> None:
    meshes = Meshes()
    assert meshes.views[meshes.add(hills(20))].coarse is None


def test_a_seabed_of_a_million_triangles_comes_in_tiles_that_each_have_one(tmp_path: Path) -> None:
    side = 720
    depth = 20.0 + np.random.default_rng(1).normal(0.0, 0.1, (side, side))
    np.save(tmp_path / "hills.npy", depth)
    begun = ScenarioBuilder("hills").vehicle("rov", "bluerov2")
    begun.seabed("grid", file=str(tmp_path / "hills.npy"), spacing_m=[0.5, 0.5])
    resolved, meshes = load(begun.build(), adapters=installed_adapters()), Meshes()
    shapes = shape_views(resolved.static["seabed"], resolved.materials, GREY, meshes)
    tiles = {str(shape.mesh): meshes.views[str(shape.mesh)] for shape in shapes}
    assert sum(tile.triangles for tile in tiles.values()) == 2 * (side - 1) ** 2 > 1_000_000
    first = sum(len(meshes.data[tile.coarse or whole]) for whole, tile in tiles.items())
    assert first < 0.1 * sum(len(meshes.data[whole]) for whole in tiles), "what is shown first is quickly there"
    assert all(tile.coarse for tile in tiles.values() if tile.triangles > 20_000)
