"""Mesh files: axes, units, repairs, what is refused, and tiles.

Sound files of every kind pass; tests/unit/scenario/load/test_hostile_files.py has those that declare wrong sizes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwserver.physics.geometry.shapes import HULL_POINTS, TILE_TRIANGLES, BadSolid
from uwserver.scenario.solids import assets
from uwserver.scenario.solids.assets import checked, is_closed, read_hull, read_mesh, tiles

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


@pytest.fixture
def file(tmp_path: Path) -> Callable[..., Path]:
    """Writes a mesh as an .obj file."""

    def write(vertices: Any, faces: Any, name: str = "it.obj") -> Path:
        lines = [f"v {x} {y} {z}" for x, y, z in np.asarray(vertices).tolist()]
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in np.asarray(faces).tolist()]
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


def volume(mesh: Any) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", np.cross(a, b), c)) / 6.0


# -- axes and units ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("up", "corner"),
    [("z", (1.0, -2.0, -3.0)), ("y", (1.0, 3.0, -2.0)), (None, (1.0, -2.0, -3.0))],
)
def test_the_axis_that_points_up_points_up_here(up: Any, corner: tuple[float, float, float], file) -> None:
    """A vertex at (1, 2, 3) of the file: x stays forward; down is what was not up."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 2, 3]])
    warned: list[str] = []
    (mesh,) = read_mesh(file(vertices, TETRAHEDRON), up, 1.0, warned.append)
    assert min(np.linalg.norm(mesh.vertices - np.array(corner), axis=1)) < 1e-12
    assert warned == []


def test_a_gltf_has_y_up_by_default(tmp_path: Path) -> None:
    import trimesh

    box = trimesh.creation.box((4.0, 2.0, 1.0))
    box.export(tmp_path / "it.glb")
    (mesh,) = read_mesh(tmp_path / "it.glb", None, 1.0, lambda text: None)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([4.0, 1.0, 2.0])
    (mesh,) = read_mesh(tmp_path / "it.glb", "z", 1.0, lambda text: None)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([4.0, 2.0, 1.0])


@pytest.mark.parametrize("scale", [1.0, 0.001, 25.4])
def test_units_become_metres(scale: float, file) -> None:
    (mesh,) = read_mesh(file(CORNERS, TETRAHEDRON), None, scale, lambda text: None)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([scale] * 3)
    assert volume(mesh) == pytest.approx(scale**3 / 6.0)


# -- mending ----------------------------------------------------------------------------------------------------------------------------


def test_a_closed_mesh_that_is_inside_out_is_turned(file) -> None:
    for faces in (TETRAHEDRON, TETRAHEDRON[:, ::-1]):
        (mesh,) = read_mesh(file(CORNERS, faces), None, 1.0, lambda text: None)
        assert mesh.oriented
        assert volume(mesh) == pytest.approx(1.0 / 6.0)


def test_an_open_one_is_a_sheet_and_told(file) -> None:
    warned: list[str] = []
    (mesh,) = read_mesh(file(CORNERS, TETRAHEDRON[:3]), None, 1.0, warned.append)
    assert not mesh.oriented
    (text,) = warned
    assert (
        text == '"it.obj" is not closed: it acts as a sheet without thickness, and bodies inside it are not pushed out'
    )


def test_triangles_without_area_are_dropped_and_counted(file) -> None:
    warned: list[str] = []
    vertices = np.concatenate([CORNERS, [[2.0, 0, 0], [3.0, 0, 0]]])
    faces = np.concatenate([TETRAHEDRON, [[0, 1, 4], [1, 4, 5]]])
    (mesh,) = read_mesh(file(vertices, faces), None, 1.0, warned.append)
    assert warned == ['"it.obj": 2 of 6 triangles have no area and are left out']
    assert len(mesh.faces) == 4
    assert mesh.oriented
    assert len(mesh.vertices) == 4, "vertices that no triangle uses go too"


@pytest.mark.parametrize(
    ("faces", "closed"),
    [
        (TETRAHEDRON, True),
        (TETRAHEDRON[:3], False),
        (np.concatenate([TETRAHEDRON, TETRAHEDRON + 4]), True),
        (np.concatenate([TETRAHEDRON[:3], TETRAHEDRON[3:, ::-1]]), False),
        (np.array([[0, 1, 2], [0, 2, 1]]), True),
    ],
)
def test_what_is_closed(faces: Any, closed: bool) -> None:
    """One face turned round makes an edge run twice the same way."""
    assert is_closed(faces) is closed


