"""PX4 in the loop over its MAVLink simulator interface (README.md beside this file)."""

from uwserver_adapters.px4.adapter import Px4Adapter

__all__ = ["Px4Adapter"]
