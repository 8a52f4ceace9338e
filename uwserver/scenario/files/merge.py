"""Raw tables put together, before anything of ours is known of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def named(raw: Mapping[str, Any], table: str) -> dict[str, Any]:
    """A table of tables; empty where something else stands."""
    found = raw.get(table)
    return found if isinstance(found, dict) else {}


def merged(base: Mapping[str, Any], override: Mapping[str, Any]) -> dict[str, Any]:
    """The base with the keys of the override in it, table by table."""
    whole = dict(base)
    for key, value in override.items():
        below = whole.get(key)
        whole[key] = merged(below, value) if isinstance(value, dict) and isinstance(below, dict) else value
    return whole
