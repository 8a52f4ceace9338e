"""Collision shapes of the shipped vehicles fit what the same file says of their displaced water."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.physics.geometry.shapes import Box, Capsule, Cylinder
from uwserver.scenario.files.documents import shipped
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry


def volume_and_half(shape: object) -> tuple[float, tuple[float, float, float]]:
    """Volume, m3, and half of the box around a shape in its own frame."""
    if isinstance(shape, Box):
        return 8.0 * math.prod(shape.half), shape.half
    assert isinstance(shape, Capsule | Cylinder)
    r, ends = shape.radius, 4.0 / 3.0 * math.pi * shape.radius**3
    if isinstance(shape, Capsule):
        return 2.0 * math.pi * r * r * shape.half_length + ends, (shape.half_length + r, r, r)
    return 2.0 * math.pi * r * r * shape.half_length, (shape.half_length, r, r)


@pytest.mark.parametrize("model", sorted(shipped("vehicles")))
def test_the_displaced_water_is_within_the_shapes(model: str) -> None:
    resolved = load(Scenario(schema=1, vehicles={"v": VehicleEntry(model=model)}), adapters={}).vehicles["v"]
    assert resolved.solid is not None
    volumes, low, high = [], [], []
    for placed in resolved.solid.shapes:
        volume, half = volume_and_half(placed.shape)
        reach = np.abs(placed.R) @ half
        volumes.append(volume)
        low.append(np.array(placed.p) - reach)
        high.append(np.array(placed.p) + reach)
    buoyancy = resolved.vehicle.buoyancy
    assert 0.95 < sum(volumes) / buoyancy.volume_m3 < 4.0, (
        "an open frame holds water, nothing displaces more than it has"
    )
    assert (np.min(low, axis=0) < buoyancy.center_frd_m).all()
    assert (np.max(high, axis=0) > buoyancy.center_frd_m).all()
    for shape in buoyancy.shapes.values():
        half = 0.5 * np.array(shape.size_m)
        assert (np.min(low, axis=0) - 0.05 < np.array(shape.center_frd_m) - half).all()
        assert (np.max(high, axis=0) + 0.05 > np.array(shape.center_frd_m) + half).all()
