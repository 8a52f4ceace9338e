"""Patterns: the same everywhere and always, bounded, and gone where a pixel covers them."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.sensors.optical.camera.patterns import flat_noise, grown, noise, seabed, tiles

PLACES = [(0.37 * k, -1.3 * k, 0.11 * k) for k in range(200)]


def test_noise_is_between_0_and_1_smooth_and_as_it_always_was() -> None:
    plane = np.array([flat_noise(x, y) for x, y, _ in PLACES])
    space = np.array([noise(*place) for place in PLACES])
    for values in (plane, space):
        assert 0.0 <= values.min() < 0.3 < 0.7 < values.max() <= 1.0
    assert abs(noise(1.0 - 1e-9, 2.5, -3.5) - noise(1.0 + 1e-9, 2.5, -3.5)) < 1e-6
    assert flat_noise(0.25, 0.75) == pytest.approx(flat_noise(0.25, 0.75))


def tones(pixel: float) -> np.ndarray:
    out = []
    for x, y, _ in PLACES:
        out.append(seabed(x, y, pixel, (0.5, 0.4, 0.3))[0])
    return np.array(out)


def test_fine_detail_is_left_out_where_a_pixel_covers_it() -> None:
    assert tones(0.001).std() > 1.3 * tones(1.0).std()
    assert tones(0.001).mean() == pytest.approx(0.5, abs=0.06)


def test_growth_covers_what_looks_up_more() -> None:
    def green(up: float) -> float:
        total = 0.0
        for place in PLACES:
            colour = grown(*place, up, 0.01, (0.8, 0.1, 0.1))
            total += colour[1] / colour[0]
        return total

    assert green(1.0) > green(-1.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_tiles_have_grout_between_them_on_floors_and_walls_and_none_from_afar(axis: int) -> None:
    normal = np.zeros(3)
    normal[axis] = -1.0

    def tone(place: np.ndarray, pixel: float) -> float:
        colour = tiles(tuple(place), tuple(normal), pixel, (1.0, 1.0, 1.0))
        assert colour == (colour[0],) * 3
        return float(colour[0])

    middle, line = np.full(3, 0.125), np.full(3, 0.125)
    line[(axis + 1) % 3] = 0.25
    assert tone(middle, 0.001) == pytest.approx(1.0, abs=0.05)
    assert tone(line, 0.001) == pytest.approx(0.6, abs=0.01)
    assert 0.95 < tone(line, 0.2) <= 1.0 + 0.05
    assert tone(line, 5.0) == 1.0
    # Along the normal the face is one plane: where it stands changes nothing but which tile it is.
    moved = line.copy()
    moved[axis] += 0.125
    assert tone(moved, 0.001) == pytest.approx(tone(line, 0.001))
