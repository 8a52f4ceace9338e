"""What a sensor may know of others: cameras look at nothing before somebody asks."""

from __future__ import annotations

import numpy as np

from uwserver.environment.light import WATER_TYPES, Daylight
from uwserver.sensors.others import Sight


def test_it_is_what_it_was_given_and_looks_only_when_asked() -> None:
    looked: list[int] = []
    sight = Sight(WATER_TYPES["II"], Daylight(), lambda: looked.append(1), tuple, lambda: np.zeros((1, 13)))
    assert not looked
    sight.scene()
    assert looked == [1]
    assert sight.lamps() == ()
