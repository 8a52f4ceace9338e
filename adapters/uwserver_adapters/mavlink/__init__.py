"""MAVLink: shows a vehicle to ground stations as an ArduSub ROV (README.md beside this file)."""

from uwserver_adapters.mavlink.adapter import MavlinkAdapter

__all__ = ["MavlinkAdapter"]
