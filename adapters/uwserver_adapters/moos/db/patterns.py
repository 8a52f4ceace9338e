"""Patterns of names, as clients register for all that match: ``*`` is any number of characters, ``?`` one."""

from __future__ import annotations


def fits(key: str, source: str, pattern: str, app: str) -> bool:
    """Whether a variable and who wrote it last are meant."""
    return glob(pattern, key) and glob(app, source)


def work(pattern: str, app: str) -> int:
    """What a comparison costs, about: in units of a third of a microsecond."""
    both = pattern + app
    return 1 + both.count("*") + 16 * both.count("?")


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


def glob(pattern: str, text: str) -> bool:
    """Whether a text fits a pattern: ``*`` is any number of characters, ``?`` one. Time grows with the product of the lengths, no faster."""
    if "?" not in pattern:  # nearly all there are
        return _has_parts(pattern.split("*"), text)
    at = 0
    star = resume = -1
    where = 0
    while where < len(text):
        if at < len(pattern) and pattern[at] == "*":
            star, resume = at, where
            at += 1
        elif at < len(pattern) and pattern[at] in ("?", text[where]):
            at, where = at + 1, where + 1
        elif star >= 0:
            resume += 1
            at, where = star + 1, resume
        else:
            return False
    return all(rest == "*" for rest in pattern[at:])
