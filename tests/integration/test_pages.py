"""Readers follow README, tutorial, how-tos and client pages to the letter, against the server that the page says."""

from __future__ import annotations

import pytest
from reader import Reader

FOLLOWED = (
    "README.md",
    "docs/tutorial.md",
    "clients/python/README.md",
    "clients/c/README.md",
    "clients/nc/README.md",
    "docs/how-to/extend.md",
    "docs/how-to/faults.md",
    "docs/how-to/record.md",
    "docs/how-to/sea.md",
    "docs/how-to/touch-something.md",
)


@pytest.mark.parametrize("page", FOLLOWED)
def test_a_reader_can_follow_the_page(page, tmp_path):
    with Reader(tmp_path) as reader:
        reader.follow(page)
        assert reader.said
