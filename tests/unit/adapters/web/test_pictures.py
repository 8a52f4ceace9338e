"""Samples as pictures for pages: which field is the picture, and how it is coded."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from uwserver_adapters.web.frames import DEPTH, FAN, RAW
from uwserver_adapters.web.pictures import encoded

from uwserver.ports import Buffer, Field, Layout, Port, Sample, Value

IMAGE = Field("image", "1", "it", type="buffer", buffer=Layout("uint8", (-1, -1)))
AZIMUTH = Field("azimuth", "rad", "of each beam", type="buffer", buffer=Layout("float32", (-1,)))
RANGES = Field("range_start", "m", "x"), Field("range", "m", "x")
COUNTS = np.arange(6, dtype=np.uint8).reshape(2, 3)


def frame(fields: tuple[Field, ...], *values: Value) -> bytes | None:
    port = Port("rov/x", "sensor", "x", fields, "x", 1.0)
    return encoded(port, Sample(port.path, 0, 5, 5, True, values), 7)


def fan(image: np.ndarray, angles: tuple[float, ...] = (-0.5, 0.0, 0.5), reach: float | None = 20.0) -> bytes | None:
    return frame((*RANGES, AZIMUTH, IMAGE), 1.0, reach, Buffer.of(np.array(angles, np.float32)), Buffer.of(image))


def test_an_imaging_sonar_is_a_fan() -> None:
    data = fan(COUNTS)
    assert data is not None
    assert struct.unpack("<BBHHHq", data[:16]) == (2, FAN, 7, 3, 2, 5)
    assert struct.unpack("<ffff", data[16:32]) == (-0.5, 0.5, 1.0, 20.0)
    assert data[32:] == COUNTS.tobytes()


@pytest.mark.parametrize(
    ("image", "angles", "reach"),
    [
        (COUNTS.astype(np.float32), (-0.5, 0.0, 0.5), 20.0),  # pressures
        (COUNTS, (-0.5, 0.5), 20.0),  # other beams than columns
        (COUNTS.ravel(), (-0.5, 0.0, 0.5), 20.0),
        (COUNTS, (-0.5, 0.0, 0.5), None),
        (np.zeros((2, 0), np.uint8), (), 20.0),
    ],
)
def test_what_no_fan_can_be_drawn_of_is_left_out(
    image: np.ndarray, angles: tuple[float, ...], reach: float | None
) -> None:
    assert fan(image, angles, reach) is None


def test_the_picture_is_the_field_of_that_name() -> None:
    other = Field("mask", "1", "x", type="buffer", buffer=Layout("uint16", (-1, -1)))
    mask, image = Buffer.of(COUNTS.astype(np.uint16)), Buffer.of(COUNTS)
    first, second = frame((other, IMAGE), mask, image), frame((other,), mask)
    assert first is not None
    assert second is not None
    assert (first[1], second[1]) == (RAW, DEPTH)
    assert frame((IMAGE,), None) is None
