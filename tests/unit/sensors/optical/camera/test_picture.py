"""Whole pictures: depth, who is seen, where light comes from, and what the water leaves of it. Also of uwserver.sensors.optical.camera.formation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from sensors.optical.camera.rig import CLEAR, DARK, NOON, floor, seen, view, wall

from uwserver.environment.light import WATER_TYPES, Daylight, WaterLight
from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.shapes import Box, Sphere, TriangleMesh
from uwserver.sensors.optical.camera.faces import Paint
from uwserver.sensors.optical.camera.lamps import LampAt
from uwserver.sensors.optical.camera.lens import FlatPort, lens_of
from uwserver.sensors.optical.camera.picture import Optics
from uwserver.sensors.optical.camera.rays import Buffers, Placed
from uwserver.sensors.optical.camera.view import Pose

LENS = lens_of((64, 48), 1.2)
MIDDLE = 24 * 64 + 32


def test_depth_of_a_slanted_plane_is_exact_to_a_millimetre() -> None:
    """A floor seen under 30 degrees: z-depth in closed form."""
    tilt, above = 0.5, 7.0
    optics = Optics(LENS, None)
    depth = optics.depth_mm(view(floor(10.0 + above), q=quat_from_rpy(0.0, -tilt, 0.0)))
    rows = np.arange(48)
    y = (rows - LENS.cy) / LENS.fy
    down = math.sin(tilt) + y * math.cos(tilt)  # of a ray with one metre of z-depth
    expected = np.where(down > 0.0, 1e3 * above / np.where(down > 0.0, down, 1.0), 0.0)
    expected[expected >= 65535.5] = 0.0
    assert np.abs(depth - expected[:, None]).max() <= 0.51
    assert (depth > 0).any()


def test_depth_of_a_mesh_far_from_the_origin_is_exact_to_a_millimetre() -> None:
    p = (40_000.0, -70_000.0, 10.0)
    box = seen("box", Box((0.5, 5.0, 5.0)), (p[0] + 3.25, p[1], p[2]))
    depth = Optics(LENS, None).depth_mm(view(box, p=p))
    assert np.abs(depth[24].astype(float) - 2750.0).max() <= 1.0


def test_depth_behind_a_flat_port_counts_from_the_pupil() -> None:
    depth = Optics(LENS, FlatPort(distance_m=0.02, thickness_m=0.01)).depth_mm(view(wall(2.0)))
    assert np.abs(depth.astype(float) - 2000.0).max() <= 1.0


def test_ids_and_shares_of_what_stands_before_something_else() -> None:
    near, far = (
        seen("near", Box((0.1, 0.2, 5.0)), (2.0, 0.0, 10.0)),
        seen("far", Box((0.1, 0.8, 5.0)), (4.0, 0.0, 10.0)),
    )
    ids, counts = Optics(LENS, None).ids(view(near, far, floor(30.0)))
    assert ids[24, 32] == 1
    assert set(np.unique(ids)) == {0, 1, 2, 3}
    assert counts[1, 0] == counts[1, 1] > 0  # nothing hides it
    assert 0 < counts[2, 0] < counts[2, 1]
    # Alone it is twice as wide as the near one: 0.8 / 3.9 against 0.2 / 1.9.
    assert counts[2, 1] == pytest.approx(2.0 * counts[1, 1], rel=0.1)


def test_a_grey_card_fades_as_the_beam_does() -> None:
    """Light of a lamp that is far from both, so that only the way to the camera counts: exp(-c r) within 1 %."""
    attenuation = (0.5, 0.25, 0.1)
    optics = Optics(LENS, None)
    found = []
    for r in (1.0, 2.5, 6.0):
        water = WaterLight(attenuation, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        found.append(optics.form(view(wall(r), water=water, day=Daylight(10_000.0, 0.3, math.pi, 0.0)))[MIDDLE].copy())
    clear = optics.form(view(wall(1.0), day=Daylight(10_000.0, 0.3, math.pi, 0.0)))[MIDDLE].copy()
    for r, light in zip((1.0, 2.5, 6.0), found, strict=True):
        np.testing.assert_allclose(light / clear, np.exp(-np.array(attenuation) * r), rtol=0.01)


def test_daylight_falls_with_depth_and_lights_a_card_as_lambert_says() -> None:
    """Straight from above on a floor: E albedo / pi, of what enters, times exp(-K_d z); no colour is scattered."""
    water = WaterLight((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.4, 0.1, 0.05))
    down = quat_from_rpy(0.0, -0.5 * math.pi, 0.0)
    light = Optics(LENS, None).form(view(floor(22.0), p=(0.0, 0.0, 20.0), q=down, water=water, day=NOON))[MIDDLE]
    entered = 1.0 - (0.34 / 2.34) ** 2
    expected = 50_000.0 * entered * np.exp(-22.0 * np.array(water.fading)) * 0.5 / math.pi
    np.testing.assert_allclose(light, expected, rtol=0.01)


def test_water_without_end_has_the_colour_of_its_glow() -> None:
    """Level: L = glow E / c, of the light at that depth."""
    water = WATER_TYPES["II"]
    light = Optics(LENS, None).form(view(p=(0.0, 0.0, 5.0), water=water, day=NOON))
    row = light.reshape(48, 64, 3)[23:25].mean(axis=(0, 1))
    entered = 1.0 - (0.34 / 2.34) ** 2
    expected = (
        50_000.0
        * entered
        * np.exp(-5.0 * np.array(water.fading))
        * np.array(water.glow())
        / np.array(water.attenuation)
    )
    np.testing.assert_allclose(row, expected, rtol=0.03)


def lamp(x: float, y: float, lumens: float = 1000.0, row: int = 0) -> LampAt:
    return LampAt(row, (x, y, 0.0), (1.0, 0.0, 0.0, 0.0), 2.0 * math.acos(0.5), lumens)


def test_a_lamp_lights_by_its_cone_and_the_inverse_square() -> None:
    """Half the intensity at 60 degrees is cos^1: I = lumens / pi on the axis."""
    optics, bodies = Optics(LENS, None), [(0.0, 0.0, 10.0, 1.0)]
    near = optics.form(view(wall(2.0), bodies=bodies, lamps=(lamp(0.0, 0.0),)))[MIDDLE].copy()
    far = optics.form(view(wall(4.0), bodies=bodies, lamps=(lamp(0.0, 0.0),)))[MIDDLE].copy()
    np.testing.assert_allclose(near, 1000.0 / math.pi / 4.0 * 0.5 / math.pi, rtol=0.01)
    np.testing.assert_allclose(near / far, 4.0, rtol=0.01)


def test_light_of_a_lamp_keeps_what_is_scattered_forward_on_the_way_out_but_not_back() -> None:
    """What a wall sends back over a black one, 3 m away: a + b (1 - g) to it, c from it."""
    water = WaterLight((0.30,) * 3, (0.25,) * 3, (0.08,) * 3)
    scene = {"bodies": [(0.0, 0.0, 10.0, 1.0)], "lamps": (lamp(0.0, 0.0),), "water": water}
    grey, black = (
        Optics(LENS, None)
        .form(view(seen("wall", Box((0.1, 50.0, 50.0)), (3.1, 0.0, 0.0), paint=Paint([(albedo,) * 3])), **scene))[
            MIDDLE
        ]
        .copy()
        for albedo in (0.5, 0.0)
    )
    way = math.exp(-3.0 * (0.05 + 0.25 * (1.0 - 0.924)) - 3.0 * 0.30)
    np.testing.assert_allclose(grey - black, 1000.0 / math.pi / 9.0 * 0.5 / math.pi * way, rtol=0.01)


def test_a_lamp_throws_a_shadow_that_can_be_left_out() -> None:
    post = seen("post", Box((0.05, 0.15, 5.0)), (2.0, 0.55, 10.0))
    optics, bodies = Optics(LENS, None), [(0.0, 0.0, 10.0, 1.0)]
    scene = {"bodies": bodies, "lamps": (lamp(0.0, 1.1),)}
    with_shadow = optics.form(view(wall(4.0), post, **scene)).reshape(48, 64, 3)[24, :, 1].copy()
    without = optics.form(view(wall(4.0), post, **scene), shadows=False).reshape(48, 64, 3)[24, :, 1].copy()
    # From y = 1.1 past the post at (2, 0.55) to the middle of the wall.
    assert with_shadow[32] == 0.0 < without[32]
    np.testing.assert_allclose(with_shadow[:16], without[:16], rtol=1e-6)


def test_the_own_vehicle_hides_neither_view_nor_lamps_but_shows_what_is_ahead() -> None:
    hull = seen("rov", Box((0.5, 0.5, 0.5)), (0.0, 0.0, 0.0), row=0)
    bodies = [(0.0, 0.0, 10.0, 1.0)]
    optics = Optics(LENS, None)
    depth = optics.depth_mm(view(wall(3.0), hull, bodies=bodies, own=0))
    assert np.abs(depth.astype(float) - 3000.0).max() <= 1.0
    light = optics.form(view(wall(3.0), hull, bodies=bodies, own=0, lamps=(lamp(0.0, 0.0),)))
    assert light[MIDDLE, 1] > 0.0
    # Seen by another, it is there.
    other = optics.depth_mm(view(wall(3.0), hull, p=(-2.0, 0.0, 10.0), bodies=bodies, own=-1))
    assert abs(int(other[24, 32]) - 1500) <= 1


def casts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Triangles of each scene that is looked at, as it comes."""
    found: list[int] = []
    cast = Buffers.cast

    def noted(buffers: Buffers, placed: Placed, *rest: Any) -> None:
        found.append(placed.scene.triangles)
        cast(buffers, placed, *rest)

    monkeypatch.setattr(Buffers, "cast", noted)
    return found


