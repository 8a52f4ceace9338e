"""One recording for all tests of reports: exact and noisy sensors of two vehicles, events, and texts that would end a script."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from run_rig import recorded_run

from uwserver.recording.report.contents import Contents, contents_of
from uwserver.recording.report.reading import Recorded, read_recording

HOSTILE = '</script><img src=x onerror="alert(1)"> & "\u2028'
SCENARIO = """\
schema = 1
title = '</script><img src=x onerror="alert(1)"> & "\u2028'
seed = 5
[world]
rate_hz = 240
origin_lat_deg = 63.4
origin_lon_deg = 10.4
[environment.current]
velocity_ned_mps = [0.2, 0.1, 0.0]
[seabed]
kind = "grid"
file = "slope.npy"
spacing_m = [4.0, 4.0]
[structures.pile]
kind = "cylinder"
radius_m = 1.0
length_m = 10
position_ned_m = [8.0, 4.0, 10.0]
attitude_rpy_deg = [0.0, 90.0, 0.0]
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0, 0, 0.6]
velocity_frd_mps = [0.8, 0.2, 0.0]
attitude_rpy_deg = [2.0, 5.0, 350.0]
[vehicles.rov.truth]
rate_hz = 60
[vehicles.rov.sensors.imu_exact]
kind = "imu"
rate_hz = 60
position_frd_m = [0.2, -0.1, 0.3]
rpy_deg = [180.0, 10.0, 90.0]
[vehicles.rov.sensors.imu_noisy]
kind = "imu"
rate_hz = 120
gyroscope = { noise_density = 1e-3, turn_on = 2e-3 }
accelerometer = { noise_density = 1e-3 }
[vehicles.rov.sensors.dvl_exact]
kind = "dvl"
ideal = true
rate_hz = 10
position_frd_m = [-0.3, 0.1, 0.2]
rpy_deg = [0.0, 0.0, 45.0]
[vehicles.rov.sensors.dvl_noisy]
kind = "dvl"
rate_hz = 20
[vehicles.rov.sensors.depth_noisy]
kind = "pressure"
output = "depth"
rate_hz = 60
[vehicles.rov.sensors.depth_noisy.modifiers.noise]
kind = "white_noise"
field = "depth"
sigma = 0.01
[vehicles.rov.sensors.depth_noisy.modifiers.loss]
kind = "dropout"
probability = 0.1
[vehicles.rov.sensors.pressure_exact]
kind = "pressure"
rate_hz = 20
position_frd_m = [0.3, 0.0, 0.1]
[vehicles.rov.sensors.ahrs_exact]
kind = "attitude"
rate_hz = 20
rpy_deg = [0.0, 90.0, 0.0]
[vehicles.rov.sensors.ahrs_noisy]
kind = "attitude"
rate_hz = 20
noise_deg = 0.5
[vehicles.rov.sensors.gps_exact]
kind = "gps"
ideal = true
rate_hz = 5
position_frd_m = [0.0, 0.0, -2.0]
[vehicles.rov.sensors.gps_noisy]
kind = "gps"
rate_hz = 20
noise_m = 0.7
velocity_sigma_mps = 0.1
position_frd_m = [0.0, 0.0, -2.0]
[vehicles.rov.sensors.mocap]
kind = "motion_capture"
rate_hz = 20
position_frd_m = [0.1, 0.2, 0.3]
[vehicles.rov.sensors.sonar]
kind = "scanning_sonar"
rate_hz = 30
range_m = 12
bins = 60
[vehicles.rov.sensors.imaging]
kind = "multibeam"
output = "pressure"
rate_hz = 5
range_m = 24
bins = 300
beams = 24
rays_vertical = 64
field_deg = 60
beam_width_horizontal_deg = 3
rpy_deg = [0.0, -30.0, 0.0]
processing_s = 0.02
[vehicles.rov.sensors.side]
kind = "side_scan"
rate_hz = 5
range_m = 40
bins = 200
rays_vertical = 64
[vehicles.rov.sensors.battery]
kind = "battery"
profile = "lipo_4s_18ah"
rate_hz = 5
[vehicles.other]
model = "bluerov2"
position_ned_m = [5, 5, 3]
[faults.lame]
kind = "thruster_weak"
target = "rov/thrusters"
members = ["t2"]
factor = 0.5
at_s = 2
"""


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of five seconds."""
    folder = tmp_path_factory.mktemp("report")
    (folder / "x.toml").write_text(SCENARIO, encoding="utf-8")
    north, east = np.meshgrid(np.arange(40), np.arange(40), indexing="ij")
    np.save(folder / "slope.npy", 12.0 + 0.1 * north + 0.05 * east)
    return recorded_run(folder / "x.toml", folder / "x.mcap", 5.0)


@pytest.fixture(scope="session")
def recorded(run: Path) -> Recorded:
    return read_recording(run)


@pytest.fixture(scope="session")
def contents(recorded: Recorded) -> Contents:
    return contents_of(recorded)
