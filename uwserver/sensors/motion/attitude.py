"""Attitude and heading reference system: the fused attitude that such a device outputs, with the errors of its filter."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Meta

from uwserver.frames import Quat, multiply, quat_from_rpy, rpy_from_quat
from uwserver.modifiers.base import Measurement, Memory, Number
from uwserver.ports import Field
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable
from uwserver.table import NonNegative, Positive
from uwserver.units import rad


class AttitudeConfig(SensorTable, tag="attitude", kw_only=True, frozen=True):
    """An AHRS or gyrocompass. Its errors are small rotations: of the horizontal plane (roll, pitch) and about the vertical (heading).

    Attributes:
        ideal: exact, whatever else is given.
        north: what the heading refers to: "true", or "magnetic", which is less by the declination (needs `[world] origin_lat_deg`).
        tilt_sigma_deg, heading_sigma_deg: standard deviation of slowly changing errors (Gauss-Markov).
        tau_s: their correlation time.
        heading_turn_on_deg: standard deviation of a constant error of heading, drawn once a run.
        noise_deg: standard deviation of white noise about each axis.
        secant_latitude: a gyrocompass finds north from the Earth's rotation: the errors of heading grow by 1 / cos(latitude).
        settling_s: from the start of a run until the output is valid.
    """

    ideal: bool = False
    north: Literal["true", "magnetic"] = "true"
    tilt_sigma_deg: NonNegative = 0.0
    heading_sigma_deg: NonNegative = 0.0
    tau_s: Positive = 60.0
    heading_turn_on_deg: NonNegative = 0.0
    noise_deg: Annotated[float, Meta(ge=0, le=10)] = 0.0
    secant_latitude: bool = False
    settling_s: NonNegative = 0.0

    @property
    def needs_origin(self) -> bool:
        """Whether the place on the Earth counts."""
        return self.secant_latitude or self.north == "magnetic"

    def build(self, mount: Pose) -> Attitude:
        return Attitude(mount, self)


class AttitudeMemory(Memory):
    """Errors of the filter, rad.

    Attributes:
        heading, tilt_x, tilt_y: slowly changing, about down, north and east.
        turn_on: of the heading, constant in a run.
    """

    heading: Number = 0.0
    tilt_x: Number = 0.0
    tilt_y: Number = 0.0
    turn_on: Number = 0.0


class Attitude(Sensor):
    """Attitude of the sensor frame."""

    doc = "Attitude and heading, as an AHRS or gyrocompass computes them; invalid while it settles."
    fields = (
        Field("q_NS", "1", "attitude of the sensor frame, w x y z", "NS", (4,)),
        Field("heading", "rad", "of the sensor's x axis, clockwise from north, 0 to 2 pi"),
    )

    memory: AttitudeMemory

    def __init__(self, mount: Pose, config: AttitudeConfig) -> None:
        self._mount, self._config = mount, config
        self._sigma = (rad(config.heading_sigma_deg), rad(config.tilt_sigma_deg), rad(config.tilt_sigma_deg))
        self._noise = rad(config.noise_deg)
        self._exact = config.ideal or not (any(self._sigma) or self._noise or config.heading_turn_on_deg)
        super().__init__()

    def turn_on(self) -> AttitudeMemory:
        """The slow errors stand at once in their stationary distribution."""
        heading, x, y = (s * d for s, d in zip(self._sigma, self.rng.standard_normal(3).tolist(), strict=True))
        return AttitudeMemory(heading, x, y, self.rng.standard_normal() * rad(self._config.heading_turn_on_deg))

    def sense(self, scope: Scope) -> Measurement:
        """Invalid while it settles."""
        c = self._config
        q = scope.attitude(self._mount.q)
        if not self._exact:
            q = self._disturbed(q, scope)
        if c.north == "magnetic":
            q = multiply(quat_from_rpy(0.0, 0.0, -scope.earth.declination), q)
        heading = rpy_from_quat(q)[2] % (2.0 * math.pi)
        if not c.ideal and scope.t < c.settling_s:
            return Measurement([(None,) * 4, None], False)
        return Measurement([q, heading], True)

    def _disturbed(self, q: Quat, scope: Scope) -> Quat:
        """q_NS turned by small errors about down, north and east."""
        m = self.memory
        draws = self.rng.standard_normal(6).tolist()
        decay = math.exp(-self.dt / self._config.tau_s)
        grow = math.sqrt(1.0 - decay * decay)
        m.heading = decay * m.heading + self._sigma[0] * grow * draws[0]
        m.tilt_x = decay * m.tilt_x + self._sigma[1] * grow * draws[1]
        m.tilt_y = decay * m.tilt_y + self._sigma[2] * grow * draws[2]
        heading = m.heading + m.turn_on + self._noise * draws[3]
        if self._config.secant_latitude:
            heading /= math.cos(scope.earth.latitude)
        error = quat_from_rpy(m.tilt_x + self._noise * draws[4], m.tilt_y + self._noise * draws[5], heading)
        return multiply(error, q)
