"""The magnetic field about the origin: the World Magnetic Model's values there, and a gradient that holds nearby."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.environment.geodesy import latitude_longitude
from uwserver.scenario.world.magnetic import WMM_YEARS, magnetic_about
from uwserver.units import deg, rad

TRONDHEIM = rad(63.43), rad(10.40)


# Of the test values published with WMM2025 (NOAA, table of test values): year, latitude, longitude (deg), X, Y, Z (nT), height 0.
PUBLISHED = [
    (2025.0, 80.0, 0.0, 6521.6, 145.9, 54791.5),
    (2025.0, 0.0, 120.0, 39677.8, -109.6, -10580.2),
    (2025.0, -80.0, 240.0, 6117.5, 15751.9, -52022.5),
]


@pytest.mark.parametrize(("year", "latitude", "longitude", "x", "y", "z"), PUBLISHED)
def test_the_field_at_the_origin_is_the_published_one(
    year: float, latitude: float, longitude: float, x: float, y: float, z: float
) -> None:
    at = magnetic_about(rad(latitude), rad(longitude), year)[0]
    assert [1e9 * c for c in at] == pytest.approx([x, y, z], abs=0.06)


def test_units_are_tesla_and_the_field_dips_into_the_sea_in_the_north() -> None:
    at = magnetic_about(*TRONDHEIM, 2026.0)[0]
    assert 4.5e-5 < math.hypot(*at) < 5.8e-5
    assert at[2] > 4e-5
    assert 0.0 < math.atan2(at[1], at[0]) < rad(8.0)


@pytest.mark.parametrize("place", [(5000.0, 0.0, 0.0), (0.0, -8000.0, 0.0), (3000.0, 3000.0, 500.0)])
def test_linear_about_the_origin_it_holds_for_kilometres(place: tuple[float, float, float]) -> None:
    at, *slopes = (np.array(v) for v in magnetic_about(*TRONDHEIM, 2026.0))
    there = at + sum(slope * way for slope, way in zip(slopes, place, strict=True))
    latitude, longitude = latitude_longitude(place[0], place[1], *TRONDHEIM)
    from pygeomag import GeoMag

    exact = GeoMag(coefficients_file="wmm/WMM_2025.COF").calculate(
        glat=deg(latitude), glon=deg(longitude), alt=-1e-3 * place[2], time=2026.0
    )
    assert there == pytest.approx(1e-9 * np.array([exact.x, exact.y, exact.z]), abs=2e-9)
    assert np.abs(there - at).max() > 1e-9


def test_deeper_is_stronger() -> None:
    """A dipole's field grows by 3 / radius towards the middle of the Earth."""
    at, _, _, down = (np.array(v) for v in magnetic_about(*TRONDHEIM, 2026.0))
    growth = float(at @ down) / float(at @ at)
    assert growth == pytest.approx(3.0 / 6.371e6, rel=0.25)


def test_the_field_drifts_with_the_years() -> None:
    first, last = (magnetic_about(*TRONDHEIM, year)[0] for year in (2025.0, 2029.9))
    assert first != last
    assert first == pytest.approx(last, rel=0.2)


@pytest.mark.parametrize("year", [WMM_YEARS[0] - 0.5, WMM_YEARS[1] + 0.5, 1970.0])
def test_a_year_outside_the_model_is_refused(year: float) -> None:
    with pytest.raises(ValueError, match="year"):
        magnetic_about(*TRONDHEIM, year)
