"""Sensors of the world as the devices of the market speak on the wire (docs/how-to/devices)."""

from uwserver_adapters.devices.adapter import DevicesAdapter

__all__ = ["DevicesAdapter"]
