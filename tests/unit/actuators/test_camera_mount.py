"""A mount that tilts: its limits are those of the vehicle file, and what it was told is remembered."""

from __future__ import annotations

from typing import Any

import pytest

from uwserver.actuators import Body, CameraMountConfig


def body() -> Body:
    hydro: Any = None
    return Body(hydro, 0, {}, 0, tilts={"camera": (-0.8, 0.7, 1.0)})


def test_it_remembers_a_tilt_within_its_limits() -> None:
    mount = CameraMountConfig(mount="camera").build(body())
    (field,) = mount.fields
    assert (field.minimum, field.maximum, mount.rate) == (-0.8, 0.7, 1.0)
    mount.apply(((0.3,),))
    assert mount.memory.tilt == 0.3
    mount.neutral()
    assert mount.memory.tilt == 0.0


def test_a_mount_that_does_not_tilt_is_named() -> None:
    with pytest.raises(ValueError, match='no mount "imu" that tilts, there are: camera'):
        CameraMountConfig(mount="imu").build(body())
