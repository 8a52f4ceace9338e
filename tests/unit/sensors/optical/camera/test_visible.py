"""What is seen: looks in place of shapes, textures where they belong, things that are alike shared, far things in scenes of their own."""

from __future__ import annotations

import numpy as np
import pytest
from sensors.optical.camera.glb import glb, png
from sensors.optical.camera.rig import GREY, NOON, floor, seen, view

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.geometry.shapes import Box, Placed, Solid
from uwserver.sensors.optical.camera.lens import lens_of
from uwserver.sensors.optical.camera.picture import Optics
from uwserver.sensors.optical.camera.visible import Models, SceneCache, Visible, VisibleScene, VisibleThing

BOARD = png([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]])
BOX = Solid("box", (Placed(Box((0.5, 0.5, 0.5))),))


def test_looks_are_shown_in_place_of_the_shape_with_their_texture_the_right_way_round() -> None:
    """A board of four colours, which faces the camera: glTF's z looks to the west, so turn it."""
    q = quat_from_rpy(0.0, 0.0, np.pi / 2.0)
    board = VisibleThing("board", BOX, GREY, glb(BOARD), p=(3.0, 0.0, 13.0), R=np.array(matrix(q)))
    lens = lens_of((65, 65), 0.7)
    picture = (
        Optics(lens, None)
        .form(view(board, p=(0.0, 0.0, 10.0), day=NOON._replace(elevation=0.2, azimuth=np.pi)))
        .reshape(65, 65, 3)
    )
    quarters = [picture[16, 16], picture[16, 48], picture[48, 16], picture[48, 48]]
    assert [int(np.argmax(q)) for q in quarters[:3]] == [0, 1, 2]
    assert (quarters[3] > 0.0).all()
    # The factor of the material dims green and blue.
    np.testing.assert_allclose(quarters[3] / quarters[3][0], (1.0, 0.5, 0.25), rtol=0.1)


def test_bad_looks_are_told_and_the_shape_is_shown() -> None:
    cache = SceneCache(lambda: [VisibleThing("box", BOX, GREY, b"glTF" + bytes(60))], lambda: 0)
    assert cache.faults()[0].startswith("box: looks")
    assert len(cache.scene().made().faces) == 12


def test_what_is_alike_shares_its_scene_and_a_watch_looks_again_when_somebody_comes() -> None:
    here = [VisibleThing("a", BOX, GREY, row=0), VisibleThing("b", BOX, GREY, row=1)]
    cache = SceneCache(lambda: here, lambda: len(here))
    first = cache.scene()
    visible = first.made()
    assert visible.scenes[0].scene is visible.scenes[1].scene
    assert cache.scene() is first
    here.append(VisibleThing("c", BOX, GREY, row=2))
    assert cache.scene().made().names == ["", "a", "b", "c"]
    assert first.made() is visible


def test_far_things_stand_in_scenes_of_their_own_and_nothing_is_fine() -> None:
    made = VisibleScene(
        [
            seen("a", Box((1.0, 1.0, 1.0)), (0.0, 0.0, 0.0)),
            seen("b", Box((1.0, 1.0, 1.0)), (9000.0, 0.0, 0.0)),
            floor(5.0),
        ],
        Models(),
    ).made()
    assert sorted(placed.scene.centre[0] for placed in made.scenes) == [0.0, 9216.0]
    assert len(made.planes) == 1
    assert len(Visible([], Models()).faces) == 0
    assert np.abs(made.faces["corners"]).max() < 300.0


@pytest.mark.parametrize("row", [-1, 0])
def test_a_thing_without_any_shape_is_nothing(row: int) -> None:
    made = Visible([VisibleThing("ghost", None, GREY, row=row)], Models())
    assert (made.names, len(made.scenes)) == (["", "ghost"], 0)
