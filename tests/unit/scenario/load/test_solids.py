"""Solid things in scenario and vehicle files: what they become, and what is told of bad ones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.environment.earth import north_east
from uwserver.packages import install_command
from uwserver.physics.collision import engine
from uwserver.physics.collision.solids import Solids
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
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.solids.archive import pack, unpack
from uwserver.scenario.solids.objects import object_params
from uwserver.scenario.solids.tables import BoxObject, CylinderObject, SphereObject
from uwserver.scenario.world.tables import Environment

HEAD = 'schema = 1\n[vehicles.rov]\nmodel = "./tiny.toml"\nposition_ned_m = [0.0, 0.0, 5.0]\n'


@pytest.fixture
def loaded(write, files, adapters):
    """Loads a scenario with a tiny vehicle; more text for either file."""
    return lambda text, vehicle="": load(write(HEAD + text, files["tiny"] + vehicle), adapters=adapters)


@pytest.fixture
def problems(loaded):
    """All that is told of a scenario that does not load."""

    def told(text, vehicle=""):
        with pytest.raises(ScenarioError) as caught:
            loaded(text, vehicle)
        return "\n".join(str(p) for p in caught.value.problems)

    return told


def grid_depth(north, east):
    return 20.0 + 0.1 * north - 0.05 * east


@pytest.fixture
def slope(tmp_path):
    """A grid of 300 x 260 points, 2 m by 1 m, about the origin."""
    n, e = (np.arange(300) - 149.5) * 2.0, np.arange(260) - 129.5
    np.save(tmp_path / "slope.npy", grid_depth(n[:, None], e[None, :]))


# -- seabed -----------------------------------------------------------------------------------------------------------------------------


def test_flat_seabed_and_materials(loaded):
    resolved = loaded(
        '[seabed]\nkind = "flat"\ndepth_m = 12.0\nmaterial = "sand"\nfriction = 0.7\n'
        '[structures.wall]\nkind = "box"\nsize_m = [1, 2, 3]\nposition_ned_m = [5, 0, 11]\nattitude_rpy_deg = [0, 0, 90]\nmaterial = "steel"\n',
    )
    seabed, wall = resolved.static["seabed"], resolved.static["wall"]
    assert isinstance(seabed.shapes[0].shape, HalfSpace)
    assert seabed.shapes[0].p == (0.0, 0.0, 12.0)
    assert seabed.friction == 0.7
    assert wall.shapes[0].shape == Box((0.5, 1.0, 1.5))
    assert np.allclose(wall.shapes[0].q, [math.sqrt(0.5), 0, 0, math.sqrt(0.5)])
    assert [resolved.materials[s.material] for s in (seabed, wall)] == ["sand", "steel"]


def test_grid_in_metres_in_tiles_without_gaps(loaded, slope):
    text = '[seabed]\nkind = "grid"\nfile = "slope.npy"\nspacing_m = [2.0, 1.0]\n'
    meshes = [placed.shape for placed in loaded(text).static["seabed"].shapes]
    assert len(meshes) == 4
    assert all(len(mesh.faces) <= 100_000 for mesh in meshes)
    assert sum(len(mesh.faces) for mesh in meshes) == 2 * 299 * 259
    edges: dict[tuple[bytes, bytes], int] = {}
    for mesh in meshes:
        assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
        assert np.allclose(mesh.vertices[:, 2], grid_depth(mesh.vertices[:, 0], mesh.vertices[:, 1]))
        corners = mesh.vertices[mesh.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert (normal[:, 2] < 0.0).all()  # outside up
        for face in corners:
            for k in range(3):
                ends = face[k].tobytes(), face[(k + 1) % 3].tobytes()
                edges[ends] = edges.get(ends, 0) + 1
    # Every inner edge is run through once each way, by two triangles; only the outer border is open.
    open_edges = [pair for pair in edges if (pair[1], pair[0]) not in edges]
    assert max(edges.values()) == 1
    assert len(open_edges) == 2 * (299 + 259)


def test_grid_origin_extent_and_elevation(loaded, tmp_path):
    np.save(tmp_path / "g.npy", -np.arange(20.0).reshape(4, 5) - 30)
    keys = (
        'kind = "grid"\nfile = "g.npy"\nspacing_m = [10, 10]\norigin_north_east_m = [-10, -20]\nvalues = "elevation"\n'
    )
    (placed,) = loaded(f"[seabed]\n{keys}").static["seabed"].shapes
    assert placed.shape.vertices[0].tolist() == [-10.0, -20.0, 30.0]
    assert placed.shape.vertices[-1].tolist() == [20.0, 20.0, 49.0]
    (cut,) = loaded(f"[seabed]\n{keys}extent_m = 1.0").static["seabed"].shapes
    assert cut.shape.vertices[:, :2].min(axis=0).tolist() == [-10.0, -10.0]
    assert cut.shape.vertices[:, :2].max(axis=0).tolist() == [10.0, 10.0]


def write_netcdf(path, classic, lat, lon, elevation, names=("lat", "lon", "elevation")):
    if classic:
        from scipy.io import netcdf_file

        file = netcdf_file(str(path), "w")
    else:
        import h5netcdf.legacyapi

        file = h5netcdf.legacyapi.Dataset(path, "w")
    for name, values in zip(names[:2], (lat, lon), strict=True):
        file.createDimension(name, len(values))
        file.createVariable(name, "f8", (name,))[:] = values
    file.createVariable(names[2], "i2", names[:2])[:] = elevation
    file.close()


@pytest.mark.parametrize("classic", [True, False])
def test_netcdf_sits_where_its_latitude_and_longitude_are(loaded, tmp_path, classic):
    lat, lon = 63.4 + np.arange(-8, 9) / 240, 10.4 + np.arange(-10, 11) / 240  # 15 seconds of arc, as of GEBCO
    elevation = -(100 + np.arange(17)[:, None] * 3 + np.arange(21)[None, :]).astype(np.int16)
    write_netcdf(tmp_path / "g.nc", classic, lat[::-1], lon, elevation[::-1])
    text = '[world]\norigin_lat_deg = 63.4\norigin_lon_deg = 10.4\n[seabed]\nkind = "grid"\nfile = "g.nc"\n'
    (placed,) = loaded(text).static["seabed"].shapes
    points = placed.shape.vertices.reshape(17, 21, 3)
    assert np.array_equal(points[..., 2], -elevation)
    assert np.allclose(points[8, 10, :2], 0.0, atol=1e-6)
    step, latitude = math.radians(1 / 240), math.radians(63.4)
    meridian, across = radii(latitude)
    assert points[9, 10, 0] == pytest.approx(meridian * step, rel=1e-6)
    assert points[8, 11, 1] == pytest.approx(across * step * math.cos(latitude), rel=1e-6)
    text += "extent_m = 500\n"
    (near,) = loaded(text).static["seabed"].shapes
    assert 9 < len(near.shape.vertices) < 60
    assert np.abs(near.shape.vertices[:, :2]).max() >= 500


def radii(latitude):
    """Radii of curvature of WGS84, m: meridian and prime vertical."""
    a, e2 = 6_378_137.0, 6.69437999014e-3
    w = 1.0 - e2 * np.sin(latitude) ** 2
    return a * (1.0 - e2) / w**1.5, a / np.sqrt(w)


def test_tangent_plane_against_the_length_of_the_meridian():
    south, top = math.radians(45.0), math.radians(46.0)
    middles = south + (np.arange(2000) + 0.5) * (top - south) / 2000
    arc = radii(middles)[0].mean() * (top - south)
    north, east = north_east(np.array([top, south]), np.radians([7.0, 7.0]), south, math.radians(7.0))
    assert north[0] == pytest.approx(arc - arc**3 / (6 * 6.37e6**2), abs=0.1)
    assert abs(east[0]) < 1e-9
    assert abs(north[1]) < 1e-9
    _, east = north_east(np.array([0.0]), np.radians([-179.9]), 0.0, math.radians(180.0))
    assert east[0] == pytest.approx(6_378_137.0 * math.sin(math.radians(0.1)), abs=1e-4)


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ('file = "none.npy"\nspacing_m = [1, 1]', "there is no grid file"),
        ('file = "line.npy"\nspacing_m = [1, 1]', "rows and columns"),
        ('file = "thin.npy"\nspacing_m = [1, 1]', "at least 2 x 2"),
        ('file = "nan.npy"\nspacing_m = [1, 1]', "1 of 9 depths"),
        ('file = "words.npy"\nspacing_m = [1, 1]', "not an array in .npy format"),
        ('file = "good.npy"', "needs spacing_m"),
        ('file = "good.npy"\nspacing_m = [1, 0]', "greater than 0"),
        ('file = "good.tif"\nspacing_m = [1, 1]', "unknown file type"),
        ('file = "good.npy"\nspacing_m = [1, 1]\norigin_north_east_m = [900, 0]\nextent_m = 5', "no point of the grid"),
        ('file = "good.nc"', "origin_lat_deg"),
    ],
)
def test_bad_grids(problems, tmp_path, keys, text):
    good = np.full((3, 3), 30.0)
    for name, values in (("good", good), ("line", good[0]), ("thin", good[:1]), ("nan", good.copy())):
        np.save(tmp_path / f"{name}.npy", values)
    spoilt = good.copy()
    spoilt[1, 1] = np.nan
    np.save(tmp_path / "nan.npy", spoilt)
    (tmp_path / "words.npy").write_text("hello")
    (tmp_path / "good.tif").write_text("hello")
    (tmp_path / "good.nc").write_bytes(b"CDF")
    assert text in problems(f'[seabed]\nkind = "grid"\n{keys}\n')


@pytest.mark.parametrize("classic", [True, False])
@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"names": ("y", "x", "z")}, "no variable lat"),
        ({"lat": np.array([63.0, 63.2, 63.1])}, "must rise"),
        (None, "cannot read"),
    ],
)
def test_bad_netcdf(problems, tmp_path, classic, change, text):
    keys = {"lat": np.array([63.0, 63.1, 63.2]), "lon": np.array([10.0, 10.1, 10.2]), "elevation": np.full((3, 3), -9)}
    if change is None:
        (tmp_path / "g.nc").write_bytes(b"CDF\x01rubbish" if classic else b"\x89HDFrubbish")
    else:
        write_netcdf(tmp_path / "g.nc", classic, **(keys | change))
    world = "[world]\norigin_lat_deg = 63.1\norigin_lon_deg = 10.1\n"
    assert text in problems(f'{world}[seabed]\nkind = "grid"\nfile = "g.nc"\n')


def test_an_engine_that_is_not_installed_and_one_that_is_none(problems, monkeypatch):
    assert "engine" in problems('[world]\nengine = "odd"\n')
    monkeypatch.setattr(engine, "find_spec", lambda name: None if name == "coal" else name)
    told = problems('[world]\nengine = "coal"\n[seabed]\nkind = "flat"\ndepth_m = 5.0\n')
    assert (
        f'the engine "coal" needs coal: {install_command("coal")}, or choose engine = "bullet", which is installed'
        in told
    )


def test_half_an_origin(problems):
    assert "give both or none" in problems("[world]\norigin_lat_deg = 63.1\n")


# -- mesh files -------------------------------------------------------------------------------------------------------------------------


def wedge():
    """Two steps of a stair, not symmetric in any axis; x forward, z up."""
    import trimesh

    parts = [trimesh.creation.box((4, 2, 1)), trimesh.creation.box((2, 2, 1))]
    parts[1].apply_translation((1, 0, 1))
    return trimesh.util.concatenate(parts)


@pytest.mark.parametrize("suffix", ["glb", "obj", "stl", "ply"])
def test_mesh_files_are_turned_and_scaled(loaded, tmp_path, suffix):
    import trimesh

    mesh = wedge()
    if suffix == "glb":  # whose y is up
        mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    mesh.export(tmp_path / f"stair.{suffix}")
    resolved = loaded(
        f'[structures.stair]\nkind = "mesh"\nfile = "stair.{suffix}"\nscale = 2\nposition_ned_m = [30, 0, 9]\n'
    )
    (placed,) = resolved.static["stair"].shapes
    assert isinstance(placed.shape, TriangleMesh)
    assert placed.shape.oriented
    assert placed.p == (30.0, 0.0, 9.0)
    assert np.allclose(placed.shape.vertices.min(axis=0), [-4, -2, -3])
    assert np.allclose(placed.shape.vertices.max(axis=0), [4, 2, 1])
    assert len(placed.shape.vertices) == 14
    top = placed.shape.vertices[placed.shape.vertices[:, 2] < -2.9]
    assert top[:, 0].min() == pytest.approx(0.0)  # the upper step is at the front
    a, b, c = (placed.shape.vertices[placed.shape.faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", np.cross(a, b), c) / 6 == pytest.approx(8 * 12)  # outside out


def test_hull_of_a_file_and_a_simplified_one(loaded, tmp_path):
    import trimesh

    wedge().export(tmp_path / "stair.stl")
    trimesh.creation.icosphere(subdivisions=4).export(tmp_path / "ball.stl")
    vehicle = '[collision.body]\nkind = "hull"\nfile = "stair.stl"\nscale = 0.1\n[collision.ball]\nkind = "hull"\nfile = "ball.stl"\n'
    resolved = loaded("", vehicle)
    body, ball = (placed.shape for placed in resolved.vehicles["rov"].solid.shapes)
    assert isinstance(body, ConvexHull)
    assert len(body.points) == 10
    assert len(ball.points) <= 256
    assert "up to 0.0" in "".join(w.text for w in resolved.warnings)
    with Solids() as solids:
        solids.add_moving(resolved.vehicles["rov"].solid, 0)


def test_open_and_degenerate_meshes_are_told(loaded, tmp_path):
    (tmp_path / "sheet.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\n")
    resolved = loaded('[structures.sheet]\nkind = "mesh"\nfile = "sheet.obj"\nposition_ned_m = [9, 0, 0]\n')
    texts = "\n".join(w.text for w in resolved.warnings)
    assert "1 of 2 triangles have no area" in texts
    assert "not closed" in texts
    (placed,) = resolved.static["sheet"].shapes
    assert not placed.shape.oriented
    assert len(placed.shape.faces) == 1


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("none.obj", None, "cannot read"),
        ("a.step", "x", "unknown file type"),
        ("nan.obj", "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("empty.obj", "# nothing\n", "empty.obj"),
        ("points.obj", "v 0 0 0\nv 1 0 0\n", "points.obj"),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no triangle with an area"),
        ("bad.glb", "glTF rubbish", "is not a GLB"),
        ("bad.stl", "solid\nfacet rubbish", "bad.stl"),
        ("beyond.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "beyond.obj"),
    ],
)
def test_bad_mesh_files(problems, tmp_path, name, content, text):
    if content is not None:
        (tmp_path / name).write_text(content)
    found = problems(f'[structures.it]\nkind = "mesh"\nfile = "{name}"\n')
    assert text in found
    assert "structures.it" in found


def test_a_missing_texture_does_not_matter(loaded, tmp_path):
    text = wedge().export(file_type="obj")
    (tmp_path / "painted.obj").write_text("mtllib none.mtl\nusemtl gone\n" + text)
    assert (
        loaded('[structures.it]\nkind = "mesh"\nfile = "painted.obj"\nposition_ned_m = [30, 0, 0]\n')
        .static["it"]
        .shapes
    )


def test_large_meshes_are_cut_into_tiles(loaded, tmp_path):
    import trimesh

    trimesh.creation.icosphere(subdivisions=7).export(tmp_path / "ball.ply")  # 327 680 triangles
    (found,) = [loaded('[structures.it]\nkind = "mesh"\nfile = "ball.ply"\nposition_ned_m = [9, 0, 0]\n').static["it"]]
    sizes = [len(placed.shape.faces) for placed in found.shapes]
    assert sum(sizes) == 327_680
    assert max(sizes) <= 100_000


# -- places -----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        '[seabed]\nkind = "flat"\ndepth_m = 4.0',
        '[structures.it]\nkind = "box"\nsize_m = [2, 2, 2]\nposition_ned_m = [0.5, 0.5, 5.5]',
        '[structures.it]\nkind = "cylinder"\nradius_m = 1\nlength_m = 12\nattitude_rpy_deg = [0, 90, 0]',
        '[structures.it]\nkind = "mesh"\nfile = "stair.stl"\nposition_ned_m = [-1, 0, 6]',
        '[structures.it]\nkind = "hull"\nfile = "stair.stl"\nposition_ned_m = [0, 0, 5]',
    ],
)
def test_a_vehicle_inside_something_is_refused(problems, tmp_path, text):
    wedge().export(tmp_path / "stair.stl")
    if "stair" in text and "mesh" in text:
        text = text.replace("[-1, 0, 6]", "[0.5, 0, 5]")
    found = problems(text)
    assert "vehicles.rov.position_ned_m" in found
    assert "starts inside" in found


def test_a_vehicle_under_a_grid_is_refused_and_above_it_not(loaded, problems, slope):
    grid = '[seabed]\nkind = "grid"\nfile = "slope.npy"\nspacing_m = [2.0, 1.0]\n'
    loaded(grid)
    deep = grid + '[vehicles.low]\nmodel = "./tiny.toml"\nposition_ned_m = [100, 20, 29.5]\n'
    assert "29.00 m deep" in problems(deep)


# -- vehicles and objects ---------------------------------------------------------------------------------------------------------------


def test_collision_shapes_of_a_vehicle(loaded):
    vehicle = (
        '[contact]\nfriction = 0.3\nmaterial = "plastic"\n[collision.frame]\nkind = "box"\nsize_m = [0.4, 0.3, 0.2]\ncenter_frd_m = [0, 0, 0.1]\n'
        '[collision.tube]\nkind = "capsule"\nradius_m = 0.1\nlength_m = 0.5\nrpy_deg = [0, 0, 90]\n'
    )
    resolved = loaded("", vehicle)
    solid = resolved.vehicles["rov"].solid
    assert [placed.shape for placed in solid.shapes] == [Box((0.2, 0.15, 0.1)), Capsule(0.1, 0.25)]
    assert solid.shapes[0].p == (0.0, 0.0, 0.1)
    assert solid.friction == 0.3
    assert resolved.materials[solid.material] == "plastic"
    assert loaded("").vehicles["rov"].solid is None


def test_objects(loaded, problems):
    text = '[objects.crate]\nkind = "box"\nsize_m = [1, 1, 1]\ndensity_kgpm3 = 1100\nposition_ned_m = [2, 0, 5]\n'
    crate = loaded(text).objects["crate"]
    assert crate.params.weight == pytest.approx(1100 * 9.81)
    assert crate.params.buoyancy == pytest.approx(1025 * 9.81)
    assert crate.solid.shapes[0].shape == Box((0.5, 0.5, 0.5))
    assert "exactly one of" in problems(text + "mass_kg = 3\n")
    assert "exactly one of" in problems(text.replace("density_kgpm3 = 1100\n", ""))
    assert "taken" in problems(text.replace("crate", "rov"))


def test_added_mass_of_objects_in_closed_form():
    water = Environment(density_kgpm3=1000.0)
    ball = object_params(SphereObject(mass_kg=5.0, radius_m=0.2), water)
    assert np.allclose(np.diag(ball.M_A), [2 / 3 * np.pi * 1000 * 0.008] * 3 + [0.0] * 3)
    assert ball.D_Q[0, 0] == pytest.approx(0.5 * 1000 * 0.47 * np.pi * 0.04)
    cube = object_params(BoxObject(mass_kg=5.0, size_m=(0.5, 0.5, 0.5)), water)
    assert np.allclose(np.diag(cube.M_A)[:3], 0.68 * 1000 * 0.125)
    assert np.allclose(np.diag(cube.M_RB)[3:], 5.0 * 0.25 / 6)
    pipe = object_params(CylinderObject(mass_kg=5.0, radius_m=0.1, length_m=1.0), water)
    assert pipe.M_A[1, 1] == pytest.approx(0.90 * 1000 * np.pi * 0.01)  # length / diameter 5
    assert pipe.M_A[0, 0] < 0.2 * pipe.M_A[1, 1]
    for body in (ball, cube, pipe):
        assert (np.linalg.eigvalsh(body.M_A) >= 0.0).all()
        assert (np.diag(body.D_L) > 0.0).all()
        assert (np.diag(body.D_Q) > 0.0).all()


def test_an_archive_gives_the_same_bits() -> None:
    rng = np.random.default_rng(1)
    mesh = TriangleMesh(rng.normal(size=(30, 3)), rng.integers(0, 30, (20, 3)), oriented=False)
    shapes = (
        Box((1.0, 2.0, 3.0)),
        Sphere(0.1),
        Cylinder(0.2, 0.3),
        Capsule(0.2, 0.3),
        HalfSpace(),
        ConvexHull(mesh.vertices),
        mesh,
    )
    solids = {
        "a": Solid("a", tuple(Placed(s, (0.1, 1.0 / 3.0, 0.2), (0.6, 0.0, 0.8, 0.0), 2) for s in shapes), 0.7, 0.1, 3)
    }
    back = unpack(pack(solids))
    assert pack(back) == pack(solids)
    np.testing.assert_array_equal(back["a"].shapes[-1].shape.vertices, mesh.vertices)  # type: ignore[union-attr]
    assert back["a"].shapes[0] == solids["a"].shapes[0]


@pytest.mark.parametrize("text", ["", "!", "00000", pack({})[:-3] + "abc"])
def test_a_broken_archive_is_told(text: str) -> None:
    with pytest.raises(ValueError, match=r"cannot be read|base85|padding"):
        unpack(text)
