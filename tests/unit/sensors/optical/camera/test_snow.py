"""Marine snow: as dense as wished, where it was when the camera comes back, drifting with the current, hidden by what is nearer."""

from __future__ import annotations

import numpy as np
import pytest
from sensors.optical.camera.rig import view, wall

from uwserver.environment.light import WATER_TYPES, Daylight
from uwserver.sensors.optical.camera.lens import lens_of
from uwserver.sensors.optical.camera.picture import Optics
from uwserver.sensors.optical.camera.snow import CUBE_M, drifted, flakes

LENS = lens_of((160, 120), 1.2)
WATER = WATER_TYPES["II"]


def changed(*things: object, density: float = 500.0, **rest: object) -> np.ndarray:
    """(n) which pixels snow changes."""
    scene = view(*things, water=WATER, day=Daylight(), **rest)  # type: ignore[arg-type]
    return (Optics(LENS, None, density).form(scene) != Optics(LENS, None).form(scene)).any(axis=1)


def test_as_many_as_wished_and_small_ones_more_often() -> None:
    found = flakes(50.0)
    assert len(found) == 50 * CUBE_M**3
    assert 0.25e-3 <= found[:, 3].min() < found[:, 3].max() <= 1.5e-3
    assert np.median(found[:, 3]) < 0.5e-3


def test_flakes_stay_where_they_are_in_the_water() -> None:
    here = changed()
    assert 20 < here.sum() < 4000
    np.testing.assert_array_equal(here, changed(p=(CUBE_M, -CUBE_M, 10.0)))  # the cube repeats
    assert (changed(p=(0.1, 0.0, 10.0)) != here).any()
    base = drifted((1.0, 2.0, 3.0), (0.5, 0.0, 0.0), 1.0)
    assert base[0] == pytest.approx((1.0 - 0.5) % CUBE_M)


def test_a_wall_before_the_lens_hides_them() -> None:
    assert changed(wall(0.02)).sum() == 0
