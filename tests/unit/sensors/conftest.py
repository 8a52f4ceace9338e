"""A vehicle at one instant, without a world."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from uwserver.environment.water import Water
from uwserver.sensors import Scope

G = 9.81


@pytest.fixture
def water() -> Water:
    return Water(density=1025.0, gravity=G, temperature=12.0, atmospheric_pressure=101_325.0, current=(0.3, 0.0, 0.0))


@pytest.fixture
def scope(water: Water) -> Callable[..., Scope]:
    """`scope(w_NB_B=(0, 0, 1))`: level, at rest and 5 m deep, except for what is given."""

    def build(**changes: object) -> Scope:
        rest = {
            "t_ns": 0, "p_NB": (1.0, 2.0, 5.0), "q_NB": (1.0, 0.0, 0.0, 0.0), "v_NB_B": (0.0,) * 3, "w_NB_B": (0.0,) * 3, "water": water,
        }  # fmt: skip
        return Scope(**(rest | changes))

    return build
