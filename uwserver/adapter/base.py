"""The beginning of an adapter: its table, its context, and its refusals."""

from __future__ import annotations

import asyncio
from typing import Generic, TypeVar

from uwserver.adapter.contract import AdapterContext, AdapterTable
from uwserver.adapter.refusals import Refusals

C = TypeVar("C", bound=AdapterTable)


class AdapterBase(Generic[C]):
    """Keeps what an adapter is constructed with. An adapter need not derive from this class; the contract is `Adapter`.

    Args:
        config: the adapter's table.
        context: what it may use of the server.

    Attributes:
        config, context: as given.
        refusals: counts and logs what the adapter refuses.
    """

    def __init__(self, config: C, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self.refusals = Refusals(context.name, context.stats, asyncio.get_running_loop().time)
