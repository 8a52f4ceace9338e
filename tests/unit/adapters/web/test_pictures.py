"""Samples as pictures for pages: which field is the picture, and how it is coded."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from uwserver_adapters.web.pictures import DEPTH, FAN, RAW, SIDES, encoded

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
def test_what_no_fan_can_be_drawn_of_goes_plain_or_not_at_all(
    image: np.ndarray, angles: tuple[float, ...], reach: float | None
) -> None:
    data = fan(image, angles, reach)
    assert data is None or data[1] == RAW


def test_the_picture_is_the_field_of_that_name() -> None:
    other = Field("mask", "1", "x", type="buffer", buffer=Layout("uint16", (-1, -1)))
    mask, image = Buffer.of(COUNTS.astype(np.uint16)), Buffer.of(COUNTS)
    first, second = frame((other, IMAGE), mask, image), frame((other,), mask)
    assert first is not None
    assert second is not None
    assert (first[1], second[1]) == (RAW, DEPTH)
    assert frame((IMAGE,), None) is None


def ping(port: np.ndarray, starboard: np.ndarray, reach: float | None = 40.0) -> bytes | None:
    row = Layout("uint8", (-1,))
    sides = [Field(name, "1", "x", type="buffer", buffer=row) for name in ("port", "starboard")]
    return frame((Field("range", "m", "x"), *sides), reach, Buffer.of(port), Buffer.of(starboard))


def test_a_side_scan_sonar_shows_both_sides() -> None:
    data = ping(COUNTS[0], COUNTS[1])
    assert data is not None
    assert struct.unpack("<BBHHHq", data[:16]) == (2, SIDES, 7, 3, 2, 5)
    assert struct.unpack("<f", data[16:20]) == (40.0,)
    assert data[20:] == COUNTS.tobytes()


@pytest.mark.parametrize(
    ("port", "starboard", "reach"),
    [
        (COUNTS[0].astype(np.float32), COUNTS[1].astype(np.float32), 40.0),  # pressures
        (COUNTS[0], COUNTS[1, :2], 40.0),
        (COUNTS[0], COUNTS[1], None),
        (COUNTS[0, :0], COUNTS[1, :0], 40.0),
    ],
)
def test_sides_that_are_no_counts_alike_are_no_ping(
    port: np.ndarray, starboard: np.ndarray, reach: float | None
) -> None:
    data = ping(port, starboard, reach)
    assert data is None or data[1] != SIDES
