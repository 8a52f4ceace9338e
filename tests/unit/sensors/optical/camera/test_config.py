"""The table of a camera: what cannot be is refused with what to do."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.sensors import CameraConfig, Pose
from uwserver.sensors.optical.camera.config import gain_of
from uwserver.sensors.optical.camera.lens import DomePort, FlatPort


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"field_of_view_deg": 175.0}, "fisheye"),
        ({"width": 8192, "height": 8192}, "at most"),
        ({"lens": "brown_conrady", "distortion": (-5.0,)}, "folds"),
        ({"lens": "pinhole", "distortion": (0.1,)}, "0 coefficients"),
        ({"lens": "fisheye", "field_of_view_deg": 200.0, "port": FlatPort()}, "flat port"),
        ({"port": DomePort(radius_m=0.05, offset_m=0.06)}, "outside the dome"),
        ({"baseline_m": 0.1, "streams": {"right": {}}}, "another name"),
    ],
)
def test_what_cannot_be_is_refused(keys: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        CameraConfig(rate_hz=10.0, **keys)  # type: ignore[arg-type]


def test_a_calibration_is_taken_as_it_is() -> None:
    config = CameraConfig(
        rate_hz=10.0, focal_px=(500.0, 510.0), centre_px=(300.0, 200.0), lens="brown_conrady", distortion=(-0.1, 0.01)
    )
    lens = config.optics()
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == (500.0, 510.0, 300.0, 200.0)
    assert lens.coefficients == (-0.1, 0.01, 0.0, 0.0, 0.0)


def test_the_right_one_of_a_pair_sits_along_y() -> None:
    config = CameraConfig(rate_hz=10.0, baseline_m=0.12)
    turned = Pose.from_degrees((0.0, 0.0, 90.0), (1.0, 2.0, 3.0))
    ((name, (right, mount)),) = config.companions(turned).items()
    np.testing.assert_allclose(mount.p, (1.0 - 0.12, 2.0, 3.0), atol=1e-12)
    assert (name, right.companions(mount)) == ("right", {})


def test_decibels() -> None:
    assert gain_of(20.0) == pytest.approx(10.0)


def test_what_pictures_take_of_a_core_grows_with_pixels_rate_and_mode() -> None:
    one = CameraConfig(rate_hz=10.0).cores
    assert 0.5 < one < 1.5
    assert CameraConfig(rate_hz=5.0, width=1280).cores == pytest.approx(one)
    assert CameraConfig(rate_hz=10.0, baseline_m=0.1).cores == pytest.approx(2.0 * one)
    assert CameraConfig(rate_hz=10.0, mode="depth").cores < 0.6 * one
