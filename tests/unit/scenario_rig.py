"""Scenarios of which many tests build worlds are read once a process: to read one takes longer than to build it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from uwserver.adapter import installed_adapters
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario

_READ: dict[str, Resolved] = {}

adapters_here = cache(installed_adapters)


def read_once(scenario: str | Scenario, *, adapters: Mapping[str, type] = {}) -> Resolved:
    """As `load`, of a shipped scenario or of one that was built."""
    key = f"{scenario!r} {list(adapters)}"
    if key not in _READ:
        _READ[key] = load(scenario, adapters=adapters)
    return _READ[key]
