"""GPS receiver: position and velocity while the antenna is above the water. After a dive it needs some time for the first fix."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from uwserver.modifiers.base import NEVER, Memory, Time
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, normals
from uwserver.ports import Argument, Field
from uwserver.sensors.base import Pose, SensorTable, Settings, Traits
from uwserver.sensors.compiled import (
    MISSING,
    SensorKernel,
    TableSensor,
    latitude_longitude,
    loop,
    p_NS,
    place_of,
    q_NB,
    record,
    rotate,
    submergence,
    velocity_of,
)
from uwserver.table import NonNegative, Positive

_Error = Annotated[float, Meta(ge=-1e6, le=1e6)]


class GpsConfig(SensorTable, tag="gps", kw_only=True, frozen=True):
    """A GPS receiver; its mount is the antenna. It needs `[world] origin_lat_deg` and `origin_lon_deg`.

    Attributes:
        ideal: exact, with a fix whenever the antenna is in air.
        horizontal_sigma_m, vertical_sigma_m: standard deviation of the slowly changing position error, of each horizontal axis and of the height.
        tau_s: correlation time of that error.
        noise_m: standard deviation of white noise on each axis.
        velocity_sigma_mps: standard deviation of white noise on each axis of the velocity.
        clearance_m: height above the water that the antenna needs.
        hot_fix_s: time from surfacing to the first fix after a dive.
        cold_after_s: a dive longer than this needs a cold start, and so does the first fix of a run.
        cold_fix_s: duration of a cold start; with 0 a run begins with a fix.
        satellites: in view.
    """

    message = "NavSatFix"
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

    def traits(self) -> Traits:
        """Declare that it needs the position on the Earth."""
        return Traits(needs_origin=True)

    def build(self, mount: Pose) -> Gps:
        return Gps(mount, self)


class GpsSettings(Settings, frozen=True):
    """Settings with which to simulate a jammer or a canyon."""

    satellites: Annotated[int, Meta(ge=0, le=64)]


class GpsMemory(Memory):
    """Attributes:
    error: slowly changing position error north, east, down, m.
    up_since: time since which the antenna is in air, s; `NEVER` under water.
    lost_at: time at which the last fix ended, s; `NEVER` before the first one."""

    error: tuple[_Error, _Error, _Error] = (0.0, 0.0, 0.0)
    up_since: Time = NEVER
    lost_at: Time = NEVER


_RECORD = record(
    [
        ("horizontal", "f8"), ("vertical", "f8"), ("tau", "f8"), ("noise", "f8"), ("velocity", "f8"), ("clearance", "f8"), ("hot", "f8"),
        ("cold_after", "f8"), ("cold", "f8"), ("satellites", "i8"),
    ],
    [("error", "f8", (3,)), ("up_since", "f8"), ("lost_at", "f8")],
)  # fmt: skip


@compiled
def _start_up(row: Any, up_since: float) -> float:
    """Return the time from surfacing to the first fix, s."""
    cold = row.m.lost_at == NEVER or up_since - row.m.lost_at > row.cold_after
    return float(row.cold if cold else row.hot)


@compiled
def _has_fix(row: Any, hears: bool, t: float) -> bool:
    m = row.m
    if not hears:
        if m.up_since != NEVER and t - m.up_since >= _start_up(row, m.up_since):
            m.lost_at = t
        m.up_since = NEVER
        return False
    if m.up_since == NEVER:
        m.up_since = t
    return bool(t - m.up_since >= _start_up(row, m.up_since))


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write the fix; invalid without one."""
    m, key, number = row.m, head.key, head.number
    decay = math.exp(-head.dt / row.tau)
    grow = math.sqrt(1.0 - decay * decay)
    a, b = normals(key, number, SAMPLE, 0)
    c, d = normals(key, number, SAMPLE, 1)
    e, f = normals(key, number, SAMPLE, 2)
    m.error[0] = decay * m.error[0] + grow * row.horizontal * a
    m.error[1] = decay * m.error[1] + grow * row.horizontal * b
    m.error[2] = decay * m.error[2] + grow * row.vertical * c
    p, place, whole, s = p_NS(head, surroundings), place_of(surroundings), out.view(np.int64), 1.0 - head.exact
    in_air = -submergence(surroundings, p, t) > s * row.clearance
    satellites = row.satellites if in_air else 0
    hears = in_air and satellites >= 4
    if not (hears if head.exact != 0 else _has_fix(row, hears, t)):
        out[:], head.valid = MISSING, 0
        whole[9], whole[10] = satellites, 0
        return
    north, east = p[0] + s * (m.error[0] + row.noise * d), p[1] + s * (m.error[1] + row.noise * e)
    out[0], out[1] = latitude_longitude(north, east, place.latitude, place.longitude)
    out[2] = -(p[2] + s * (m.error[2] + row.noise * f))
    vx, vy, vz = rotate(q_NB(head, surroundings), velocity_of(head, surroundings))
    a, b = normals(key, number, SAMPLE, 3)
    c, _ = normals(key, number, SAMPLE, 4)
    speed = s * row.velocity
    out[3], out[4], out[5] = vx + speed * a, vy + speed * b, vz + speed * c
    out[6], out[7] = s * math.hypot(row.horizontal, row.noise), s * math.hypot(row.vertical, row.noise)
    out[8] = speed
    whole[9], whole[10] = satellites, 3


class Gps(TableSensor[GpsConfig]):
    """Position fixes. A fix needs four satellites."""

    doc = "GPS: position (WGS 84) and velocity of the antenna; no values under water and for some time after surfacing."
    fields = (
        Field("latitude", "rad", "geodetic latitude, positive north"),
        Field("longitude", "rad", "longitude, positive east"),
        Field("height", "m", "height above the sea surface at rest"),
        Field("v_NS", "m/s", "velocity of the antenna", "N", (3,)),
        Field("horizontal_accuracy", "m", "standard deviation of each horizontal axis, as the receiver estimates it"),
        Field("vertical_accuracy", "m", "standard deviation of the height, as the receiver estimates it"),
        Field(
            "velocity_accuracy", "m/s", "standard deviation of each axis of the velocity, as the receiver estimates it"
        ),
        Field("satellites", "1", "number of satellites in use; 0 under water", type="int"),
        Field("fix", "1", "0 none, 3 three-dimensional", type="int"),
    )
    kernel = SensorKernel(_RECORD, loop(measure))
    random = ("horizontal", "vertical", "noise", "velocity", "m.error")
    memory_type = GpsMemory
    settings: GpsSettings

    def __init__(self, mount: Pose, config: GpsConfig) -> None:
        self.arguments = (
            Argument(
                "satellites",
                "int",
                "satellites in view; fewer than 4 give no fix",
                required=False,
                minimum=0,
                maximum=64,
            ),
        )
        super().__init__(mount, config, GpsSettings(config.satellites))

    def fill(self, row: Any) -> None:
        c = self._config
        row["horizontal"], row["vertical"], row["tau"] = c.horizontal_sigma_m, c.vertical_sigma_m, c.tau_s
        row["noise"], row["velocity"], row["clearance"] = c.noise_m, c.velocity_sigma_mps, c.clearance_m
        row["hot"], row["cold_after"], row["cold"] = c.hot_fix_s, c.cold_after_s, c.cold_fix_s
        row["satellites"] = self.settings.satellites

    def turn_on_row(self, memory: Any) -> None:
        """Draw the error from its stationary distribution."""
        c = self._config
        memory["error"] = self.drawn(3) * (c.horizontal_sigma_m, c.horizontal_sigma_m, c.vertical_sigma_m)
        memory["up_since"] = memory["lost_at"] = NEVER
