"""ArduPilot in the loop over its JSON simulator interface (README.md beside this file)."""

from uwserver_adapters.ardupilot.adapter import ArduPilotAdapter

__all__ = ["ArduPilotAdapter"]
