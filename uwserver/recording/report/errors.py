"""Computes the errors of sensors against the truth, and the standard deviations that their configuration gives.

Samples are compared at their own times and at the place of the sensor. The standard deviation comes from the tables of the sensor and its modifiers,
including constant errors that are drawn once per run. A wrong sound speed, an outlier or a fault is not part of it, so it appears as a larger
error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from msgspec import UnsetType

from uwserver.environment.column import WaterColumn, uniform_column
from uwserver.environment.earth import EARTH_RATE, north_east
from uwserver.recording.report.reading import FloatArray, IntArray, Recorded, Series
from uwserver.recording.report.truth import Mount, Truth, mount_of, rotations, small_angles
from uwserver.scenario.world.tables import Environment
from uwserver.sensors.motion.triad import HUMP
from uwserver.units import STANDARD_ATMOSPHERE_PA, deg, rad

BOUND = 3.0
"""Number of standard deviations at which bounds are drawn."""
_XYZ = ("x", "y", "z")
_NED = ("north", "east", "down")


@dataclass(frozen=True)
class SensorError:
    """The error of one field of a sensor, or of an estimate.

    Attributes:
        path: path of the port.
        title: the quantity.
        unit: unit of `error` and `sigma`.
        labels: names of the k components.
        t: (n) s.
        error: (n, k) measured minus true.
        sigma: (n, k) standard deviation; None if no table gives one.
    """

    path: str
    title: str
    unit: str
    labels: tuple[str, ...]
    t: FloatArray
    error: FloatArray
    sigma: FloatArray | None

    @property
    def inside(self) -> float | None:
        """Return the share of the numbers within three standard deviations, 0 to 1; None if it is unknown."""
        if self.sigma is None:
            return None
        good = np.isfinite(self.error)
        return float(np.mean(np.abs(self.error)[good] <= BOUND * self.sigma[good])) if good.any() else None

    @property
    def rms(self) -> float:
        """Return the root mean square over all components, without NaN."""
        return float(np.sqrt(np.nanmean(self.error**2)))


def sensor_errors(recorded: Recorded, vehicle: str, truth: Truth) -> Iterator[SensorError]:
    """Yield the errors of all sensors and estimates of a vehicle whose true values the recording gives."""
    file = recorded.scenario.get("vehicles", {}).get(vehicle, {}).get("vehicle", {})
    tables, mounts = file.get("sensors", {}), file.get("mounts", {})
    scenario = recorded.scenario["scenario"]
    world, environment = scenario.get("world", {}), scenario.get("environment", {})
    for path, series in recorded.series.items():
        _, _, below = path.partition("/")
        name, _, stream = below.partition("/")
        compare = _COMPARED.get(series.message)
        if series.vehicle != vehicle or compare is None or series.direction != "sensor":
            continue
        table = dict(tables.get(name, {}))
        if stream and isinstance(table.get("streams"), Mapping):
            table |= {"modifiers": {}, **table["streams"].get(stream, {})}
        chosen = truth.pairs(series.t)
        chosen = chosen[series.valid[chosen]]
        if len(chosen) > 1:
            yield from compare(_Case(world, environment, series, truth, table, mount_of(table, mounts), chosen))


@dataclass(frozen=True)
class _Case:
    """A sensor with everything that the comparison needs.

    Attributes:
        world, environment: tables of the scenario.
        series: samples of the sensor.
        truth: true motion of the vehicle.
        table: table of the sensor.
        mount: place of the sensor.
        chosen: indices (n) of the samples that are compared.
    """

    world: Mapping[str, Any]
    environment: Mapping[str, Any]
    series: Series
    truth: Truth
    table: Mapping[str, Any]
    mount: Mount
    chosen: IntArray

    @property
    def t(self) -> FloatArray:
        return self.series.t[self.chosen]

    def measured(self, name: str) -> FloatArray:
        """Return the values (n, k) of a field."""
        return self.series.columns[name][self.chosen]

    def R_NB(self) -> FloatArray:
        return rotations(self.truth.at(self.t, "q_NB"))

    def p_NS(self) -> FloatArray:
        return self.truth.at(self.t, "p_NB") + self.R_NB() @ self.mount.p

    def v_NS_B(self) -> FloatArray | None:
        """Return the velocity of the mount, in B."""
        if self.truth.v_NB_B is None or self.truth.w_NB_B is None:
            return None
        return self.truth.at(self.t, "v_NB_B") + np.cross(self.truth.at(self.t, "w_NB_B"), self.mount.p)

    def error(self, field: str, title: str, labels: tuple[str, ...], error: FloatArray, own: FloatArray) -> SensorError:
        """Return an error with the standard deviation of the sensor itself, `own` (n, k) or (k), and of the modifiers of the field."""
        port = self.series.fields[field]
        sigma = np.sqrt(np.broadcast_to(own, error.shape) ** 2 + self.modified(field, error.shape))
        path = self.series.path
        return SensorError(path, title, port.unit, labels, self.t, error, sigma if sigma.any() else None)

    def modified(self, field: str, shape: tuple[int, ...]) -> FloatArray:
        """Return the variance (n, k) of the modifiers of a field, as their kinds define it."""
        total = np.zeros(shape)
        elapsed = self.t[:, None]
        for m in self.table.get("modifiers", {}).values():
            if m.get("field") != field:
                continue
            sigma, density = np.asarray(m.get("sigma", 0.0), dtype=float), float(m.get("density", 0.0))
            match m["kind"]:
                case "white_noise":
                    total = total + sigma**2 + density**2 * float(self.table.get("rate_hz", 0.0))
                case "bias":
                    total = total + sigma**2 + np.asarray(m.get("value", 0.0), dtype=float) ** 2
                case "gauss_markov":
                    total = total + sigma**2
                case "random_walk":
                    total = total + density**2 * elapsed
                case "drift":
                    rate, scatter = (np.asarray(m.get(k, 0.0), dtype=float) for k in ("rate", "rate_sigma"))
                    total = total + (rate**2 + scatter**2) * elapsed**2 + density**2 * elapsed
                case "quantise":
                    total = total + float(m.get("step", 0.0)) ** 2 / 12.0
        return total

    def number(self, name: str) -> float:
        """Return a number of the sensor's table; 0 for an ideal sensor."""
        return 0.0 if self.table.get("ideal") else float(self.table.get(name, 0.0))


