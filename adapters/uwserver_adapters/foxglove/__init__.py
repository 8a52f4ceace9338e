"""Live connections of Foxglove and Lichtblick. README.md beside this file describes the messages."""

from uwserver_adapters.foxglove.adapter import FoxgloveAdapter

__all__ = ["FoxgloveAdapter"]
