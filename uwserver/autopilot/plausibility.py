"""Refuses saved states that no autopilot can have had: a state may come from a file that somebody else wrote."""

from __future__ import annotations

import math
from collections.abc import Iterator

from msgspec import Struct, structs

from uwserver.autopilot.state import Estimate, Memory, Orders


def refuse_impossible(path: str, estimate: Estimate, memory: Memory, orders: Orders) -> None:
    """Refuse a saved state that no autopilot can have had.

    Args:
        path: of the autopilot.
        estimate, memory, orders: the saved state.

    Raises:
        ValueError: an attitude without unit length, a present item that the mission does not have, or a number that is far too large.
    """
    for q in (estimate.q, orders.attitude or estimate.q):
        if not abs(math.hypot(*q) - 1.0) < 1e-3:
            raise ValueError(f'"{path}" has an attitude that is no rotation')
    if not -1 <= orders.index < len(orders.items) or not 0 <= orders.reached <= len(orders.items):
        raise ValueError(f'"{path}" is at an item that its mission does not have')
    limited = structs.replace(orders, turn_limit=0.0 if orders.turn_limit == math.inf else orders.turn_limit)
    if not all(_is_plausible(x) for part in (estimate, memory, limited) for x in _numbers(part)):
        raise ValueError(f'"{path}" holds a number out of all range')


def _is_plausible(x: float) -> bool:
    """Return whether a number is possible. Differences of whole numbers (times in ns, counts) must fit into 64 bits."""
    return abs(x) < 2**62 if isinstance(x, int) else math.isnan(x) or abs(x) < 1e12


def _numbers(value: object) -> Iterator[float]:
    """Yield all numbers in a record, at any depth."""
    if isinstance(value, float | int):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, Struct):
        yield from _numbers(structs.astuple(value))
