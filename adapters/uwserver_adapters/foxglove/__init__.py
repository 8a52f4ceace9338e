"""A live connection of Foxglove or Lichtblick (README.md beside this file has the messages)."""

from uwserver_adapters.foxglove.adapter import FoxgloveAdapter

__all__ = ["FoxgloveAdapter"]
