"""What cameras see of a scenario: everything that is in it and in the world, and nothing is loaded where there is no camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from uwserver.adapter import installed_adapters
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.solids.appearance import COATS
from uwserver.sensors import CameraConfig
from uwserver.sensors.optical.camera.faces import GROWTH, PLAIN, SEABED, TILES
from uwserver.world import World

CAMERA = """
[vehicles.rov.sensors.cam]
kind = "camera"
rate_hz = 10
width = 32
height = 24
mode = "segmentation"
latency_s = 0.0
"""
SCENARIO = """schema = 1
[world]
rate_hz = 240
[seabed]
kind = "flat"
depth_m = 9.0
material = "mud"
[structures.pile]
kind = "box"
size_m = [1.0, 1.0, 4.0]
position_ned_m = [3.0, 0.0, 7.0]
{looks}
[objects.crate]
kind = "box"
size_m = [0.5, 0.5, 0.5]
density_kgpm3 = 1025
position_ned_m = [2.0, 0.6, 5.0]
[vehicles.rov]
model = "bluerov2"
position_ned_m = [0.0, 0.0, 5.0]
[vehicles.rov.override.actuators.lights]
level = 0.5
"""


def made(folder: Path, text: str, looks: str = "") -> World:
    (folder / "s.toml").write_text(text.format(looks=looks), encoding="utf-8")
    return build(load(folder / "s.toml", adapters={}))


def test_all_things_with_the_colours_that_viewers_know(tmp_path: Path) -> None:
    world = made(tmp_path, SCENARIO + CAMERA)
    assert world.sight is not None
    visible = world.sight.scene().made()
    assert visible.names == ["", "seabed", "pile", "rov", "crate"]
    assert visible.faces["colour"][visible.planes[0].face].tolist() == pytest.approx([0.19, 0.16, 0.12])
    assert sorted(set(visible.rows.tolist())) == [-1, 0, 1]


def test_who_comes_is_seen_and_who_goes_is_not(tmp_path: Path) -> None:
    world = made(tmp_path, SCENARIO + CAMERA)
    assert world.sight is not None
    population: Any = world.population
    population.spawn("second", "crate", (2.0, -0.6, 5.0), (1.0, 0.0, 0.0, 0.0))
    assert "second" in world.sight.scene().made().names
    population.remove("crate")
    names = world.sight.scene().made().names
    assert "crate" not in names
    assert "second" in names
    seen = [sample for _ in range(60) for sample in world.step() if sample.port == "rov/cam"][-1].value[1]
    assert "second" in seen
    assert "crate" not in seen


def test_lamps_shine_as_their_actuators_have_them(tmp_path: Path) -> None:
    world = made(tmp_path, SCENARIO + CAMERA)
    assert world.sight is not None
    assert [lamp.lumens for lamp in world.sight.lamps()] == [750.0, 750.0]
    world.command("rov/lights", levels=(0.0, 1.0))
    world.step()
    assert [lamp.lumens for lamp in world.sight.lamps()] == [1500.0]


def test_without_a_camera_nothing_is_there(tmp_path: Path) -> None:
    assert made(tmp_path, SCENARIO).sight is None


def test_looks_that_cannot_be_shown_are_told_once_at_the_start(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    from sensors.optical.camera.glb import glb

    (tmp_path / "pile.glb").write_bytes(glb(b"no picture"))
    made(tmp_path, SCENARIO + CAMERA, 'looks = "pile.glb"')
    assert [record.message for record in caplog.records if "pile" in record.message] == [
        next(record.message for record in caplog.records if "no PNG or JPEG" in record.message)
    ]


def test_what_is_painted_on_things_follows_their_material() -> None:
    """The pool that is shipped has tiles on its floor and walls, and neither sand nor growth anywhere; its water is as clear as that of the sea."""
    resolved = load("pool_inspection", adapters=installed_adapters())
    sensors: Any = resolved.vehicles["bluerov2"].vehicle.sensors
    sensors["cam"] = CameraConfig(rate_hz=10, width=32, height=24)
    world = build(resolved)
    assert world.sight is not None
    assert resolved.scenario.environment.water_type == "I"
    visible = world.sight.scene().made()
    of = {name: number for number, name in enumerate(visible.names)}
    patterns = {
        name: {int(p) for p in visible.faces["pattern"][visible.ids[visible.faces["thing"]] == number]}
        for name, number in of.items()
    }
    assert patterns["seabed"] == patterns["north_wall"] == {TILES}
    assert patterns["panel"] == patterns["pipe"] == patterns["panel_west_post"] == {PLAIN}
    panel = visible.faces["colour"][visible.ids[visible.faces["thing"]] == of["panel"]]
    assert panel[0].tolist() == pytest.approx(COATS["paint"])


def test_in_the_sea_there_is_sand_and_growth(tmp_path: Path) -> None:
    world = made(tmp_path, SCENARIO + CAMERA)
    assert world.sight is not None
    visible = world.sight.scene().made()
    of = visible.ids[visible.faces["thing"]]
    assert set(visible.faces["pattern"][of == visible.names.index("seabed")].tolist()) == {SEABED}
    assert set(visible.faces["pattern"][of == visible.names.index("pile")].tolist()) == {GROWTH}
