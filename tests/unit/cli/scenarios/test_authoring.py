from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from uwserver.cli import main
from uwserver.scenario.files.documents import shipped
from uwserver.scenario.load.scenario import load

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

BOX = (0.6, 0.4, 0.3)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(name: str, *arguments: str) -> Result:
    return CliRunner().invoke(main, [name, *arguments])


def stl(path: Path, scale: float = 1.0, faces: int = 12) -> Path:
    """A box as a CAD program would export it; with fewer faces it is open."""
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * BOX * scale
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))][:faces]
    body = b"".join(struct.pack("<12fH", *(0.0,) * 3, *corners[list(t)].ravel(), 0) for t in triangles)
    path.write_bytes(b"".ljust(80) + struct.pack("<I", len(triangles)) + body)
    return path


def problems(folder: Path, vehicle: str) -> list[str]:
    (folder / "try.toml").write_text(
        f'schema = 1\n[vehicles.v]\nmodel = "{vehicle}"\nposition_ned_m = [0.0, 0.0, 5.0]\n'
    )
    return [str(warning) for warning in load(folder / "try.toml", adapters={}).warnings]


@pytest.mark.parametrize("vehicle", list(shipped("vehicles")))
def test_a_new_scenario_is_right(vehicle: str, folder: Path) -> None:
    assert run("new", "pond", "--vehicle", vehicle).exit_code == 0
    text = (folder / "pond.toml").read_text()
    assert "#" in text
    tables = tomllib.loads(text)
    tables["adapters"] = {}
    assert tables["vehicles"]["rov"]["model"] == vehicle
    again = run("new", "pond.toml")
    assert again.exit_code == 1
    assert "pond.toml exists already" in again.stderr


@pytest.mark.parametrize("vehicle", list(shipped("vehicles")))
def test_a_new_vehicle_is_another_one_under_its_own_name(vehicle: str, folder: Path) -> None:
    done = run("new", "--vehicle", "mine", "--from", vehicle)
    assert done.exit_code == 0, done.output
    mine, other = (tomllib.loads(p.read_text()) for p in (folder / "mine.toml", shipped("vehicles")[vehicle]))
    assert mine.pop("name") == "mine"
    assert vehicle in mine.pop("description")
    differ = {key for key in {*mine, *other} if mine.get(key) != other.get(key)}
    assert differ <= {"name", "description", "published"}
    assert "published" not in mine
    problems(folder, "mine.toml")


def test_a_new_vehicle_has_the_hull_of_its_mesh(folder: Path) -> None:
    stl(folder / "hull.stl", scale=1000.0)
    done = run(
        "new",
        "--vehicle",
        "crab",
        "--from",
        "bluerov2",
        "--mesh",
        "hull.stl",
        "--scale",
        "0.001",
        "--mass",
        "72",
    )
    assert done.exit_code == 0, done.output
    assert "0.6 x 0.4 x 0.3 m" in done.output
    crab = tomllib.loads((folder / "crab.toml").read_text())
    base = tomllib.loads(shipped("vehicles")["bluerov2"].read_text())
    assert crab["buoyancy"]["volume_m3"] == pytest.approx(np.prod(BOX))
    assert crab["rigid_body"]["mass_kg"] == 72.0
    x, y, z = np.square(BOX)
    assert np.diag(crab["rigid_body"]["inertia_matrix_kgm2"]) == pytest.approx(
        72.0 / 12.0 * np.array([y + z, z + x, x + y]), rel=1e-5
    )
    # The file's origin is a lower corner, aft to starboard, as y of CAD is to port; the centre of gravity lies 0.03 m below the middle.
    assert crab["collision"]["hull"]["center_frd_m"] == pytest.approx([-0.3, 0.2, 0.15 - 0.03], abs=1e-6)
    assert crab["buoyancy"]["center_frd_m"] == pytest.approx([0.0, 0.0, -0.03], abs=1e-6)
    for group in (crab["added_mass"], *(crab["damping"][k] for k in ("linear", "quadratic", "speed"))):
        assert group["status"] == "guess"
        assert len(group["source"]) > 30
    assert (crab["thrusters"], crab["sensors"]) == (base["thrusters"], base["sensors"])
    assert problems(folder, "crab.toml") == []


def test_without_a_mass_it_is_neutral_in_sea_water(folder: Path) -> None:
    stl(folder / "hull.stl")
    assert run("new", "--vehicle", "crab", "--mesh", "hull.stl").exit_code == 0
    crab = tomllib.loads((folder / "crab.toml").read_text())
    assert crab["rigid_body"]["mass_kg"] == pytest.approx(1025.0 * np.prod(BOX))
    assert crab["rigid_body"]["status"] == "guess"
    assert problems(folder, "crab.toml") == []


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("../x",), "begin with a letter"),
        (("x", "--vehicle", "bluerov3"), "did you mean"),
        ((), "give NAME for a scenario, or --vehicle NAME"),
        (("x", "--mesh", "hull.stl"), "--mesh is of a vehicle file: leave NAME out"),
        (("--vehicle", "../x"), "begin with a letter"),
        (("--vehicle", "x", "--from", "bluerov3"), "did you mean"),
        (("--vehicle", "x", "--mass", "3"), "--mass is of a mesh"),
        (("--vehicle", "x", "--mesh", "none.stl"), "none.stl"),
        (("--vehicle", "x", "--mesh", "open.stl"), "is not closed, so it has no volume"),
        (
            ("--vehicle", "x", "--mesh", "mm.stl"),
            "600 m long, 400 m wide and 300 m high, unlike any vehicle: give the unit",
        ),
        (("--vehicle", "x", "--mesh", "mm.stl", "--scale", "0"), "--scale"),
    ],
)
def test_new_refuses(arguments: tuple[str, ...], text: str, folder: Path) -> None:
    stl(folder / "open.stl", faces=11)
    stl(folder / "mm.stl", scale=1000.0)
    before = set(folder.iterdir())
    result = run("new", *arguments)
    assert result.exit_code == 2
    assert text in " ".join(result.stderr.split()), result.stderr
    assert set(folder.iterdir()) == before


@pytest.mark.parametrize("folder_name", ["", "vehicles", "devices"])
def test_every_shipped_file_is_shown_and_copied_as_it_is(folder_name: str, folder: Path) -> None:
    for name, path in shipped(folder_name).items():
        text = path.read_text(encoding="utf-8")
        assert run("show", name).stdout == text
        assert run("copy", name).exit_code == 0
        assert (folder / f"{name}.toml").read_text(encoding="utf-8") == text


def test_a_copy_has_the_name_that_is_asked_for_and_overwrites_nothing(folder: Path) -> None:
    done = run("copy", "t200", "--as", "mine")
    assert "wrote mine.toml, a device" in done.stdout
    again = run("copy", "t200", "--as", "mine.toml")
    assert again.exit_code == 1
    assert "mine.toml exists already" in again.stderr
    assert [path.name for path in folder.iterdir()] == ["mine.toml"]


def test_an_unknown_name_is_told_with_what_was_meant(folder: Path) -> None:
    for command in ("show", "copy"):
        result = run(command, "bluerov3")
        assert result.exit_code == 2
        assert 'did you mean "bluerov2"' in " ".join(result.stderr.split())
