"""What a saved autopilot cannot have been: a state may come from a file that somebody else wrote."""

from __future__ import annotations

import math
from collections.abc import Iterator

from msgspec import Struct, structs

from uwserver.autopilot.state import Estimate, Memory, Orders


def refuse_impossible(path: str, estimate: Estimate, memory: Memory, orders: Orders) -> None:
    """Refuse what no autopilot can have been.

    Args:
        path: of the autopilot.
        estimate, memory, orders: as they were saved.

    Raises:
        ValueError: attitudes without length, a mission that ends before its item, or numbers out of all range.
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
    """Times (ns) and counts are whole numbers whose differences can still be counted."""
    return abs(x) < 2**62 if isinstance(x, int) else math.isnan(x) or abs(x) < 1e12


def _numbers(value: object) -> Iterator[float]:
    """All numbers in a record, however deep."""
    if isinstance(value, float | int):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, Struct):
        yield from _numbers(structs.astuple(value))