_NONE = np.zeros(1)


def _position(case: _Case) -> Iterator[SensorError]:
    yield case.error("p_NS", "position", _NED, case.measured("p_NS") - case.p_NS(), _NONE)
    yield _turned(case, "q_NS", "attitude", _NONE)


def _attitude(case: _Case) -> Iterator[SensorError]:
    heading = math.hypot(case.number("heading_sigma_deg"), case.number("heading_turn_on_deg"), case.number("noise_deg"))
    tilt = math.hypot(case.number("tilt_sigma_deg"), case.number("noise_deg"))
    if case.table.get("secant_latitude"):
        heading /= math.cos(rad(float(case.world.get("origin_lat_deg", 0.0))))
    found = _turned(case, "q_NS", "attitude", np.array([tilt, tilt, heading]))
    if case.table.get("north") == "magnetic":  # its heading differs from the true one by the declination
        sigma = None if found.sigma is None else found.sigma[:, :2]
        found = SensorError(found.path, "tilt", "deg", found.labels[:2], found.t, found.error[:, :2], sigma)
    yield found


def _turned(case: _Case, field: str, title: str, sigma_deg: FloatArray) -> SensorError:
    """Return an error as small rotations about the axes of N, in degrees. Modifiers of the quaternion are not counted."""
    true = case.R_NB() if field == "q_NB" else case.R_NB() @ case.mount.R
    error = small_angles(rotations(case.measured(field)) @ np.swapaxes(true, 1, 2)) * deg(1.0)
    sigma = np.broadcast_to(sigma_deg, error.shape)
    labels = ("about north", "about east", "heading")
    return SensorError(case.series.path, title, "deg", labels, case.t, error, sigma if sigma.any() else None)


def _gps(case: _Case) -> Iterator[SensorError]:
    world = case.world
    if "origin_lat_deg" not in world or "origin_lon_deg" not in world:
        return
    origin = rad(float(world["origin_lat_deg"])), rad(float(world["origin_lon_deg"]))
    north, east = north_east(case.measured("latitude")[:, 0], case.measured("longitude")[:, 0], *origin)
    place = np.stack([north, east, -case.measured("height")[:, 0]], axis=1)
    noise = case.number("noise_m")
    across, down = (math.hypot(case.number(f"{way}_sigma_m"), noise) for way in ("horizontal", "vertical"))
    yield case.error("height", "position", _NED, place - case.p_NS(), np.array([across, across, down]))
    v = case.v_NS_B()
    if v is not None:
        true = np.einsum("nij,nj->ni", case.R_NB(), v)
        own = np.array([case.number("velocity_sigma_mps")])
        yield case.error("v_NS", "velocity", _NED, case.measured("v_NS") - true, own)


def _dvl(case: _Case) -> Iterator[SensorError]:
    v = case.v_NS_B()
    if v is None:
        return
    true = v @ case.mount.R
    device = np.zeros(true.shape)
    covariance = case.series.columns.get("covariance_S")
    if covariance is not None:
        device = np.sqrt(np.clip(covariance[case.chosen][:, [0, 4, 8]], 0.0, None))
    scale = math.hypot(case.number("scale_sigma"), case.number("scale_error"))
    own = np.hypot(device, scale * np.abs(true))
    yield case.error("v_S", "velocity over ground", _XYZ, case.measured("v_S") - true, own)


