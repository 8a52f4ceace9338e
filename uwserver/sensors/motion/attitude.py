"""Attitude and heading reference system: the attitude that such a device outputs, with the errors of its filter."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from msgspec import Meta

from uwserver.frames import Quat, Vec3
from uwserver.modifiers.base import Memory, Number
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, normals
from uwserver.ports import Field
from uwserver.sensors.base import Pose, SensorTable, Traits
from uwserver.sensors.compiled import (
    MISSING,
    SensorKernel,
    TableSensor,
    loop,
    multiply,
    place_of,
    q_NB,
    q_NS,
    quat_from_rpy,
    record,
    rotate,
    rpy_from_quat,
    v_NB_B,
)
from uwserver.table import NonNegative, Positive
from uwserver.units import rad


class AttitudeConfig(SensorTable, tag="attitude", kw_only=True, frozen=True):
    """An AHRS or gyrocompass. Its errors are small rotations: about the horizontal axes (roll, pitch) and about the vertical (heading).

    Attributes:
        ideal: exact, whatever the other keys say.
        north: reference of the heading: "true", or "magnetic", which is less by the declination (needs `[world] origin_lat_deg`).
        tilt_sigma_deg, heading_sigma_deg: standard deviation of slowly changing errors (Gauss-Markov).
        tau_s: their correlation time.
        heading_turn_on_deg: standard deviation of a constant heading error, drawn once a run.
        noise_deg: standard deviation of white noise about each axis.
        secant_latitude: the device is a gyrocompass. It finds north from the Earth's rotation, so its heading errors grow by 1 / cos(latitude).
        told_speed: whether a gyrocompass gets its speed and latitude. Without them it takes the turn of the level axes due to its motion for a
            part of the Earth's rotation. On a rotating Earth its heading error is then the speed to the north divided by the speed of the Earth's
            surface at that latitude (half a degree at 2 m/s and 60 degrees north).
        settling_s: time from the start of a run until the output is valid.
    """

    message = "Attitude"
    ideal: bool = False
    north: Literal["true", "magnetic"] = "true"
    tilt_sigma_deg: NonNegative = 0.0
    heading_sigma_deg: NonNegative = 0.0
    tau_s: Positive = 60.0
    heading_turn_on_deg: NonNegative = 0.0
    noise_deg: Annotated[float, Meta(ge=0, le=10)] = 0.0
    secant_latitude: bool = False
    told_speed: bool = True
    settling_s: NonNegative = 0.0

    def traits(self) -> Traits:
        """Declare its errors about each axis, and whether it needs the position on the Earth."""
        noise, is_magnetic = self.noise_deg, self.north == "magnetic"
        tilt = rad(math.hypot(self.tilt_sigma_deg, noise))
        heading = rad(math.hypot(self.heading_sigma_deg, self.heading_turn_on_deg, noise))
        needs_origin = self.secant_latitude or is_magnetic
        return Traits(sigmas={"q_NS": (tilt, tilt, heading)}, needs_origin=needs_origin, needs_field=is_magnetic)

    def build(self, mount: Pose) -> Attitude:
        return Attitude(mount, self)


class AttitudeMemory(Memory):
    """Errors of the filter, rad.

    Attributes:
        heading, tilt_x, tilt_y: slowly changing errors about down, north and east.
        turn_on: heading error that is constant during a run.
    """

    heading: Number = 0.0
    tilt_x: Number = 0.0
    tilt_y: Number = 0.0
    turn_on: Number = 0.0


_RECORD = record(
    [
        ("heading_sigma", "f8"), ("tilt_sigma", "f8"), ("tau", "f8"), ("noise", "f8"), ("secant", "i8"), ("steaming", "i8"),
        ("magnetic", "i8"), ("settling", "f8"),
    ],
    [("heading", "f8"), ("tilt_x", "f8"), ("tilt_y", "f8"), ("turn_on", "f8")],
)  # fmt: skip


@compiled
def _speed_error(surroundings: Array, v_N: Vec3) -> float:
    """Return the heading error (rad) of a gyrocompass without speed: it settles where the level has no rate about east (Titterton 2004, 13.4)."""
    place = place_of(surroundings)
    across, along = v_N[0] * place.curvature[0], v_N[1] * place.curvature[1]
    return math.atan2(across, place.rate[0] + along)


@compiled
def _with_errors(head: Any, row: Any, surroundings: Array, q: Quat) -> Quat:
    """Return q_NS turned by small errors about down, north and east."""
    m = row.m
    a, b = normals(head.key, head.number, SAMPLE, 0)
    c, d = normals(head.key, head.number, SAMPLE, 1)
    e, f = normals(head.key, head.number, SAMPLE, 2)
    decay = math.exp(-head.dt / row.tau)
    grow = math.sqrt(1.0 - decay * decay)
    m.heading = decay * m.heading + row.heading_sigma * grow * a
    m.tilt_x = decay * m.tilt_x + row.tilt_sigma * grow * b
    m.tilt_y = decay * m.tilt_y + row.tilt_sigma * grow * c
    heading = m.heading + m.turn_on + row.noise * d
    if row.secant != 0:
        heading /= math.cos(place_of(surroundings).latitude)
    if row.steaming != 0 and place_of(surroundings).rotating != 0:
        heading += _speed_error(surroundings, rotate(q_NB(head, surroundings), v_NB_B(head, surroundings)))
    disturbed: Quat = multiply(quat_from_rpy(m.tilt_x + row.noise * e, m.tilt_y + row.noise * f, heading), q)
    return disturbed


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write attitude and heading; invalid while the device settles."""
    q = q_NS(head, surroundings)
    if head.exact == 0:
        q = _with_errors(head, row, surroundings, q)
    if row.magnetic != 0:
        q = multiply(quat_from_rpy(0.0, 0.0, -place_of(surroundings).declination), q)
    out[0], out[1], out[2], out[3] = q
    out[4] = rpy_from_quat(q)[2] % (2.0 * math.pi)
    if head.exact == 0 and t < row.settling:
        out[:], head.valid = MISSING, 0


class Attitude(TableSensor[AttitudeConfig]):
    """Attitude of the sensor frame."""

    doc = "Attitude and heading, as an AHRS or gyrocompass computes them; invalid while it settles."
    fields = (
        Field("q_NS", "1", "attitude of the sensor frame, w x y z", "NS", (4,)),
        Field("heading", "rad", "direction of the sensor's x axis, clockwise from north, 0 to 2 pi"),
    )
    kernel = SensorKernel(_RECORD, loop(measure))
    random = ("heading_sigma", "tilt_sigma", "noise", "m.heading", "m.tilt_x", "m.tilt_y")
    memory_type = AttitudeMemory

    def fill(self, row: Any) -> None:
        c = self._config
        row["heading_sigma"], row["tilt_sigma"], row["tau"] = rad(c.heading_sigma_deg), rad(c.tilt_sigma_deg), c.tau_s
        row["noise"], row["secant"], row["magnetic"] = rad(c.noise_deg), c.secant_latitude, c.north == "magnetic"
        row["steaming"] = c.secant_latitude and not c.told_speed
        row["settling"] = c.settling_s

    def turn_on_row(self, memory: Any) -> None:
        """Draw the slow errors from their stationary distribution."""
        c, draws = self._config, self.drawn(4)
        memory["heading"] = rad(c.heading_sigma_deg) * draws[0]
        memory["tilt_x"], memory["tilt_y"] = rad(c.tilt_sigma_deg) * draws[1:3]
        memory["turn_on"] = rad(c.heading_turn_on_deg) * draws[3]
