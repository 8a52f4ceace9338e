"""Values of messages as columns of numbers."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from uwserver.ports import Buffer, Field
from uwserver.recording.report.columns import ACROSS, Echoes, columns_of


def as_told(array: np.ndarray) -> Any:
    """As a recording holds it."""
    return msgspec.to_builtins(Buffer.of(array))


@pytest.mark.parametrize("count", [3, ACROSS, 1000])
def test_a_row_has_the_peaks_of_neighbours(count: int) -> None:
    column = Echoes(1)
    row = np.arange(count, dtype=np.float32)[::-1].copy()
    column.add(as_told(row))
    (kept,) = column.whole(1)
    assert (kept[0], kept.max()) == (count - 1, count - 1)
    assert kept[-1] == pytest.approx(0 if count <= ACROSS else count - 1 - (ACROSS - 1) * count // ACROSS)
    assert np.all(np.diff(kept) <= 0.0)


def test_complex_echoes_have_their_amplitude_and_pictures_their_strongest_beam() -> None:
    wave = np.zeros((5, 2), np.float32)
    wave[3] = 3.0, -4.0
    for dimensions, value in ((1, wave), (2, wave[:, None]), (2, np.abs(wave) * 1.25)):
        column = Echoes(dimensions)
        column.add(as_told(np.ascontiguousarray(value)))
        kept = column.whole(1)[0]
        assert np.unique(kept).tolist() == [0.0, 5.0]
        assert int(kept.argmax()) == -(-3 * ACROSS // 5)


def test_only_echoes_of_sonars_and_numbers_have_columns() -> None:
    fields = {
        "range": Field("range", "m", ""),
        "image": Field("image", "1", "", type="bytes"),
        "azimuth": Field("azimuth", "rad", "", type="bytes"),
        "name": Field("name", "1", "", type="str"),
    }
    assert [name for name, _ in columns_of("SonarImage", fields)] == ["range", "image"]
    assert [name for name, _ in columns_of("Image", fields)] == ["range"]


@pytest.mark.parametrize(
    "value", [{"base64": "AAAA"}, {"dtype": "uint8", "shape": [4], "base64": "AA=="}, 7, [1, 2], "x"]
)
def test_echoes_that_are_none_are_refused(value: Any) -> None:
    """Neither plain bytes of an image, nor fewer bytes than a shape asks for, nor what is no buffer; nothing of them is kept."""
    column = Echoes(2)
    with pytest.raises((ValueError, TypeError, msgspec.MsgspecError)):
        column.add(value)
    assert not column.numbers
    column.add(None)
    assert np.isnan(column.whole(1)).all()