def _pressure(case: _Case) -> Iterator[SensorError]:
    depth = case.p_NS()[:, 2] + float(case.environment.get("surface_level_m", 0.0))
    if "depth" in case.series.columns:
        yield case.error("depth", "depth", ("depth",), case.measured("depth") - depth[:, None], _NONE)
        return
    column = _column(case.environment)
    if column is not None:
        air = float(case.environment.get("atmospheric_pressure_pa", STANDARD_ATMOSPHERE_PA))
        true = air + np.interp(depth, column.depth, column.pressure)
        yield case.error("pressure", "pressure", ("pressure",), case.measured("pressure") - true[:, None], _NONE)


def _environment(table: Mapping[str, Any]) -> Environment | None:
    """Return the tables of the sea; None if they are of another version."""
    try:
        return msgspec.convert(dict(table), Environment)
    except (msgspec.MsgspecError, TypeError, ValueError):
        return None


def _column(table: Mapping[str, Any]) -> WaterColumn | None:
    """Return the still water of a scenario; None if it is unknown."""
    sea = _environment(table)
    if sea is None:
        return None
    if isinstance(sea.water, UnsetType):
        return uniform_column(sea.density, sea.temperature_degc, sea.gravity, sea.growth)
    return WaterColumn(sea.water, sea.gravity, sea.density, sea.growth)


def _imu(case: _Case) -> Iterator[SensorError]:
    if case.truth.w_NB_B is None:
        return
    R_NB, R_BS = case.R_NB(), case.mount.R
    w = case.truth.at(case.t, "w_NB_B")
    turning = np.einsum("nji,j->ni", R_NB, _earth_rate(case.world))
    yield _triad(case, "w_S", "angular rate", "gyroscope", (w + turning) @ R_BS)
    sea = _environment(case.environment)
    if case.truth.v_dot_B is None or case.truth.v_NB_B is None or sea is None:
        return
    v, a, w_dot = (case.truth.at(case.t, name) for name in ("v_NB_B", "v_dot_B", "w_dot_B"))
    r, depth = case.mount.p, case.p_NS()[:, 2:]
    down = R_NB[:, 2, :] * sea.gravity * (1.0 + sea.growth * depth)
    force = a + np.cross(w + 2.0 * turning, v) + np.cross(w_dot, r) + np.cross(w, np.cross(w, r)) - down
    yield _triad(case, "f_S", "specific force", "accelerometer", force @ R_BS)


def _triad(case: _Case, field: str, title: str, table: str, true: FloatArray) -> SensorError:
    """Return the error of a triad; its standard deviation follows `uwserver.sensors.motion.triad.TriadErrors`."""
    e: Mapping[str, Any] = {} if case.table.get("ideal") else case.table.get(table, {})

    def number(name: str) -> float:
        return float(e.get(name, 0.0))

    steady = number("noise_density") ** 2 * float(case.table.get("rate_hz", 0.0)) + number("turn_on") ** 2
    steady += (number("instability") / HUMP) ** 2 + number("resolution") ** 2 / 12.0
    others = np.sum(true**2, axis=1, keepdims=True) - true**2
    moving = (number("scale") * true) ** 2 + number("cross_axis") ** 2 * others
    own = np.sqrt(steady + moving + number("random_walk") ** 2 * case.t[:, None])
    return case.error(field, title, _XYZ, case.measured(field) - true, own)


def _earth_rate(world: Mapping[str, Any]) -> FloatArray:
    if world.get("earth") != "rotating" or "origin_lat_deg" not in world:
        return np.zeros(3)
    latitude = rad(float(world["origin_lat_deg"]))
    return EARTH_RATE * np.array([math.cos(latitude), 0.0, -math.sin(latitude)])


def _estimate(case: _Case) -> Iterator[SensorError]:
    """Yield the errors of the estimate of the built-in autopilot. No table gives its standard deviation."""
    p = case.truth.at(case.t, "p_NB")
    yield SensorError(case.series.path, "estimated position", "m", _NED, case.t, case.measured("p_N") - p, None)
    if case.truth.v_NB_B is not None:
        v = np.einsum("nij,nj->ni", case.R_NB(), case.truth.at(case.t, "v_NB_B"))
        yield SensorError(case.series.path, "estimated velocity", "m/s", _NED, case.t, case.measured("v_N") - v, None)
    yield _turned(case, "q_NB", "estimated attitude", _NONE)


_COMPARED: Mapping[str, Callable[[_Case], Iterator[SensorError]]] = {
    "Pose": _position,
    "Attitude": _attitude,
    "NavSatFix": _gps,
    "Dvl": _dvl,
    "FluidPressure": _pressure,
    "Imu": _imu,
    "Estimate": _estimate,
}
