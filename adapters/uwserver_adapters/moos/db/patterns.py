"""Patterns of names, by which clients register for all variables that match: ``*`` is any number of characters, ``?`` is one."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

MARKED = 64
"""Work of a comparison with a question mark in the pattern: 20 us with the longest names."""


def fits(key: str, source: str, pattern: str, app: str) -> bool:
    """Return whether the patterns match a variable and the client that wrote it last."""
    return glob(pattern, key) and glob(app, source)


def work(pattern: str, app: str = "") -> int:
    """Return the cost of a comparison, about, in units of a third of a microsecond."""
    return 1 + sum(each.count("*") + MARKED * ("?" in each) for each in (pattern, app))


def is_pattern(text: str) -> bool:
    """Return whether a text may match more than one name."""
    return "*" in text or "?" in text


def _has_parts(parts: list[str], text: str) -> bool:
    """Return whether a text consists of these parts in their order, with anything between them."""
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


class _Automaton(NamedTuple):
    """A pattern as an automaton. A state is how many characters of the pattern, without stars, are matched; sets of states are bits of a number.

    Attributes:
        advance: character -> states from which it leads to the next state.
        advance_any: the same for a character that the pattern does not contain.
        stay: states with a star.
        end: the last state.
    """

    advance: dict[str, int]
    advance_any: int
    stay: int
    end: int


@lru_cache(maxsize=256)
def _automaton(pattern: str) -> _Automaton:
    advance_any = stay = 0
    advance: dict[str, int] = {}
    state = 1
    for character in pattern:
        if character == "*":
            stay |= state
            continue
        if character == "?":
            advance_any |= state
        else:
            advance[character] = advance.get(character, 0) | state
        state <<= 1
    return _Automaton({c: states | advance_any for c, states in advance.items()}, advance_any, stay, state)


def glob(pattern: str, text: str) -> bool:
    """Return whether a text matches a pattern.

    Nothing is tried twice: all states that are possible advance together, so each character costs the same.
    """
    if "?" not in pattern:  # nearly all patterns
        return _has_parts(pattern.split("*"), text)
    advance, advance_any, stay, end = _automaton(pattern)
    states = 1
    for character in text:
        states = (states & advance.get(character, advance_any)) << 1 | states & stay
        if not states:
            return False
    return states & end != 0
