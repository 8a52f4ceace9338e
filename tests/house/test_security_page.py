"""The page on security names the test of each threat: each of them is there."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest
from sources import ROOT

PAGE = ROOT / "docs/explanation/security.md"
HEAD = "| threat | what is promised | test |"
NAMED = re.compile(r"`(test_\w+)(\.py)?`")


@cache
def files_of_tests() -> tuple[Path, ...]:
    """Wherever they are."""
    return tuple((ROOT / "tests").rglob("test_*.py"))


def rows() -> list[str]:
    """Of the table of threats."""
    lines = PAGE.read_text().split(HEAD)[1].split("\n\n")[0].splitlines()
    return [line for line in lines if line.startswith("| ")]


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.split("|")[1].strip()[:40])
def test_a_threat_names_tests_that_are_there(row: str) -> None:
    cell = row.split("|")[-2]
    named = NAMED.findall(cell)
    assert named, "each row names a test"
    texts: list[str] = []
    for name, is_file in named:
        if is_file:
            texts = [path.read_text() for path in files_of_tests() if path.stem == name]
            assert texts, f"there is no {name}.py"
        else:
            assert any(f"def {name}(" in text for text in texts), f"the file before has no {name}"


def test_the_table_is_found() -> None:
    assert len(rows()) > 30
