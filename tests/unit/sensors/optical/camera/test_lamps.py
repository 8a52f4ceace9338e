"""Lamps: all their light within the half space, cones, and the veil that water sends back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.environment.light import ASYMMETRY, WATER_TYPES, WaterLight, WaterType
from uwserver.sensors.optical.camera.lamps import LAMP, RANGES, candelas, exponent_of, veil_of


@pytest.mark.parametrize("cone", [0.3, 1.2, 2.36])
def test_all_lumens_go_into_the_half_space_and_half_the_intensity_is_at_the_cone(cone: float) -> None:
    m = exponent_of(cone)
    assert math.cos(0.5 * cone) ** m == pytest.approx(0.5)
    angles = np.linspace(0.0, 0.5 * math.pi, 20001)
    power = 2.0 * math.pi * candelas(1500.0, m) * np.trapezoid(np.cos(angles) ** m * np.sin(angles), angles)
    assert power == pytest.approx(1500.0, rel=1e-3)


def veil(offset: float, scattering: float) -> np.ndarray:
    lamps = np.zeros(1, LAMP)
    lamps["p"], lamps["axis"], lamps["candela"], lamps["exponent"] = (0.0, offset, 0.0), (1.0, 0.0, 0.0), 500.0, 1.0
    n = 32 * 32
    origin, direction = np.zeros((n, 3), np.float32), np.tile(np.array((1.0, 0.0, 0.0), np.float32), (n, 1))
    water = WaterLight((0.3, 0.3, 0.3), (scattering, 0.1, 0.0), (0.1, 0.1, 0.1))
    return veil_of(lamps, (origin, direction), 32, water)


def test_the_veil_is_the_integral_of_what_is_scattered_back() -> None:
    """A ray beside a lamp, integrated finely by hand; Henyey and Greenstein with g = 0.924."""
    g, s, c = 0.924, 0.3, 0.3
    r = np.linspace(1e-4, 25.0, 400_001)
    far = np.hypot(r, 0.5)
    cosine = r / far
    turn = -cosine
    phase = (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * turn) ** 1.5)
    expected = np.trapezoid(500.0 * cosine / far**2 * phase * s * np.exp(-c * r - (c - g * s) * far), r)
    got = veil(0.5, s)
    assert got.shape == (3, 3, len(RANGES), 3)
    assert got[1, 1, -1, 0] == pytest.approx(expected, rel=0.03)
    # By what is scattered, and growing with the range.
    assert 0.2 < got[1, 1, -1, 1] / got[1, 1, -1, 0] < 1.0 / 3.0
    assert got[1, 1, -1, 2] == 0.0
    assert (np.diff(got[1, 1, :, 0]) >= 0.0).all()


def test_a_lamp_farther_from_the_lens_makes_less_of_a_veil() -> None:
    assert veil(0.1, 0.3)[1, 1, -1, 0] > 2.0 * veil(0.6, 0.3)[1, 1, -1, 0]


def test_the_phase_function_has_all_light_and_sends_back_as_much_as_sea_water() -> None:
    """Backward 1.3 to 2 % in Petzold's coastal and harbour waters, and about 0.003 /sr right back, where this one has half of that."""
    g, cosine = ASYMMETRY, np.linspace(-1.0, 1.0, 2_000_001)
    phase = (1.0 - g * g) / (4.0 * np.pi * (1.0 + g * g - 2.0 * g * cosine) ** 1.5)
    assert 2.0 * np.pi * np.trapezoid(phase, cosine) == pytest.approx(1.0, rel=1e-3)
    back = cosine <= 0.0
    assert 0.015 < 2.0 * np.pi * np.trapezoid(phase[back], cosine[back]) < 0.02
    assert phase[0] == pytest.approx(0.0016, rel=0.05)


@pytest.mark.parametrize("kind", ["II", "1C", "3C"])
@pytest.mark.parametrize("pixel", [(144, 192), (288, 0), (288, 384)])
def test_two_lamps_beside_the_lens_veil_a_pixel_by_single_scattering(kind: WaterType, pixel: tuple[int, int]) -> None:
    """A lamp of an ROV to either side, 0.13 m off and 0.1 m below; 400 x 300 pixels of 80 degrees; up to 3.5 m, by a fine sum."""
    width, height, water = 400, 300, WATER_TYPES[kind]
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    ahead = np.full_like(columns, 0.5 * width / math.tan(math.radians(40.0)))
    direction = np.stack((ahead, columns - 0.5 * width, rows - 0.5 * height), -1).reshape(-1, 3)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    lamps, m = np.zeros(2, LAMP), exponent_of(math.radians(135.0))
    lamps["p"], lamps["axis"] = ((0.0, -0.13, 0.1), (0.0, 0.13, 0.1)), (1.0, 0.0, 0.0)
    lamps["candela"], lamps["exponent"] = candelas(1500.0, m), m
    veil = veil_of(lamps, (np.zeros_like(direction, np.float32), direction.astype(np.float32)), width, water)
    step, ray = 13, direction[pixel[0] * width + pixel[1]]
    r = np.geomspace(1e-4, RANGES[step], 100_001)
    expected, g = np.zeros(3), ASYMMETRY
    for place in lamps["p"]:
        x = r[:, None] * ray - place
        far = np.linalg.norm(x, axis=1)
        candela = candelas(1500.0, m) * np.clip(x[:, 0] / far, 0.0, None) ** m
        phase = (1.0 - g * g) / (4.0 * np.pi * (1.0 + g * g + 2.0 * g * (x @ ray) / far) ** 1.5)
        for i, (c, b) in enumerate(zip(water.attenuation, water.scattering, strict=True)):
            expected[i] += np.trapezoid(candela / far**2 * phase * b * np.exp(-c * r - (c - g * b) * far), r)
    assert veil[pixel[0] // 16, pixel[1] // 16, step] == pytest.approx(expected, rel=0.02)
