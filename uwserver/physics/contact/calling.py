"""The stages of contact (`step`) for kernels that call them by where their code lies."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from uwserver.physics.collision.contacts import NO_CONTACTS, NO_IMPULSES
from uwserver.physics.contact import step
from uwserver.physics.contact.forces import Struck
from uwserver.physics.contact.solver import Constraints
from uwserver.physics.kernel.calling import caller
from uwserver.physics.kernel.compiled import inlined

_whole, _flags = np.zeros(0, np.int64), np.zeros(0, np.bool_)


def _floats(dimensions: int) -> Any:
    return np.zeros((0,) * dimensions)


_NOTHING = Struck(
    _whole, _floats(3), Constraints(_whole, _whole, _whole, _whole, _floats(3), _floats(4), _floats(2)),
    _floats(2), _floats(2), _floats(2), _flags, _floats(2),
)  # fmt: skip
STRUCK = numba.typeof(_NOTHING)
"""What `step.strike` gives."""

_for_struck = caller(STRUCK)


@inlined
def call_for_struck(code: int, args: Any) -> Any:
    """Call `step.strike` with a tuple of its arguments."""
    return _for_struck(code, args)


def load(fitted: bool) -> tuple[Any, Any]:
    """`step.strike`, of a world with or without appendages, and `step.settle`: compiled, or from the cache."""
    strike: Any = step.strike_fitted if fitted else step.strike
    settle: Any = step.settle
    table, old = np.zeros((0, 2), np.int64), NO_IMPULSES
    strike.load(table, NO_CONTACTS, old.contacts.key, old.contacts.point, old.hold, 0.0, 0.0)
    settle.load(table, _NOTHING, NO_CONTACTS, 0.0, old.impulse, old.hold, _floats(2))
    return strike, settle
