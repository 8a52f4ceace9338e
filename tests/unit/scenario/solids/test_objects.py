"""Free objects as bodies in water: mass, buoyancy, added mass and drag in closed form, and their symmetries."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from uwserver.physics.kernel.layout import SHAPE_BOX, SHAPE_SPHERE
from uwserver.scenario.solids.objects import mass, object_params, volume
from uwserver.scenario.solids.tables import BoxObject, CylinderObject, ObjectEntry, SphereObject
from uwserver.scenario.world.tables import Environment

WATER = Environment(density_kgpm3=1000.0, gravity_mps2=10.0)
BALL = SphereObject(mass_kg=5.0, radius_m=0.2)
BRICK = BoxObject(mass_kg=5.0, size_m=(0.5, 0.3, 0.1))
PIPE = CylinderObject(mass_kg=5.0, radius_m=0.1, length_m=1.0)
ALL = (BALL, BRICK, PIPE)


@pytest.mark.parametrize(
    ("entry", "expected"), [(BALL, 4 / 3 * math.pi * 0.008), (BRICK, 0.015), (PIPE, math.pi * 0.01)]
)
def test_volumes(entry: ObjectEntry, expected: float) -> None:
    assert volume(entry) == pytest.approx(expected)


def test_the_mass_is_given_or_follows_from_the_density() -> None:
    assert mass(BALL) == 5.0
    heavy = BoxObject(density_kgpm3=2000.0, size_m=(0.5, 0.3, 0.1))
    assert mass(heavy) == pytest.approx(30.0)
    assert object_params(heavy, WATER).weight == pytest.approx(300.0)


@pytest.mark.parametrize("entry", ALL)
def test_weight_and_buoyancy(entry: ObjectEntry) -> None:
    params = object_params(entry, WATER)
    assert params.weight == pytest.approx(50.0)
    assert params.buoyancy == pytest.approx(1e4 * volume(entry))
    assert params.r_g == params.r_b == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("entry", "inertia"),
    [
        (BALL, [0.4 * 0.04] * 3),
        (BRICK, [(0.09 + 0.01) / 12, (0.25 + 0.01) / 12, (0.25 + 0.09) / 12]),
        (PIPE, [0.005, 0.0025 + 1 / 12, 0.0025 + 1 / 12]),
    ],
)
def test_inertia_of_homogeneous_bodies(entry: ObjectEntry, inertia: list[float]) -> None:
    M = object_params(entry, WATER).M_RB
    assert pytest.approx(np.diag([5.0] * 3 + [5.0 * i for i in inertia])) == M


# -- added mass -------------------------------------------------------------------------------------------------------------------------


def test_a_ball_moves_half_its_water_and_turns_none() -> None:
    M_A = object_params(BALL, WATER).M_A
    assert pytest.approx(np.diag([0.5 * 1000 * volume(BALL)] * 3 + [0.0] * 3)) == M_A


@pytest.mark.parametrize(
    ("length", "part"),
    [(0.24, 0.62), (0.5, 0.78), (1.0, 0.90), (1.8, 0.96), (10.0, 1.0), (100.0, 1.0), (0.75, 0.84)],
)
def test_a_cylinder_across_its_axis_by_the_table(length: float, part: float) -> None:
    """DNV-RP-C205 table D-2 at its points, and half-way between 2.5 and 5."""
    pipe = replace(PIPE, length_m=length)
    M_A = object_params(pipe, WATER).M_A
    assert M_A[1, 1] == M_A[2, 2] == pytest.approx(part * 1000 * volume(pipe))
    assert M_A[4, 4] == pytest.approx(M_A[1, 1] * length**2 / 12)
    assert M_A[3, 3] == 0.0


@pytest.mark.parametrize(("length", "value"), [(0.5, 0.68), (1.0, 0.72), (2.5, 0.75), (0.0005, 0.455), (50.0, 0.80)])
def test_a_square_prism_along_its_axis_by_the_table(length: float, value: float) -> None:
    prism = BoxObject(mass_kg=5.0, size_m=(length, 0.5, 0.5))
    assert object_params(prism, WATER).M_A[0, 0] == pytest.approx(value * 1000 * 0.125, rel=2e-3)


def test_added_mass_grows_with_the_water_and_not_with_the_body() -> None:
    light, heavy = (object_params(replace(BRICK, mass_kg=m), WATER) for m in (1.0, 50.0))
    assert pytest.approx(heavy.M_A) == light.M_A
    salty = object_params(BRICK, replace(WATER, density_kgpm3=1200.0))
    assert pytest.approx(1.2 * light.M_A) == salty.M_A
    assert pytest.approx(1.2 * light.D_Q) == salty.D_Q
    assert pytest.approx(object_params(BRICK, WATER).M_RB) == salty.M_RB


# -- drag -------------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entry", "areas"),
    [
        (BALL, [0.47 * math.pi * 0.04] * 3),
        (BRICK, [1.05 * 0.03, 1.05 * 0.05, 1.05 * 0.15]),
        (PIPE, [0.9 * math.pi * 0.01, 0.2, 0.2]),
    ],
)
def test_quadratic_drag_of_the_frontal_area(entry: ObjectEntry, areas: list[float]) -> None:
    assert object_params(entry, WATER).D_Q.diagonal()[:3] == pytest.approx(500.0 * np.array(areas))


def test_turning_drag_of_a_pipe_is_that_of_its_strips() -> None:
    """2 times the integral of C_D w s^3 from 0 to half the length, over which the strips move at w s."""
    s = (np.arange(10_000) + 0.5) * 0.5 / 10_000
    strips = 2.0 * float((1.0 * 0.2 * s**3).sum()) * 0.5 / 10_000
    assert object_params(PIPE, WATER).D_Q[4, 4] == pytest.approx(500.0 * strips, rel=1e-6)


@pytest.mark.parametrize("entry", ALL)
def test_at_two_centimetres_a_second_both_parts_of_the_drag_are_equal(entry: ObjectEntry) -> None:
    params = object_params(entry, WATER)
    linear, quadratic = params.D_L.diagonal(), params.D_Q.diagonal()
    assert linear[:3] * 0.02 == pytest.approx(quadratic[:3] * 0.02**2)
    assert (linear > 0.0).all()
    assert not params.D_S.any()


# -- symmetries -------------------------------------------------------------------------------------------------------------------------


def test_a_cube_is_alike_in_all_directions() -> None:
    cube = object_params(BoxObject(mass_kg=5.0, size_m=(0.4, 0.4, 0.4)), WATER)
    for matrix in (cube.M_RB, cube.M_A, cube.D_L, cube.D_Q):
        assert matrix.diagonal()[:3] == pytest.approx([matrix[0, 0]] * 3)
        assert matrix.diagonal()[3:] == pytest.approx([matrix[3, 3]] * 3)


def test_a_box_turned_by_hand_is_the_box_turned() -> None:
    params = object_params(BRICK, WATER)
    turned = object_params(replace(BRICK, size_m=(0.3, 0.1, 0.5)), WATER)
    for matrix, other in ((params.M_A, turned.M_A), (params.D_Q, turned.D_Q), (params.M_RB, turned.M_RB)):
        assert other.diagonal() == pytest.approx(matrix.diagonal()[[1, 2, 0, 4, 5, 3]])


@pytest.mark.parametrize(
    ("entry", "kind", "half"),
    [
        (BALL, SHAPE_SPHERE, (0.2, 0.2, 0.2)),
        (BRICK, SHAPE_BOX, (0.25, 0.15, 0.05)),
        (PIPE, SHAPE_BOX, (0.5, 0.05 * math.sqrt(math.pi), 0.05 * math.sqrt(math.pi))),
    ],
)
def test_the_shape_near_the_surface_has_its_volume(entry: ObjectEntry, kind: int, half: tuple[float, ...]) -> None:
    (shape,) = object_params(entry, WATER).shapes
    assert shape.kind == kind
    assert shape.half == pytest.approx(half)
    assert shape.volume == pytest.approx(volume(entry))
    if kind == SHAPE_BOX:
        assert 8.0 * math.prod(shape.half) == pytest.approx(volume(entry))
