"""What an adapter may use of uwserver: the contract, and how adapters are found."""

from __future__ import annotations

from uwserver.adapter.contract import (
    ENTRY_POINT_GROUP,
    Adapter,
    AdapterContext,
    AdapterNotFound,
    AdapterStats,
    AdapterTable,
    Driver,
    Order,
    Subscriber,
    adapter_entries,
    installed_adapters,
    load_adapter,
)

__all__ = [
    "ENTRY_POINT_GROUP",
    "Adapter",
    "AdapterContext",
    "AdapterNotFound",
    "AdapterStats",
    "AdapterTable",
    "Driver",
    "Order",
    "Subscriber",
    "adapter_entries",
    "installed_adapters",
    "load_adapter",
]
