"""Names and numbers of the parts of a recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from uwserver.logfiles.part_files import PART, part_of, part_path


def test_the_first_part_has_the_recordings_own_name():
    assert part_path(Path("a/run.mcap"), 1) == Path("a/run.mcap")
    assert part_path(Path("a/run.mcap"), 2) == Path("a/run.0002.mcap")
    assert part_path(Path("run"), 12345) == Path("run.12345")


@pytest.mark.parametrize(("told", "number"), [("3", 3), ("", 1), ("-2", 1), ("x", 1), ("9" * 40, 1), ("²", 1)])
def test_a_number_that_is_none_is_that_of_the_first(told: str, number: int):
    assert part_of({PART: told}) == number
    assert part_of({}) == 1
