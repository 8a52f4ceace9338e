"""The adapter `devices`: sensors of the world speak the protocols of devices of the market (docs/how-to/devices)."""

from uwserver_adapters.devices.adapter import DevicesAdapter

__all__ = ["DevicesAdapter"]
