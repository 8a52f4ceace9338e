"""What counts as a picture, what it looks like, and that JPEG of either library shows it. Also of uwserver.ports.pictures."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest

from uwserver.adapter import pictures
from uwserver.adapter.pictures import FAR_MM, can_encode_jpeg, jpeg, picture_place, pixels
from uwserver.packages import install_command
from uwserver.ports import Buffer, Field, Layout, Port

Image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")


def port(*fields: Field, direction: str = "sensor") -> Port:
    return Port("rov/x", direction, "x", fields, "X.", 1.0)  # type: ignore[arg-type]  # one of two texts


def buffer(name: str, dtype: str, *shape: int) -> Field:
    return Field(name, "1", "x", type="buffer", buffer=Layout(dtype, shape))  # type: ignore[arg-type]  # a text


@pytest.mark.parametrize(
    ("found", "place"),
    [
        (port(buffer("image", "uint8", -1, -1, 3)), 0),
        (port(Field("gain", "1", "x"), buffer("left", "uint8", 2, 2), buffer("image", "uint16", -1, -1)), 2),
        (port(buffer("azimuth", "float32", -1), buffer("echoes", "uint8", -1, -1)), 1),
        (port(buffer("row", "uint8", -1)), None),
        (port(buffer("image", "uint8", -1, -1, 4)), None),
        (port(buffer("image", "float32", -1, -1)), None),
        (port(Field("payload", "1", "x", type="bytes"), Field("any", "1", "x", type="buffer")), None),
        (port(buffer("image", "uint8", -1, -1), direction="actuator"), None),
    ],
)
def test_which_field_is_the_picture(found, place):
    assert picture_place(found) == place


def test_distances_are_bright_where_near_and_black_where_there_is_nothing():
    shown = pixels(Buffer.of(np.array([[0, 1, 300, FAR_MM // 2, FAR_MM, 65535]], np.uint16)))
    assert shown is not None
    (row,) = shown.tolist()
    assert row[0] == 0
    assert row[1:] == sorted(row[1:], reverse=True)
    assert row[1] == 255
    assert row[4:] == [0, 0]


def test_objects_have_colours_of_their_own():
    shown = pixels(Buffer.of(np.arange(256, dtype=np.uint16).reshape(16, 16)))
    assert shown is not None
    assert shown.shape == (16, 16, 3)
    colours = shown.reshape(-1, 3).astype(int)
    assert not colours[0].any()
    assert len({tuple(colour) for colour in colours}) > 240
    assert min(np.abs(colours[k] - colours[k + 1]).sum() for k in range(40)) > 60


@pytest.mark.parametrize(
    "value",
    [
        None, 1.0, "text", Buffer(data=b"abc"), Buffer.of(np.zeros(4, np.uint8)), Buffer.of(np.zeros((2, 2, 4), np.uint8)),
        Buffer.of(np.zeros((2, 2), np.float32)), Buffer.of(np.zeros((0, 4), np.uint8)), Buffer.of(np.zeros((2, 2, 3), np.uint16)),
    ],
)  # fmt: skip
def test_what_is_no_picture(value):
    assert pixels(value) is None


def test_a_picture_too_large_is_none(monkeypatch):
    monkeypatch.setattr("uwserver.ports.pictures.MOST_PIXELS", 99)
    assert pixels(Buffer.of(np.zeros((10, 10), np.uint8))) is None
    assert pixels(Buffer.of(np.zeros((9, 11), np.uint8))) is not None


@pytest.mark.parametrize("library", ["simplejpeg", "PIL"])
@pytest.mark.parametrize("shape", [(48, 64, 3), (48, 64), (17, 33, 3)])
def test_jpeg_shows_the_picture(library, shape, monkeypatch):
    pytest.importorskip(library)
    monkeypatch.setattr(pictures, "_jpeg_library", lambda: library)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]]
    grey = (x * 3 + y * 2).clip(0, 255).astype(np.uint8)
    shown = grey if len(shape) == 2 else np.stack([grey, 255 - grey, np.full_like(grey, 60)], axis=2)
    found = np.asarray(Image.open(io.BytesIO(jpeg(shown, 90))))
    assert found.shape == shape
    assert np.abs(found.astype(int) - shown).mean() < 3.0
    assert len(jpeg(shown, 30)) < len(jpeg(shown, 95))


def test_without_a_library_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr(pictures, "_jpeg_library", lambda: "")
    assert not can_encode_jpeg()
    with pytest.raises(RuntimeError, match=re.escape(install_command("uwserver[pictures]"))):
        jpeg(np.zeros((8, 8), np.uint8))
