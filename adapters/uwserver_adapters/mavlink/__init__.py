"""MAVLink: a vehicle that ground stations take for an ArduSub ROV (README.md beside this file)."""

from uwserver_adapters.mavlink.adapter import MavlinkAdapter

__all__ = ["MavlinkAdapter"]
