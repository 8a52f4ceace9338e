"""Merges raw tables, before their keys are checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def named(raw: Mapping[str, Any], table: str) -> dict[str, Any]:
    """Return the table of this name; an empty one if it is missing or not a table."""
    found = raw.get(table)
    return found if isinstance(found, dict) else {}


def merged(base: Mapping[str, Any], override: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of `base` in which the keys of `override` replace its own; tables on both sides are merged in the same way."""
    whole = dict(base)
    for key, value in override.items():
        below = whole.get(key)
        whole[key] = merged(below, value) if isinstance(value, dict) and isinstance(below, dict) else value
    return whole
