"""Ports and services on a zenoh network. README.md beside this file describes the keys and the bytes."""

from uwserver_adapters.zenoh_bus.adapter import ZenohAdapter

__all__ = ["ZenohAdapter"]
