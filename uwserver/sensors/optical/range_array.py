"""Laser or range array: distances along a fan of thin rays, or along given directions."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from uwserver.frames import rotate
from uwserver.modifiers.base import Measurement
from uwserver.ports import Argument, Field, Value
from uwserver.sensors.base import Distance, Pose, Scope, Sensor, SensorTable, Settings
from uwserver.table import NonNegative, Positive, Probability
from uwserver.units import rad


class RangeArrayConfig(SensorTable, tag="range_array", kw_only=True, frozen=True):
    """Thin rays in the sensor's xy plane about its x axis, the first to port.

    Attributes:
        ideal: exact, whatever else is given.
        beams: number of rays.
        field_of_view_deg: between the first and the last.
        min_range_m, max_range_m: nothing is seen outside.
        sigma_m: standard deviation of white noise.
        loss_probability: of a single ray.
        medium: "water" for a laser under water, "any" for one that sees through the surface too.
    """

    ideal: bool = False
    beams: Annotated[int, Meta(ge=1, le=4096)] = 1
    field_of_view_deg: Annotated[float, Meta(ge=0, lt=361)] = 0.0
    min_range_m: NonNegative = 0.0
    max_range_m: Positive = 10.0
    sigma_m: NonNegative = 0.0
    loss_probability: Probability = 0.0
    medium: Literal["water", "any"] = "water"

    def build(self, mount: Pose) -> RangeArray:
        return RangeArray(mount, self)


class RangeSettings(Settings, frozen=True):
    """How far it looks."""

    max_range_m: Distance


class RangeArray(Sensor):
    """Distances to the first solid thing."""

    doc = "Distances along thin rays, from port to starboard; no value where a ray hits nothing. Invalid while the sensor is in air."
    settings: RangeSettings

    def __init__(self, mount: Pose, config: RangeArrayConfig) -> None:
        self._mount, self._config = mount, config
        self._sigma, self._loss = (0.0, 0.0) if config.ideal else (config.sigma_m, config.loss_probability)
        half = 0.5 * rad(config.field_of_view_deg)
        angles = np.linspace(-half, half, config.beams) if config.beams > 1 else np.zeros(1)
        self._rays = [(math.cos(a), math.sin(a), 0.0) for a in angles.tolist()]
        self.fields = (Field("ranges", "m", "distance along each ray", "", (config.beams,)),)
        self.arguments = (
            Argument("max_range_m", "float", "how far it looks", "m", required=False, minimum=0.01, maximum=1e4),
        )
        super().__init__(RangeSettings(config.max_range_m))

    def sense(self, scope: Scope) -> Measurement:
        """Invalid in air, unless the medium is any."""
        n, limit = len(self._rays), self.settings.max_range_m
        noise = self.rng.standard_normal(n) * self._sigma
        lost = self.rng.random(n) < self._loss
        p = scope.position(self._mount.p)
        if self._config.medium == "water" and scope.submergence(p) < 0.0:
            return Measurement([(None,) * n], False)
        q = scope.attitude(self._mount.q)
        direction = np.array([rotate(q, ray) for ray in self._rays])
        distance = scope.geometry.raycast(np.broadcast_to(np.array(p), direction.shape), direction, limit).distance
        seen = (distance <= limit) & (distance >= self._config.min_range_m) & ~lost
        measured = np.where(seen, distance, 0.0) + noise
        value: Value = tuple(float(d) if s else None for d, s in zip(measured, seen, strict=True))
        return Measurement([value], True)
