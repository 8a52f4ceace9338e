"""Reads the params of a request with their types. Every mistake is a `Refused` that names the parameter, what it must be, and what came."""

from __future__ import annotations

import math
from collections.abc import Sequence

from uwserver.adapter import did_you_mean
from uwserver.ports import Refused
from uwserver_adapters.native.messages import Request

NAME_LIMIT = 256
"""Longest port, service, pattern, field or client name, characters."""

Params = dict[str, object]


def params_of(request: Request, names: Sequence[str]) -> Params:
    """Return the params as a map, in which only `names` may be keys."""
    params = request.params
    if params is None:
        return {}
    if not isinstance(params, dict):
        raise Refused("bad_argument", f'"params" of "{request.method}" must be a map', "params")
    for key in params:
        if key not in names:
            text = f'"{request.method}" has no parameter "{key}"{did_you_mean(str(key), names)}; it takes: {", ".join(names) or "none"}'
            raise Refused("bad_argument", text, str(key))
    return params


def name(params: Params, key: str, what: str) -> str:
    """Return a text that must be there."""
    value = params.get(key)
    if isinstance(value, str) and 0 < len(value) <= NAME_LIMIT:
        return value
    raise Refused("bad_argument", f'"{key}" must be {what}, a text of 1 to {NAME_LIMIT} characters', key)


def optional_name(params: Params, key: str, what: str) -> str | None:
    """Return a text that may be missing or null."""
    return None if params.get(key) is None else name(params, key, what)


def names(params: Params, key: str, what: str) -> tuple[str, ...] | None:
    """Return a list of texts that may be missing or null."""
    value = params.get(key)
    if value is None:
        return None
    if isinstance(value, list) and 0 < len(value) <= NAME_LIMIT and all(isinstance(entry, str) for entry in value):
        return tuple(dict.fromkeys(value))
    raise Refused("bad_argument", f'"{key}" must be {what}, a list of texts', key)


def positive(params: Params, key: str, what: str) -> float | None:
    """Return a finite number above zero that may be missing or null."""
    value = params.get(key)
    if value is None:
        return None
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:  # an integer of hundreds of digits
            number = math.inf
        if math.isfinite(number) and number > 0.0:
            return number
    raise Refused("bad_argument", f'"{key}" must be {what}, a number above zero', key)
