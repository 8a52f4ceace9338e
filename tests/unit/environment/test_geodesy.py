"""Places of N on the Earth, and back. Also of uwserver.adapter.earth, by which adapters use this."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.environment.geodesy import latitude_longitude, north_east
from uwserver.units import rad


@pytest.mark.parametrize("place", [(0.0, 0.0), (3000.0, -4000.0), (-250_000.0, 180_000.0)])
@pytest.mark.parametrize("origin", [(63.43, 10.40), (0.0, 179.9), (-45.0, -170.0)])
def test_geodesy_leads_there_and_back(place, origin):
    latitude, longitude = latitude_longitude(*place, rad(origin[0]), rad(origin[1]))
    north, east = north_east(np.array(latitude), np.array(longitude), rad(origin[0]), rad(origin[1]))
    assert (float(north), float(east)) == pytest.approx(place, abs=1e-6)
