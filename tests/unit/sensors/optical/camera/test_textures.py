"""Textures: coarser copies keep the light, limits are told."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.sensors.optical.camera import textures
from uwserver.sensors.optical.camera.textures import LINEAR, Atlas, BadTexture, encoded


def test_coarser_copies_keep_the_light() -> None:
    board = np.zeros((8, 4, 3), np.uint8)
    board[::2] = 255
    atlas = Atlas([board, board[:1, :1]])
    assert [tuple(row)[1:3] for row in atlas.levels.tolist()] == [(4, 8), (2, 4), (1, 2), (1, 1), (1, 1)]
    assert atlas.numbers == [0, 4]
    assert atlas.levels["levels"].tolist() == [3, 2, 1, 0, 0]
    # Half of the light, not half of the values: 188, not 128.
    assert atlas.texels[32].tolist() == [188] * 3


def test_srgb_there_and_back() -> None:
    values = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(encoded(LINEAR[values]), values)


def test_too_many_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(textures, "MOST_BYTES", 100)
    with pytest.raises(BadTexture, match="make them smaller"):
        Atlas([np.zeros((10, 10, 3), np.uint8)])


def test_what_is_no_picture_is_refused() -> None:
    with pytest.raises(BadTexture, match="no PNG or JPEG"):
        textures.decoded(b"GIF89a", textures.ByteBudget())
