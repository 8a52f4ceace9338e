"""Attitude and heading reference system: the fused attitude that such a device outputs, with the errors of its filter."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Meta

from uwserver.frames import Quat, multiply, quat_from_rpy, rpy_from_quat
from uwserver.modifiers.base import Measurement
from uwserver.ports import Field
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable
from uwserver.table import NonNegative, Positive
from uwserver.units import rad

_HEADING, _TILT_X, _TILT_Y, _TURN_ON = range(4)


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
        """The instrument."""
        return Attitude(mount, self)


class Attitude(Sensor):
    """Attitude of the sensor frame."""

    doc = "Attitude and heading, as an AHRS or gyrocompass computes them; invalid while it settles."
    fields = (
        Field("q_NS", "1", "attitude of the sensor frame, w x y z", "NS", (4,)),
        Field("heading", "rad", "of the sensor's x axis from north, 0 to 2 pi, clockwise"),
    )

    def __init__(self, mount: Pose, config: AttitudeConfig) -> None:
        self._mount, self._config = mount, config
        self._sigma = (rad(config.heading_sigma_deg), rad(config.tilt_sigma_deg), rad(config.tilt_sigma_deg))
        self._noise = rad(config.noise_deg)
        self._exact = config.ideal or not (any(self._sigma) or self._noise or config.heading_turn_on_deg)
        super().__init__()

    def turn_on(self) -> list[float]:
        """Errors of heading and of the two horizontal axes, and the constant one of heading; rad."""
        slow = self.rng.standard_normal(3)
        constant = float(self.rng.standard_normal()) * rad(self._config.heading_turn_on_deg)
        return [*(sigma * float(draw) for sigma, draw in zip(self._sigma, slow, strict=True)), constant]

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
        for i in range(3):
            m[i] = decay * m[i] + self._sigma[i] * math.sqrt(1.0 - decay * decay) * draws[i]
        heading = m[_HEADING] + m[_TURN_ON] + self._noise * draws[3]
        if self._config.secant_latitude:
            heading /= math.cos(scope.earth.latitude)
        error = quat_from_rpy(m[_TILT_X] + self._noise * draws[4], m[_TILT_Y] + self._noise * draws[5], heading)
        return multiply(error, q)
