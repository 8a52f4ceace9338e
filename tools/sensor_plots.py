"""Draws docs/images/sensors_*.png and sensor_<kind>.png: what the navigation, water and vehicle sensors put out, from the sensors themselves."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt

from uwserver.cli.recordings.pictures import picture
from uwserver.environment.column import ThermoclineColumn, WaterColumn, absorption
from uwserver.environment.water import Water
from uwserver.frames import IDENTITY
from uwserver.physics.kernel.arrays import Pool
from uwserver.physics.kernel.random import key_of
from uwserver.ports import Sample
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import WorldTable
from uwserver.sensors import BatteryConfig, GpsConfig, ImuConfig, Pose, Scope
from uwserver.sensors.compiled import HEAD, read
from uwserver.sensors.motion.imu import Imu
from uwserver.sensors.surroundings import ScopeArrays

IMAGES = Path(__file__).parents[1] / "docs" / "images"


def water_column() -> None:
    """A thermocline: temperature, sound speed, density; and absorption over frequency."""
    config = ThermoclineColumn(
        surface_temperature_degc=16, deep_temperature_degc=7, surface_salinity_psu=32, deep_salinity_psu=34.8, depth_m=25, thickness_m=12
    )  # fmt: skip
    column = WaterColumn(config, 9.81, 1025.0)
    near = column.depth <= 100.0
    figure, axes = plt.subplots(1, 4, figsize=(9, 3), constrained_layout=True)
    for axis, values, name in (
        (axes[0], column.temperature, "temperature, °C"),
        (axes[1], column.sound_speed, "sound speed, m/s"),
        (axes[2], column.density, "density, kg/m³"),
    ):
        axis.plot(values[near], column.depth[near])
        axis.invert_yaxis()
        axis.set_xlabel(name)
    axes[0].set_ylabel("depth, m")
    frequency = np.geomspace(1e4, 2e6, 200)
    axes[3].loglog(frequency / 1e3, [absorption(f, 8.0, 35.0, 50.0) * 1e3 for f in frequency], label="sea")
    axes[3].loglog(frequency / 1e3, [absorption(f, 10.0, 0.05, 50.0, 7.0) * 1e3 for f in frequency], label="lake")
    axes[3].set_xlabel("frequency, kHz")
    axes[3].set_ylabel("absorption, dB/km")
    axes[3].legend()
    figure.savefig(IMAGES / "sensors_water.png", dpi=80)


def imu_grades() -> None:
    """Allan deviation of the gyroscopes at rest, as a user would compute it from samples."""
    figure, axis = plt.subplots(figsize=(6, 3.2), constrained_layout=True)
    text = 'schema = 1\n[vehicles.rov]\nmodel = "bluerov2_heavy"\n' + "".join(
        f'[vehicles.rov.sensors.x_{name}]\nprofile = "{name}"\nrate_hz = 1\n' for name in ("mems_imu", "tactical_imu", "fog_imu")
    )  # fmt: skip
    path = IMAGES / "sensors.toml"
    path.write_text(text, encoding="utf-8")
    sensors = load(path, adapters={}).vehicles["rov"].vehicle.sensors
    path.unlink()
    for name, config in sensors.items():
        if not name.startswith("x_") or not isinstance(config, ImuConfig):
            continue
        tau, deviation = _allan(config, 40_000)
        axis.loglog(tau, np.degrees(deviation) * 3600.0, label=name.removeprefix("x_"))
    axis.set_xlabel("averaging time, s")
    axis.set_ylabel("gyroscope, °/h")
    axis.grid(alpha=0.3, which="both")
    axis.legend()
    figure.savefig(IMAGES / "sensors_imu.png", dpi=80)


def _allan(config: ImuConfig, n: int) -> tuple[list[float], list[float]]:
    """Return averaging times (s) and the Allan deviations (rad/s) of n readings, one a second, of gyroscopes at rest."""
    water = Water(1025.0, 9.81, 10.0, 101_325.0, (0.0, 0.0, 0.0))
    scope = Scope(0, (0.0, 0.0, 5.0), IDENTITY, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), water)
    heads, rows, numbers = Pool(HEAD, 1), Pool(Imu.kernel.record, 1), np.zeros(7)
    imu = config.build(Pose())
    imu.start(key_of(1, "plot"))
    imu.enter(heads, rows)
    heads.rows["width"], heads.rows["dt"] = len(numbers), 1.0
    table, due, record = ScopeArrays(scope).table, np.arange(1), np.empty((n, 3))
    for number in range(n):
        heads.rows["number"] = number
        read(Imu.kernel, heads.rows, rows.rows, numbers, due, table, 0.0, scope.geometry)
        record[number] = numbers[3:6]
    angle = np.cumsum(record, axis=0)
    taus = [m for m in (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096) if 8 * m < n]
    second = [angle[2 * m :] - 2 * angle[m:-m] + angle[: -2 * m] for m in taus]
    return [float(m) for m in taus], [
        math.sqrt(float(np.mean(s**2)) / (2.0 * m * m)) for s, m in zip(second, taus, strict=True)
    ]


def vehicle() -> None:
    """GPS before, during and after a dive; battery under changing load."""
    entry = VehicleEntry(
        model="bluerov2_heavy",
        position_ned_m=(0.0, 0.0, -0.05),
        sensors={
            "gps": GpsConfig(rate_hz=5, horizontal_sigma_m=2.1, vertical_sigma_m=3.2, tau_s=60, hot_fix_s=5.0, position_frd_m=(0, 0, -0.3)),
            "battery": BatteryConfig(rate_hz=20, resistance_ohm=0.042, hotel_load_W=18.0),
        },
    )  # fmt: skip
    place = WorldTable(origin_lat_deg=63.43, origin_lon_deg=10.40)
    world = build(load(Scenario(schema=1, world=place, vehicles={"rov": entry}), adapters={}))
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), constrained_layout=True)
    rows: dict[str, list[tuple[float, ...]]] = {"rov/gps": [], "rov/battery": []}
    for second in range(60):
        u = 0.6 if 15 <= second < 25 else -0.6 if 25 <= second < 37 else 0.0
        world.command("rov/thrusters", u=[0.0] * 4 + [u] * 4)
        for sample in world.step(240):
            if sample.port == "rov/gps":
                rows[sample.port].append((sample.t_ns * 1e-9, float(sample.valid), world.vehicles["rov"].p_NB[2]))
            elif sample.port == "rov/battery":
                rows[sample.port].append((sample.t_ns * 1e-9, float(sample.value[0]), float(sample.value[1])))  # type: ignore[arg-type]
    gps, battery = np.array(rows["rov/gps"]), np.array(rows["rov/battery"])
    left.plot(gps[:, 0], gps[:, 2], label="depth, m")
    left.fill_between(gps[:, 0], *left.get_ylim(), where=gps[:, 1] > 0, alpha=0.2, label="GPS fix")
    left.invert_yaxis()
    left.legend()
    right.plot(battery[:, 0], battery[:, 1], label="voltage, V")
    right.plot(battery[:, 0], battery[:, 2], label="current, A")
    right.legend()
    for axis in (left, right):
        axis.set_xlabel("time, s")
    figure.savefig(IMAGES / "sensors_vehicle.png", dpi=80)


_STAGE = """\
schema = 1
seed = 5
[world]
origin_lat_deg = 63.43
origin_lon_deg = 10.40
[environment.water]
kind = "thermocline"
surface_temperature_degc = 14
deep_temperature_degc = 8
surface_salinity_psu = 30
deep_salinity_psu = 34.5
depth_m = 2.5
thickness_m = 1.5
[seabed]
kind = "flat"
depth_m = 5
[structures.wall]
kind = "box"
size_m = [0.5, 8, 8]
position_ned_m = [1.5, 0, 2]
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0, 0, -0.05]
[vehicles.rov.truth]
rate_hz = 20
[vehicles.rov.sensors]
imu = {kind = "imu", profile = "mems_imu", rate_hz = 120}
pressure = {kind = "pressure", profile = "bar30", rate_hz = 20}
motion_capture = {kind = "motion_capture", rate_hz = 30, modifiers = {noise = {kind = "white_noise", field = "p_NS", sigma = 0.01}}}
magnetometer = {kind = "magnetometer", profile = "mems_magnetometer", rate_hz = 20}
attitude = {kind = "attitude", profile = "mems_ahrs", rate_hz = 60}
gps = {kind = "gps", profile = "m8_gps", rate_hz = 5, position_frd_m = [0.0, 0.0, -0.3], cold_fix_s = 3, hot_fix_s = 3}
ctd = {kind = "ctd", profile = "sbe49", rate_hz = 16}
sound_speed = {kind = "sound_speed", profile = "minisvs", rate_hz = 8}
range_array = {kind = "range_array", rate_hz = 10, beams = 9, field_of_view_deg = 60, max_range_m = 8, sigma_m = 0.01}
contact = {kind = "contact", rate_hz = 240}
battery = {kind = "battery", profile = "lipo_4s_18ah", rate_hz = 20}
leak = {kind = "leak", rate_hz = 2}
rpm = {kind = "rpm", rate_hz = 20, members = ["t1", "t5"], sigma_radps = 1.0}
clock = {kind = "clock", rate_hz = 2, offset_s = 0.02, drift = 2e-5}
compound = {kind = "compound", rate_hz = 120, members = ["pressure", "attitude"]}
[vehicles.rov.sensors.training]
kind = "training"
rate_hz = 10
limit_s = 60
[vehicles.rov.sensors.training.tasks.dive]
kind = "hold_depth"
depth_m = 2.0
tolerance_m = 1.0
for_s = 3
[vehicles.rov.sensors.training.tasks.touch_the_wall]
kind = "reach"
position_ned_m = [0.9, 0, 2]
size_m = [0.6, 2, 3]
"""
_FORWARD = [-0.15, -0.15, 0.15, 0.15]


def all_others() -> None:
    """What each kind tells of one dive: rest at the surface, down, ahead against a wall, a leak, and up again."""
    path = IMAGES / "stage.toml"
    path.write_text(_STAGE, encoding="utf-8")
    world = build(load(path, adapters={}))
    path.unlink()
    told: dict[str, list[Sample]] = {port: [] for port in world.ports}
    for second in range(40):
        down = 0.0 if second < 6 else 0.5 if second < 10 else 0.08 if second < 24 else -0.4
        world.command("rov/thrusters", u=[*(_FORWARD if 10 <= second < 24 else [0.0] * 4), *([down] * 4)])
        if second == 16:
            world.call("rov/leak/set", area_m2=2e-6)
        for sample in world.step(240):
            told[sample.port].append(sample)
    for port in world.ports.values():
        if port.direction == "sensor" and not port.is_truth and port.path.removeprefix("rov/") == port.kind:
            figure = picture(port, told[port.path])
            figure.savefig(IMAGES / f"sensor_{port.kind}.png", dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    water_column()
    imu_grades()
    vehicle()
    all_others()
    sys.exit(0)