def test_what_lies_behind_a_camera_costs_no_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hull that carries it, and the vehicles beside it: each took a fifth of the time of a picture."""
    hull, other = (
        seen("rov", Box((0.2, 0.2, 0.2)), (-0.5, 0.0, 0.0), row=0),
        seen("other", Box((0.2, 0.2, 0.2)), (0.0, 0.0, 0.0), row=1),
    )
    optics = Optics(LENS, None)
    looked = casts(monkeypatch)
    bodies = [(0.0, 0.0, 10.0, 1.0), (1.0, 3.0, 10.0, 1.0)]
    optics.depth_mm(view(wall(3.0), hull, other, bodies=bodies, own=0))
    assert len(looked) == 1  # the wall
    ids, counts = optics.ids(view(wall(3.0), hull, other, bodies=[bodies[0], (1.0, 0.5, 10.0, 1.0)], own=0))
    assert set(np.unique(ids)) == {1, 3}
    assert counts[1, 1] == counts[1, 0] + counts[3, 0]  # the wall would fill the picture


@pytest.mark.parametrize("yaw", [-2.0, 0.7, 3.0])
def test_a_camera_sees_what_is_before_it_wherever_it_looks(yaw: float) -> None:
    where = (3.0 * math.cos(yaw), 3.0 * math.sin(yaw), 10.0)
    post = seen("post", Box((0.2, 0.2, 0.2)), where)
    assert Optics(LENS, None).depth_mm(view(post, q=quat_from_rpy(0.0, 0.0, yaw)))[24, 32]


def test_what_comes_into_sight_while_a_camera_turns_is_seen() -> None:
    post = seen("post", Box((0.4, 0.4, 0.4)), (0.0, 3.0, 11.2))
    still = view(post)
    assert not Optics(LENS, None).depth_mm(still).any()
    turning = view(post, last=Pose((0.0, 0.0, 10.0), quat_from_rpy(0.0, 0.0, 1.5)))
    assert Optics(LENS, None).depth_mm(turning).any()


def test_a_moving_body_is_seen_where_its_state_puts_it() -> None:
    ball = seen("ball", Sphere(0.5), (0.3, 0.0, 0.0), row=1)
    turned = quat_from_rpy(0.0, 0.0, math.pi / 2.0)
    bodies = [(0.0,) * 3, (4.0, -0.3, 10.0, *turned)]
    depth = Optics(LENS, None).depth_mm(view(ball, bodies=bodies))
    # Its middle is 0.3 m ahead of the body, which looks to the east: y = 0. A facet of the ball may lie a little deeper.
    assert abs(int(depth[24, 32]) - 3500) <= 5


def test_rows_are_seen_from_where_the_camera_is_when_they_are_read() -> None:
    """A camera that goes forward by a metre while it reads: the last row is a metre nearer."""
    optics = Optics(LENS, None)
    depth = optics.depth_mm(view(wall(4.0), last=Pose((1.0, 0.0, 10.0), (1.0, 0.0, 0.0, 0.0))))
    assert abs(int(depth[0, 32]) - 4000) <= 1
    assert abs(int(depth[47, 32]) - 3000) <= 1


def test_a_camera_in_a_wall_sees_the_dark() -> None:
    light = Optics(LENS, None).form(view(seen("rock", Box((5.0, 5.0, 5.0)), (0.0, 0.0, 10.0)), day=NOON))
    assert light.max() == 0.0


def test_a_camera_out_of_the_water_sees_sky_and_sea() -> None:
    picture = (
        Optics(LENS, None).form(view(p=(0.0, 0.0, -2.0), water=WATER_TYPES["II"], day=Daylight())).reshape(48, 64, 3)
    )
    assert np.isfinite(picture).all()
    assert picture[:10].min() > 1000.0  # sky
    assert picture[46, :, 0].mean() < picture[46, :, 1].mean()  # the sea has a colour


@pytest.mark.parametrize("kind", WATER_TYPES)
def test_pictures_of_all_waters_are_finite(kind: str) -> None:
    scene = view(
        floor(12.0), wall(6.0), p=(0.0, 0.0, 4.0), water=WATER_TYPES[kind], day=Daylight(), bodies=[(0.0, 0.0, 4.0, 1.0)], lamps=(lamp(0.1, 0.3),)
    )  # type: ignore[index]  # fmt: skip
    picture = Optics(LENS, None, 100.0).form(scene)
    assert np.isfinite(picture).all()
    assert picture.min() >= 0.0
    assert picture.max() > 0.0


def test_the_same_view_gives_the_same_bits() -> None:
    scene = view(
        floor(12.0), water=WATER_TYPES["3C"], day=Daylight(), bodies=[(0.0, 0.0, 10.0, 1.0)], lamps=(lamp(0.1, 0.3),)
    )
    one, two = Optics(LENS, None, 50.0), Optics(LENS, None, 50.0)
    two.form(view(wall(1.0), day=NOON))
    np.testing.assert_array_equal(one.form(scene), two.form(scene))


def test_open_water_and_no_light_at_all() -> None:
    optics = Optics(LENS, None)
    assert optics.form(view(water=CLEAR, day=DARK)).max() == 0.0
    assert optics.depth_mm(view()).max() == 0
    ids, counts = optics.ids(view())
    assert ids.max() == 0
    assert counts.shape == (1, 2)


@pytest.mark.parametrize("depth", [5.0, -5.0], ids=["in the water", "in the air"])
def test_in_a_solid_it_is_dark_and_nothing_is_far(depth: float) -> None:
    """The far side of a wall is not seen from inside, nor the water or the sky before it; what stands behind neither."""
    optics, p = Optics(LENS, FlatPort(distance_m=0.02, thickness_m=0.01)), (0.0, 0.0, depth)
    things = seen("wall", Box((1.0, 50.0, 50.0)), (0.4, 0.0, depth)), seen("ball", Sphere(0.5), (6.0, 0.0, depth))
    given = {
        "p": p,
        "water": WATER_TYPES["II"],
        "day": Daylight(50_000.0, 0.5, math.pi, 0.5),
        "lamps": (lamp(0.0, 0.0),),
    }
    light = optics.form(view(*things, bodies=[(*p, 1.0)], **given))
    assert not light.any()
    assert not optics.depth_mm(view(*things, **given)).any()
    ids, counts = optics.ids(view(*things, **given))
    assert not ids.any()
    assert counts[1, 0] == counts[2, 0] == 0
    # A metre before it, all is as ever.
    given["p"] = (-2.0, 0.0, depth)
    assert optics.form(view(*things, **given)).any()
    assert optics.depth_mm(view(*things, **given))[24, 32] == 1400


def test_a_wall_with_two_sides_is_seen_from_both() -> None:
    """What is no closed solid has no inside: a sheet, as a mesh of triangles."""
    corners = np.array([(0.0, -50.0, -50.0), (0.0, 50.0, -50.0), (0.0, 50.0, 50.0), (0.0, -50.0, 50.0)])
    for order in ([(0, 1, 2), (0, 2, 3)], [(0, 2, 1), (0, 3, 2)]):
        sheet = seen("sheet", TriangleMesh(corners, np.array(order), oriented=False), (2.0, 0.0, 5.0))
        depth = Optics(LENS, None).depth_mm(view(sheet, p=(0.0, 0.0, 5.0)))
        assert (depth == 2000).all()
