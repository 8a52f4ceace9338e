"""Parts of .npy files of any layout are those of numpy; what a header says is not believed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uwserver.scenario.solids.array_files import Array, NoArray

VALUES = np.arange(35.0).reshape(5, 7)


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", ["<f4", ">i8", "<u2"])
@pytest.mark.parametrize("part", [np.s_[0:5, 0:7], np.s_[1:3, 2:6], np.s_[4:5, 0:1], np.s_[2:2, 0:7]])
def test_a_part_is_that_of_numpy(order: str, dtype: str, part: tuple[slice, slice], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.asarray(VALUES, dtype=dtype, order=order))
    with (tmp_path / "a.npy").open("rb") as file:
        array = Array.of(file)
        found = array.read(file, *part)
    assert array.shape == (5, 7)
    assert found.dtype == dtype
    assert np.array_equal(found, VALUES[part])


def test_a_file_that_is_cut_while_it_is_read_is_told(tmp_path: Path) -> None:
    """A mapped one would end the process by a signal."""
    np.save(tmp_path / "a.npy", np.zeros((1000, 100)))
    with (tmp_path / "a.npy").open("rb") as file:
        array = Array.of(file)
        (tmp_path / "a.npy").open("wb").close()
        with pytest.raises(NoArray, match="became shorter while it was read"):
            array.read(file, slice(500, 1000), slice(0, 100))


def test_a_later_version_of_the_format_is_refused_as_what_it_holds(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x03\x00" + bytes(100))
    with (tmp_path / "a.npy").open("rb") as file, pytest.raises(NoArray, match="array of numbers"):
        Array.of(file)
