"""Patterns of names, as clients register for all that match: ``*`` is any number of characters, ``?`` one."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

MARKED = 64
"""What a pattern with a question mark costs: 20 us with the longest names."""


def fits(key: str, source: str, pattern: str, app: str) -> bool:
    """Whether a variable and who wrote it last are meant."""
    return glob(pattern, key) and glob(app, source)


def work(pattern: str, app: str = "") -> int:
    """What a comparison costs, about: in units of a third of a microsecond."""
    return 1 + sum(each.count("*") + MARKED * ("?" in each) for each in (pattern, app))


def is_pattern(text: str) -> bool:
    """Whether it may stand for more than one name."""
    return "*" in text or "?" in text


def _has_parts(parts: list[str], text: str) -> bool:
    """Whether a text is these parts in their order, with anything between them."""
    if len(parts) == 1:
        return text == parts[0]
    start, *middle, end = parts
    at, limit = len(start), len(text) - len(end)
    if at > limit or not text.startswith(start) or not text.endswith(end):
        return False
    for part in middle:
        found = text.find(part, at, limit)
        if found < 0:
            return False
        at = found + len(part)
    return True


class _Places(NamedTuple):
    """A pattern as sets of places, each a bit; a place is how many of its characters but stars are behind.

    Attributes:
        takes: for a character, the places from which it leads to the next.
        takes_any: the same for a character that is none of the pattern's.
        stays: places with a star.
        end: behind all.
    """

    takes: dict[str, int]
    takes_any: int
    stays: int
    end: int


@lru_cache(maxsize=256)
def _places(pattern: str) -> _Places:
    takes_any = stays = 0
    takes: dict[str, int] = {}
    here = 1
    for character in pattern:
        if character == "*":
            stays |= here
            continue
        if character == "?":
            takes_any |= here
        else:
            takes[character] = takes.get(character, 0) | here
        here <<= 1
    return _Places({character: places | takes_any for character, places in takes.items()}, takes_any, stays, here)


def glob(pattern: str, text: str) -> bool:
    """Whether a text fits a pattern: ``*`` is any number of characters, ``?`` one. Nothing is tried twice: a character costs the same at
    whatever places of the pattern it may stand."""
    if "?" not in pattern:  # nearly all there are
        return _has_parts(pattern.split("*"), text)
    takes, takes_any, stays, end = _places(pattern)
    at = 1
    for character in text:
        at = (at & takes.get(character, takes_any)) << 1 | at & stays
        if not at:
            return False
    return at & end != 0
