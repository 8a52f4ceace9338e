"""Loads the compiled functions that move bodies when they are first needed. This takes half a second, and `import uwserver` must stay quick."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.layout import Codes
from uwserver.physics.kernel.straight import address_of, straight

_NO_TABLE: IntArray = np.zeros((0, 2), np.int64)
_NO_CODES = Codes(0, 0, 0, 0)


@cache
def _steppers(fitted: bool) -> tuple[Any, Any]:
    from uwserver.physics.dynamics import integrator

    advance: Any = integrator.advance_fitted if fitted else integrator.advance
    rates: Any = integrator.rates_of_change_fitted if fitted else integrator.rates_of_change
    advance.load(_NO_TABLE, 0.0, 0.0)
    rates.load(_NO_TABLE, 0.0, np.empty((0, 6)), np.empty((0, 6)))
    return advance, rates


@cache
def codes(fitted: bool, touches: bool) -> Codes:
    """Return the addresses of the code that moves bodies in a tick, for worlds with or without appendages (`fitted`) and solids (`touches`)."""
    advance, rates = _steppers(fitted)
    return Codes(
        address_of(advance, "int64"), address_of(rates, "none"), *(contact_codes(fitted) if touches else (0, 0))
    )


def contact_codes(fitted: bool) -> tuple[int, int]:
    """Return the addresses of the code of the two contact stages, for worlds with or without appendages."""
    from uwserver.physics.contact.carrying import STRUCK, load_stages

    strike, finish = load_stages(fitted)
    return address_of(strike, str(STRUCK)), address_of(finish, "none")


@cache
def carry() -> Callable[..., Any]:
    """Return `contact.carrying.carry_alone`, loaded."""
    from uwserver.physics.contact import carrying

    kernel: Any = carrying.carry_alone
    kernel.load(_NO_CODES, _NO_TABLE, _NO_TABLE, np.empty((0, 6)), 0.0, 0.0)
    return straight(kernel)


@cache
def find_rates() -> Callable[..., Any]:
    """Return `contact.carrying.find_rates_alone`, loaded."""
    from uwserver.physics.contact import carrying

    kernel: Any = carrying.find_rates_alone
    kernel.load(_NO_CODES, _NO_TABLE, _NO_TABLE, np.empty((0, 6)), 0.0, np.empty((0, 6)), np.empty((0, 6)))
    return straight(kernel)


@cache
def sea() -> ModuleType:
    """Return the module of moving water."""
    from uwserver.physics.dynamics import flow

    return flow


@cache
def flow_code() -> int:
    """Return the address of the code of `flow.fill_flows`, for kernels that call it."""
    kernel: Any = sea().fill_flows
    nothing = layout.SeaRows(np.zeros(7), np.zeros((0, layout.PROFILE_SIZE)), np.zeros((0, layout.WAVE_SIZE)))
    kernel.load(_NO_TABLE, nothing, 0.0, 0.0)
    return address_of(kernel, "none")
