"""The compiled functions that carry bodies on, loaded when one is needed first: they cost half a second, and `import uwserver` must stay quick."""

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
def _advance(fitted: bool) -> Any:
    from uwserver.physics.dynamics import integrator

    kernel: Any = integrator.advance_fitted if fitted else integrator.advance
    kernel.load(_NO_TABLE, 0.0, 0.0)
    return kernel


@cache
def _rates_of_change(fitted: bool) -> Any:
    from uwserver.physics.dynamics import integrator

    kernel: Any = integrator.rates_of_change_fitted if fitted else integrator.rates_of_change
    kernel.load(_NO_TABLE, 0.0, np.empty((0, 6)), np.empty((0, 6)))
    return kernel


@cache
def codes(fitted: bool, touches: bool) -> Codes:
    """Where the code lies of what carries bodies through a tick, of worlds with or without appendages, in which something is solid or not."""
    advance, rates = address_of(_advance(fitted), "int64"), address_of(_rates_of_change(fitted), "none")
    return Codes(advance, rates, *(_contact_codes(fitted) if touches else (0, 0)))


def _contact_codes(fitted: bool) -> tuple[int, int]:
    from uwserver.physics.contact.carrying import STRUCK, load_stages

    strike, finish = load_stages(fitted)
    return address_of(strike, str(STRUCK)), address_of(finish, "none")


@cache
def carry() -> Callable[..., Any]:
    """`contact.carrying.carry_alone`."""
    from uwserver.physics.contact import carrying

    kernel: Any = carrying.carry_alone
    kernel.load(_NO_CODES, _NO_TABLE, _NO_TABLE, np.empty((0, 6)), 0.0, 0.0)
    return straight(kernel)


@cache
def find_rates() -> Callable[..., Any]:
    """`contact.carrying.find_rates_alone`."""
    from uwserver.physics.contact import carrying

    kernel: Any = carrying.find_rates_alone
    kernel.load(_NO_CODES, _NO_TABLE, _NO_TABLE, np.empty((0, 6)), 0.0, np.empty((0, 6)), np.empty((0, 6)))
    return straight(kernel)


@cache
def sea() -> ModuleType:
    """Of a sea."""
    from uwserver.physics.dynamics import flow

    return flow


@cache
def flow_code() -> int:
    """Where the code of `flow.fill_flows` lies, for kernels that call it."""
    kernel: Any = sea().fill_flows
    nothing = layout.SeaRows(np.zeros(7), np.zeros((0, layout.PROFILE_SIZE)), np.zeros((0, layout.WAVE_SIZE)))
    kernel.load(_NO_TABLE, nothing, 0.0, 0.0)
    return address_of(kernel, "none")
