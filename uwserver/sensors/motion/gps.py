"""GPS receiver: position and velocity while the antenna is above the water, found again some time after it was under."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from msgspec import Meta, structs

from uwserver.environment.geodesy import latitude_longitude
from uwserver.frames import rotate
from uwserver.modifiers.base import NEVER, Measurement, Memory, Time
from uwserver.ports import Argument, Field
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable, Settings
from uwserver.table import NonNegative, Positive

_Error = Annotated[float, Meta(ge=-1e6, le=1e6)]


class GpsConfig(SensorTable, tag="gps", kw_only=True, frozen=True):
    """A GPS receiver; its mount is the antenna. It needs `[world] origin_lat_deg` and `origin_lon_deg`.

    Attributes:
        ideal: exact, with a fix in the very moment in which the antenna is in the air.
        horizontal_sigma_m, vertical_sigma_m: standard deviation of the position's slowly changing error, each horizontal axis and height.
        tau_s: its correlation time.
        noise_m: standard deviation of white noise of each axis.
        velocity_sigma_mps: standard deviation of white noise of each axis of the velocity.
        clearance_m: height over the water that the antenna needs.
        hot_fix_s: from surfacing to the first fix after a dive.
        cold_after_s: a dive longer than this needs a cold start; the first fix of a run too.
        cold_fix_s: how long that takes; 0 begins the run with a fix.
        satellites: in view.
    """

    needs_origin: ClassVar[bool] = True
    ideal: bool = False
    horizontal_sigma_m: NonNegative = 0.0
    vertical_sigma_m: NonNegative = 0.0
    tau_s: Positive = 300.0
    noise_m: NonNegative = 0.0
    velocity_sigma_mps: NonNegative = 0.0
    clearance_m: NonNegative = 0.0
    hot_fix_s: NonNegative = 0.0
    cold_after_s: Positive = 7200.0
    cold_fix_s: NonNegative = 0.0
    satellites: Annotated[int, Meta(ge=0, le=64)] = 12

    def build(self, mount: Pose) -> Gps:
        return Gps(mount, self)


class GpsSettings(Settings, frozen=True):
    """What a jammer or a canyon takes away."""

    satellites: Annotated[int, Meta(ge=0, le=64)]


class GpsMemory(Memory):
    """Attributes:
    error: slowly changing, of the position north, east, down, m.
    up_since: since when the antenna is in the air, s; `NEVER` under water.
    lost_at: when the last fix ended, s; `NEVER` before the first."""

    error: tuple[_Error, _Error, _Error] = (0.0, 0.0, 0.0)
    up_since: Time = NEVER
    lost_at: Time = NEVER


class Gps(Sensor):
    """Position fixes; with fewer than four satellites there is none."""

    doc = (
        "GPS: position (WGS 84) and velocity of the antenna; no values under water, nor for some time after surfacing."
    )
    fields = (
        Field("latitude", "rad", "geodetic latitude, positive north"),
        Field("longitude", "rad", "longitude, positive east"),
        Field("height", "m", "above the sea surface at rest"),
        Field("v_NS", "m/s", "velocity of the antenna", "N", (3,)),
        Field("horizontal_accuracy", "m", "standard deviation of each horizontal axis, as the receiver believes"),
        Field("vertical_accuracy", "m", "standard deviation of the height, as the receiver believes"),
        Field("velocity_accuracy", "m/s", "standard deviation of each axis of the velocity, as the receiver believes"),
        Field("satellites", "1", "number used; 0 under water", type="int"),
        Field("fix", "1", "0 none, 3 three-dimensional", type="int"),
    )
    settings: GpsSettings
    memory: GpsMemory

    def __init__(self, mount: Pose, config: GpsConfig) -> None:
        self._mount, self._config = mount, config
        if config.ideal:
            exact = {"horizontal_sigma_m": 0.0, "vertical_sigma_m": 0.0, "noise_m": 0.0, "velocity_sigma_mps": 0.0}
            self._config = structs.replace(config, **exact, hot_fix_s=0.0, cold_fix_s=0.0, clearance_m=0.0)
        self.arguments = (
            Argument("satellites", "int", "in view; fewer than 4 give no fix", required=False, minimum=0, maximum=64),
        )
        super().__init__(GpsSettings(config.satellites))

    def turn_on(self) -> GpsMemory:
        """The error stands at once in its stationary distribution."""
        c = self._config
        north, east, down = self.rng.standard_normal(3).tolist()
        return GpsMemory((c.horizontal_sigma_m * north, c.horizontal_sigma_m * east, c.vertical_sigma_m * down))

    def sense(self, scope: Scope) -> Measurement:
        """Invalid without a fix."""
        c, m = self._config, self.memory
        draws = self.rng.standard_normal(9).tolist()
        decay = math.exp(-self.dt / c.tau_s)
        flat = math.sqrt(1.0 - decay * decay) * c.horizontal_sigma_m
        steep = math.sqrt(1.0 - decay * decay) * c.vertical_sigma_m
        north, east, down = m.error
        m.error = (decay * north + flat * draws[0], decay * east + flat * draws[1], decay * down + steep * draws[2])
        x, y, z = scope.position(self._mount.p)
        in_air = -scope.submergence((x, y, z)) > c.clearance_m
        satellites = self.settings.satellites if in_air else 0
        if not self._has_fix(in_air and satellites >= 4, scope.t):
            return Measurement([None, None, None, (None,) * 3, None, None, None, satellites, 0], False)
        north, east, down = (error + c.noise_m * draw for error, draw in zip(m.error, draws[3:6], strict=True))
        latitude, longitude = latitude_longitude(x + north, y + east, scope.earth.latitude, scope.earth.longitude)
        vx, vy, vz = rotate(scope.q_NB, scope.velocity_of(self._mount.p))
        s = c.velocity_sigma_mps
        velocity = (vx + s * draws[6], vy + s * draws[7], vz + s * draws[8])
        horizontal = math.hypot(c.horizontal_sigma_m, c.noise_m)
        vertical = math.hypot(c.vertical_sigma_m, c.noise_m)
        return Measurement([latitude, longitude, -(z + down), velocity, horizontal, vertical, s, satellites, 3], True)

    def _has_fix(self, hears: bool, t: float) -> bool:
        m = self.memory
        if not hears:
            if m.up_since != NEVER and t - m.up_since >= self._start_up(m.up_since):
                m.lost_at = t
            m.up_since = NEVER
            return False
        if m.up_since == NEVER:
            m.up_since = t
        return t - m.up_since >= self._start_up(m.up_since)

    def _start_up(self, up_since: float) -> float:
        lost = self.memory.lost_at
        cold = lost == NEVER or up_since - lost > self._config.cold_after_s
        return self._config.cold_fix_s if cold else self._config.hot_fix_s
