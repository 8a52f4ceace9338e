"""The native wire of uwserver: JSON lines and msgpack frames on one TCP port (docs/reference/protocol.md)."""

from uwserver_adapters.sockets.adapter import SocketsAdapter

__all__ = ["SocketsAdapter"]
