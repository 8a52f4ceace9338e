"""MOOS: the wire, a client that joins a MOOSDB, a MOOSDB of our own, and a bridge for lines of text (README.md beside this file)."""

from uwserver_adapters.moos.bridge.client import MoosAdapter
from uwserver_adapters.moos.db.adapter import MoosDbAdapter
from uwserver_adapters.moos.text.adapter import MoosTextAdapter

__all__ = ["MoosAdapter", "MoosDbAdapter", "MoosTextAdapter"]
