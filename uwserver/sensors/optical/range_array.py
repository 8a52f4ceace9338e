"""Laser scanner or range array: distances along a fan of thin rays."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from msgspec import Meta

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, normals, uniforms
from uwserver.ports import Argument, BeamView, Field
from uwserver.sensors.base import Distance, Pose, SensorTable, Settings, Traits
from uwserver.sensors.compiled import (
    MISSING,
    SensorKernel,
    TableSensor,
    aim_loop,
    p_NS,
    q_NS,
    ray_loop,
    record,
    rotate,
    submergence,
)
from uwserver.table import NonNegative, Positive, Probability
from uwserver.units import rad

MOST_BEAMS = 4096
_LOSSES = MOST_BEAMS
"""Lanes of random numbers from here on decide which rays are lost; those before are noise."""


class RangeArrayConfig(SensorTable, tag="range_array", kw_only=True, frozen=True):
    """Thin rays in the sensor's xy plane about its x axis; the first is to port. They pass through the sensor's own vehicle.

    Attributes:
        ideal: exact, whatever the other keys say.
        beams: number of rays.
        field_of_view_deg: angle between the first ray and the last.
        min_range_m, max_range_m: limits of the measured distance.
        sigma_m: standard deviation of white noise.
        loss_probability: probability that a single ray is lost.
        medium: "water" for a laser that works only under water, "any" for one that works in air too.
    """

    message = "LaserScan"
    ideal: bool = False
    beams: Annotated[int, Meta(ge=1, le=MOST_BEAMS)] = 1
    field_of_view_deg: Annotated[float, Meta(ge=0, lt=361)] = 0.0
    min_range_m: NonNegative = 0.0
    max_range_m: Positive = 10.0
    sigma_m: NonNegative = 0.0
    loss_probability: Probability = 0.0
    medium: Literal["water", "any"] = "water"

    def traits(self) -> Traits:
        """Declare its rays, the first to port."""
        width, last = rad(self.field_of_view_deg), self.beams - 1
        angles = (-0.5 * width + (width * k / last if last > 0 else 0.5 * width) for k in range(self.beams))
        rays = (BeamView((math.cos(a), math.sin(a), 0.0), 0.0, self.min_range_m, self.max_range_m) for a in angles)
        return Traits(stages=("soundings",), beams=tuple(rays))

    def build(self, mount: Pose) -> RangeArray:
        return RangeArray(mount, self)


class RangeSettings(Settings, frozen=True):
    """The range limit."""

    max_range_m: Distance


_RECORD = record(
    [
        ("beams", "i8"), ("first", "f8"), ("step", "f8"), ("low", "f8"), ("high", "f8"), ("sigma", "f8"), ("loss", "f8"),
        ("anywhere", "i8"),
    ]
)  # fmt: skip


@compiled
def aim(
    head: Any, row: Any, surroundings: Array, t: float, origin: Array, direction: Array, count: int
) -> tuple[int, float]:  # fmt: skip
    """Write the rays of the fan. There are none in air, unless the medium is any."""
    p, q = p_NS(head, surroundings), q_NS(head, surroundings)
    if row.anywhere != 0 or submergence(surroundings, p, t) >= 0.0:
        for i in range(row.beams):
            angle = row.first + i * row.step
            origin[count, 0], origin[count, 1], origin[count, 2] = p
            ray = rotate(q, (math.cos(angle), math.sin(angle), 0.0))
            direction[count, 0], direction[count, 1], direction[count, 2] = ray
            count += 1
        return count, row.high
    return count, 0.0


@compiled
def _range(head: Any, row: Any, i: int, distance: float) -> float:
    """Return the reading of ray i at a distance, m; MISSING if it sees nothing."""
    if not row.low <= distance <= row.high:
        return MISSING
    if head.exact != 0:
        return distance
    luck, _ = uniforms(head.key, head.number, SAMPLE, _LOSSES + i)
    if luck < row.loss:
        return MISSING
    noise, _ = normals(head.key, head.number, SAMPLE, i)
    return float(distance + row.sigma * noise)


@compiled
def measure(
    head: Any, row: Any, surroundings: Array, t: float, out: Array, direction: Array, begin: int, end: int, hits: Any
) -> None:  # fmt: skip
    """Write the ranges of the rays; invalid in air."""
    if end == begin:
        out[:], head.valid = MISSING, 0
        return
    for i in range(row.beams):
        out[i] = _range(head, row, i, hits.distance[begin + i])


class RangeArray(TableSensor[RangeArrayConfig]):
    """Distances to the first solid thing on each ray."""

    doc = "Distances along thin rays, from port to starboard; a ray that hits nothing has no value. Invalid while the sensor is in air."
    kernel = SensorKernel(_RECORD, ray_loop(measure), (aim_loop(aim),))
    random = ("sigma",)
    settings: RangeSettings

    def __init__(self, mount: Pose, config: RangeArrayConfig) -> None:
        self.rays = config.beams
        self.fields = (Field("ranges", "m", "distance along each ray", "", (config.beams,)),)
        self.arguments = (
            Argument(
                "max_range_m", "float", "limit of the measured distance", "m", required=False, minimum=0.01, maximum=1e4
            ),
        )
        super().__init__(mount, config, RangeSettings(config.max_range_m))

    def fill(self, row: Any) -> None:
        c, field = self._config, rad(self._config.field_of_view_deg)
        row["beams"], row["first"], row["step"] = c.beams, -0.5 * field, field / max(1, c.beams - 1)
        if c.beams == 1:
            row["first"] = 0.0
        row["low"], row["high"], row["anywhere"] = c.min_range_m, self.settings.max_range_m, c.medium == "any"
        row["sigma"], row["loss"] = c.sigma_m, c.loss_probability
