"""Calibrations: as exact as the camera, fitted where a port bends, and read by who reads such files."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.sensors import CameraConfig
from uwserver.sensors.optical.camera.calibration import as_opencv, as_ros, calibration
from uwserver.sensors.optical.camera.lens import WATER_INDEX, DomePort, FlatPort, outside


def config(**keys: object) -> CameraConfig:
    return CameraConfig(rate_hz=10.0, **keys)  # type: ignore[arg-type]


def test_a_lens_behind_a_centred_dome_is_told_as_it_is() -> None:
    camera = config(lens="brown_conrady", distortion=(-0.1, 0.01, 0.001, 0.0, 0.0), port=DomePort())
    found = calibration(camera)
    assert (found.lens, found.error_px) == (camera.optics(), 0.0)


def test_a_flat_port_lengthens_the_lens_by_the_index_and_bends() -> None:
    camera = config(field_of_view_deg=70.0, port=FlatPort(distance_m=0.02, thickness_m=0.01))
    found = calibration(camera)
    assert found.lens.fx == pytest.approx(camera.optics().fx * WATER_INDEX, rel=0.02)
    assert found.lens.coefficients[0] > 0.05  # a pincushion
    assert 0.0 < found.error_px < 0.1
    # The model finds the pixels of points at the distance of the board.
    u, v = np.array((20.0, 320.0, 600.0)), np.array((30.0, 100.0, 470.0))
    rays = outside(camera.window(), camera.optics().directions(u, v))
    seen = found.lens.pixels(rays.origin + 2.0 * rays.direction)
    assert np.hypot(seen[0] - u, seen[1] - v).max() < 0.3


def test_a_fisheye_behind_a_dome_off_its_centre() -> None:
    camera = config(lens="fisheye", field_of_view_deg=150.0, port=DomePort(offset_m=0.01))
    found = calibration(camera)
    assert found.lens.model == "fisheye"
    assert 0.0 < found.error_px < 0.2


def test_the_form_of_ros() -> None:
    text = as_ros(
        "rov_camera", calibration(config(field_of_view_deg=90.0, width=641, height=481))._replace(baseline=0.1)
    )
    assert "distortion_model: plumb_bob" in text
    assert "data: [320, 0, 320, 0, 320, 240, 0, 0, 1]" in text
    assert "data: [320, 0, 320, -32, 0, 320, 240, 0, 0, 0, 1, 0]" in text
    fisheye = as_ros("x", calibration(config(lens="fisheye", field_of_view_deg=180.0)))
    assert "distortion_model: equidistant" in fisheye
    assert fisheye.count("cols: 4") == 2


def test_the_form_of_opencv() -> None:
    text = as_opencv(calibration(config(lens="brown_conrady", distortion=(-0.2, 0.05))))
    assert text.startswith("%YAML:1.0\n---\n")
    assert "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [" in text
    assert "data: [-0.2, 0.05, 0, 0, 0]" in text
