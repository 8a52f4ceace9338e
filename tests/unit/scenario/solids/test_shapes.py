"""From the tables of solid things to solids: sizes halved, angles turned, materials numbered, bad sizes refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from uwserver.packages import install_command
from uwserver.physics.collision import engine
from uwserver.physics.geometry.shapes import (
    BadSolid,
    Box,
    Capsule,
    ConvexHull,
    Cylinder,
    HalfSpace,
    Sphere,
    TriangleMesh,
)
from uwserver.scenario.solids import shapes
from uwserver.scenario.solids.shapes import (
    Materials,
    collision_solid,
    missing_engines,
    object_solid,
    seabed_solid,
    structure_solid,
)
from uwserver.scenario.solids.tables import Collision, Contact, ObjectEntry, Seabed, Structure

HALF = math.sqrt(0.5)


@pytest.fixture
def materials() -> Materials:
    return {}


def structure(materials: Materials, folder: Path = Path(), **keys: Any) -> Any:
    return structure_solid("it", msgspec.convert(keys, Structure), folder, materials, lambda text: None)


def test_materials_are_numbered_as_they_are_met(materials: Materials) -> None:
    solids = [structure(materials, kind="sphere", radius_m=1, material=name) for name in ("sand", "steel", "sand")]
    assert [solid.material for solid in solids] == [0, 1, 0]
    assert materials == {"sand": 0, "steel": 1}


@pytest.mark.parametrize(
    ("keys", "shape"),
    [
        ({"kind": "box", "size_m": [1, 2, 3]}, Box((0.5, 1.0, 1.5))),
        ({"kind": "sphere", "radius_m": 0.5}, Sphere(0.5)),
        ({"kind": "cylinder", "radius_m": 0.5, "length_m": 3}, Cylinder(0.5, 1.5)),
        ({"kind": "capsule", "radius_m": 0.5, "length_m": 3}, Capsule(0.5, 1.5)),
    ],
)
def test_structures_have_whole_edges_in_files_and_half_ones_here(keys: Any, shape: Any, materials: Materials) -> None:
    solid = structure(materials, **keys, position_ned_m=[1, 2, 3], attitude_rpy_deg=[0, 0, 90], friction=0.7)
    (placed,) = solid.shapes
    assert placed.shape == shape
    assert placed.p == (1.0, 2.0, 3.0)
    assert placed.q == pytest.approx((HALF, 0.0, 0.0, HALF))
    assert (solid.name, solid.friction, solid.restitution) == ("it", 0.7, 0.0)


@pytest.mark.parametrize(
    ("rpy", "q"),
    [([90, 0, 0], (HALF, HALF, 0, 0)), ([0, 90, 0], (HALF, 0, HALF, 0)), ([0, 0, -90], (HALF, 0, 0, -HALF))],
)
def test_angles_are_degrees_about_the_axes(rpy: list[float], q: Any, materials: Materials) -> None:
    (placed,) = structure(materials, kind="sphere", radius_m=1, attitude_rpy_deg=rpy).shapes
    assert placed.q == pytest.approx(q)


def test_a_flat_seabed_is_everything_below_its_depth(materials: Materials) -> None:
    table = msgspec.convert({"kind": "flat", "depth_m": 12.5, "material": "mud", "restitution": 0.2}, Seabed)
    solid = seabed_solid(table, Path(), None, materials)
    (placed,) = solid.shapes
    assert placed.shape == HalfSpace()
    assert (placed.p, placed.q) == ((0.0, 0.0, 12.5), (1.0, 0.0, 0.0, 0.0))
    assert (solid.name, [*materials][solid.material], solid.restitution) == ("seabed", "mud", 0.2)


def test_a_grid_lies_beside_the_file_that_names_it(tmp_path: Path, materials: Materials) -> None:
    (tmp_path / "sub").mkdir()
    np.save(tmp_path / "sub/g.npy", np.full((3, 3), 20.0))
    table = msgspec.convert({"kind": "grid", "file": "sub/g.npy", "spacing_m": [1, 1]}, Seabed)
    (placed,) = seabed_solid(table, tmp_path, None, materials).shapes
    assert isinstance(placed.shape, TriangleMesh)
    with pytest.raises(BadSolid, match="there is no grid file"):
        seabed_solid(table, tmp_path / "sub", None, materials)


@pytest.mark.parametrize(("kind", "type_"), [("mesh", TriangleMesh), ("hull", ConvexHull)])
def test_files_are_turned_and_scaled(kind: str, type_: type, tmp_path: Path, materials: Materials) -> None:
    import trimesh

    trimesh.creation.box((4.0, 2.0, 1.0)).export(tmp_path / "it.stl")
    (placed,) = structure(materials, tmp_path, kind=kind, file="it.stl", scale=0.5, up="y").shapes
    assert isinstance(placed.shape, type_)
    corners = placed.shape.vertices if isinstance(placed.shape, TriangleMesh) else placed.shape.points
    assert np.ptp(corners, axis=0) == pytest.approx([2.0, 0.5, 1.0])


def test_collision_shapes_sit_on_the_vehicle_and_share_its_surface(tmp_path: Path, materials: Materials) -> None:
    import trimesh

    trimesh.creation.box((0.4, 0.2, 0.1)).export(tmp_path / "body.stl")
    tables = msgspec.convert(
        {
            "frame": {"kind": "box", "size_m": [1, 1, 1], "center_frd_m": [0.1, 0, 0], "rpy_deg": [0, 90, 0]},
            "body": {"kind": "hull", "file": "body.stl"},
        },
        dict[str, Collision],
    )
    folders = {"frame": Path("/nowhere"), "body": tmp_path}
    contact = Contact(friction=0.2, restitution=0.1, material="foam")
    solid = collision_solid("rov", tables, contact, folders, materials, lambda text: None)
    frame, body = solid.shapes
    assert (frame.shape, frame.p) == (Box((0.5, 0.5, 0.5)), (0.1, 0.0, 0.0))
    assert frame.q == pytest.approx((HALF, 0.0, HALF, 0.0))
    assert isinstance(body.shape, ConvexHull)
    assert (solid.friction, solid.restitution, [*materials][solid.material]) == (0.2, 0.1, "foam")


def test_an_object_lies_in_its_own_frame(materials: Materials) -> None:
    keys = {"kind": "cylinder", "radius_m": 0.1, "length_m": 1, "mass_kg": 3, "position_ned_m": [5, 5, 5]}
    (placed,) = object_solid("crate", msgspec.convert(keys, ObjectEntry), materials).shapes
    assert placed.shape == Cylinder(0.1, 0.5)
    assert placed.p == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "keys", [{"kind": "sphere", "radius_m": 1e6}, {"kind": "box", "size_m": [1, 1, 1e6]}, {"kind": "capsule", "radius_m": 1, "length_m": 1e6}]
)  # fmt: skip
def test_what_would_crash_an_engine_is_refused(keys: dict[str, Any], materials: Materials) -> None:
    with pytest.raises(BadSolid, match="must be positive and below 100 km"):
        structure(materials, **keys)


def test_what_is_missing_is_named_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    assert missing_engines() is None
    gone = {"scipy"}
    monkeypatch.setattr(shapes, "find_spec", lambda name: None if name in gone else name)
    assert missing_engines() == f"solids need the package scipy: {install_command('uwserver[solid]')}"
    gone.clear()
    monkeypatch.setattr(engine, "find_spec", lambda name: None if name == "coal" else name)
    assert missing_engines() is None
    text = f'the engine "coal" needs coal: {install_command("coal")}, or choose engine = "bullet", which is installed'
    assert missing_engines("coal") == f"solids need an engine for contacts: {text}"