# -- refusals ---------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("read", [read_mesh, read_hull])
def test_what_cannot_be_read_is_refused(read: Any, file, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(path: Path) -> str:
        with pytest.raises(BadSolid) as caught:
            read(path, None, 1.0, lambda text: None)
        return str(caught.value)

    assert refused(tmp_path / "none.obj") == f'cannot read "{tmp_path / "none.obj"}": No such file or directory'
    assert refused(tmp_path / "a.step") == '"a.step" has an unknown file type: use .glb, .gltf, .obj, .stl, .ply'
    (tmp_path / "bad.stl").write_bytes(b"\0" * 90)
    assert "bad.stl" in refused(tmp_path / "bad.stl")
    good = file(CORNERS, TETRAHEDRON)
    monkeypatch.setattr(assets, "MOST_TRIANGLES", 3)
    assert refused(good) == '"it.obj" has 4 triangles; at most 3 are allowed: simplify it'
    monkeypatch.setattr(assets, "MOST_BYTES", 10)
    assert refused(good) == f'cannot read "{good}": it has {good.stat().st_size} bytes; at most 10 are allowed'


def test_the_suffix_may_be_in_capitals(file) -> None:
    assert read_mesh(file(CORNERS, TETRAHEDRON, "IT.OBJ"), None, 1.0, lambda text: None)


def test_vertices_that_are_not_finite_are_counted(file) -> None:
    with pytest.raises(BadSolid, match=r'1 vertices of "it\.obj" are not finite: repair the file'):
        read_mesh(file(np.where(CORNERS == 1.0, [[np.nan, 1, 1]], CORNERS), TETRAHEDRON), None, 1.0, lambda text: None)


# -- hulls ------------------------------------------------------------------------------------------------------------------------------


def test_a_hull_has_the_outer_corners_only(file) -> None:
    inner = np.concatenate([CORNERS, [[0.1, 0.1, 0.1]]])
    hull = read_hull(file(inner, np.concatenate([TETRAHEDRON, [[0, 1, 4]]])), None, 2.0, lambda text: None)
    assert len(hull.points) == 4
    assert np.ptp(hull.points, axis=0) == pytest.approx([2.0] * 3)


def test_a_hull_of_many_corners_is_simplified_and_says_how_much_is_lost(tmp_path: Path) -> None:
    import trimesh

    trimesh.creation.icosphere(subdivisions=4).export(tmp_path / "ball.stl")
    warned: list[str] = []
    hull = read_hull(tmp_path / "ball.stl", None, 1.0, warned.append)
    assert 200 < len(hull.points) <= HULL_POINTS
    assert np.linalg.norm(hull.points, axis=1) == pytest.approx(np.ones(len(hull.points)), abs=1e-6)
    (text,) = warned
    assert text.startswith(f'the hull of "ball.stl" is simplified from 2562 to {len(hull.points)} corners: up to ')
    assert 0.0 < float(text.split("up to ")[1].split()[0]) < 0.03


def test_points_of_a_plane_have_no_hull(file) -> None:
    flat = CORNERS * [1, 1, 0]
    flat[3] = [1, 1, 0]
    with pytest.raises(BadSolid, match=r'the points of "it\.obj" span no volume'):
        read_hull(file(flat, [[0, 1, 3], [0, 3, 2]]), None, 1.0, lambda text: None)


# -- tiles ------------------------------------------------------------------------------------------------------------------------------


def test_a_small_mesh_stays_whole() -> None:
    (mesh,) = tiles(CORNERS, TETRAHEDRON, True)
    assert (mesh.vertices == CORNERS).all()
    assert (mesh.faces == TETRAHEDRON).all()


def test_a_large_mesh_is_halved_along_its_longest_axis(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assets, "TILE_TRIANGLES", 100)
    x, y = np.meshgrid(np.arange(41.0), np.arange(5.0), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
    k = np.arange(41 * 5).reshape(41, 5)
    a, b, c, d = (part.ravel() for part in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    found = tiles(vertices, faces, False)
    assert [len(tile.faces) for tile in found] == [80] * 4
    assert sum(len(tile.faces) for tile in found) == len(faces)
    assert [float(np.ptp(tile.vertices[:, 0])) for tile in found] == pytest.approx([10.0] * 4, abs=1.01)
    assert all(float(np.ptp(tile.vertices[:, 1])) == 4.0 for tile in found)
    triangles = {tuple(map(tuple, t)) for tile in found for t in tile.vertices[tile.faces].tolist()}
    assert triangles == {tuple(map(tuple, t)) for t in vertices[faces].tolist()}
    assert not any(tile.oriented for tile in found)
    assert TILE_TRIANGLES >= 100


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply", "ply_ascii", "obj", "glb", "gltf"])
def test_a_sound_file_is_read_and_counted(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import trimesh

    box = trimesh.creation.box((4.0, 2.0, 1.0))
    path = tmp_path / f"box.{kind.partition('_')[0]}"
    if kind == "gltf":
        for name, data in box.export(file_type="gltf").items():
            (tmp_path / name).write_bytes(data)
        path = tmp_path / "model.gltf"
    elif kind == "ply_ascii":
        path.write_bytes(box.export(file_type="ply", encoding="ascii"))
    else:
        box.export(path, file_type=kind)
    (mesh,) = read_mesh(path, "z", 1.0, lambda text: None)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([4.0, 2.0, 1.0])
    assert len(mesh.faces) == 12
    monkeypatch.setattr(assets, "MOST_TRIANGLES", 11)
    with pytest.raises(BadSolid, match=r"12 triangles; at most 11 are allowed: simplify it"):
        checked(path, path.read_bytes())


def test_an_stl_text_with_a_name_of_another_encoding_is_read(tmp_path: Path) -> None:
    import trimesh

    text = trimesh.creation.box((4.0, 2.0, 1.0)).export(file_type="stl_ascii").replace("solid", "solid B\xf6je", 1)
    (tmp_path / "a.stl").write_bytes(text.encode("latin-1"))
    (mesh,) = read_mesh(tmp_path / "a.stl", "z", 1.0, lambda text: None)
    assert len(mesh.faces) == 12
