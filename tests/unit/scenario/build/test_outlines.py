"""What a training knows of its scenario: boxes around structures, the tilt of its camera, what hides what; and what is told of wrong keys."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, HalfSpace, Placed, Solid, Sphere
from uwserver.scenario.build.members import outline_of
from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.world import World

EAST = quat_from_rpy(0.0, 0.0, math.pi / 2)
POINTS = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 6.0]])
SCENARIO = """schema = 1
[world]
rate_hz = 240
[seabed]
kind = "flat"
depth_m = 9.0
[structures.bar]
kind = "box"
size_m = [0.2, 0.2, 0.8]
position_ned_m = [2.0, 0.0, 5.0]
[structures.bar_behind]
kind = "box"
size_m = [0.2, 0.2, 0.8]
position_ned_m = [2.6, 0.0, 5.0]
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, {depth}]
[vehicles.rov.sensors.training]
kind = "training"
mount = "camera"
rate_hz = 60
[vehicles.rov.sensors.training.tasks.look]
kind = "inspect"
structures = {structures}
"""


@pytest.mark.parametrize(
    ("shape", "half"),
    [
        (Box((1.0, 2.0, 3.0)), (1.0, 2.0, 3.0)),
        (Sphere(0.5), (0.5, 0.5, 0.5)),
        (Cylinder(0.5, 2.0), (2.0, 0.5, 0.5)),
        (Capsule(0.5, 2.0), (2.5, 0.5, 0.5)),
    ],
)
def test_the_box_around_a_structure_lies_along_it(
    shape: Box | Sphere | Cylinder | Capsule, half: tuple[float, ...]
) -> None:
    outline = outline_of(Solid("thing", (Placed(shape, (7.0, 8.0, 9.0), EAST),)))
    assert (outline.p, outline.q, outline.half) == (pytest.approx((7.0, 8.0, 9.0)), EAST, pytest.approx(half))


def test_the_box_around_a_hull_has_a_middle_of_its_own() -> None:
    outline = outline_of(Solid("thing", (Placed(ConvexHull(POINTS), (7.0, 8.0, 9.0), EAST),)))
    assert outline.half == pytest.approx((1.0, 2.0, 3.0))
    assert outline.p == pytest.approx((7.0 - 2.0, 8.0 + 1.0, 9.0 + 3.0))  # its x is east


def test_a_seabed_without_end_has_no_box() -> None:
    with pytest.raises(TypeError, match="a structure cannot have the shape HalfSpace"):
        outline_of(Solid("seabed", (Placed(HalfSpace()),)))


def made(folder: Path, structures: str, depth: float = 5.0) -> World:
    file = folder / "s.toml"
    file.write_text(SCENARIO.format(structures=structures, depth=depth), encoding="utf-8")
    return build(load(file, adapters={}))


def test_it_looks_out_of_its_own_hull_and_one_bar_hides_the_other(tmp_path: Path) -> None:
    world = made(tmp_path, '["bar", "bar_behind"]')
    world.step(4)
    told = world.read("rov/training")
    assert (told.hint, *told.goal_p_NB) == ("keep looking", 2.0, 0.0, 5.0)
    behind = made(tmp_path, '["bar_behind"]')
    behind.step(4)
    assert behind.read("rov/training").hint == "it is hidden: go round"


def test_it_tilts_with_its_mount(tmp_path: Path) -> None:
    world = made(tmp_path, '["bar"]', depth=3.6)  # it is 38 degrees below the camera
    world.step(4)
    assert world.read("rov/training").hint == "turn the camera to it"
    world.command("rov/camera_tilt", tilt=-0.6)
    world.step(4)
    assert world.read("rov/training").hint == "keep looking"


@pytest.mark.parametrize(
    ("structures", "key", "text"),
    [
        ('["bar", "bat"]', "tasks.look.structures[1]", 'no structure "bat" (did you mean "bar"?)'),
        ('["xyz"]', "tasks.look.structures[0]", 'no structure "xyz"; there are: bar, bar_behind'),
        ("[]", "tasks.look.structures", "1"),
        ('["bar", "bar"]', "tasks.look", '"bar" is named twice'),
        ('["bar"]\nclose_m = 3', "tasks.look", 'unknown key "close_m"'),
    ],
)
def test_wrong_keys_are_told_with_their_place(tmp_path: Path, structures: str, key: str, text: str) -> None:
    with pytest.raises(ScenarioError) as raised:
        made(tmp_path, structures)
    (problem,) = raised.value.problems
    assert problem.path == f"vehicles.rov.sensors.training.{key}"
    assert problem.line > 0
    assert text in problem.text
