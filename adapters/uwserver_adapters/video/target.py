"""An address of the table, to which a stream goes whether or not somebody listens."""

from __future__ import annotations

from uwserver.adapter import AdapterStats
from uwserver_adapters.video.datagrams import Route
from uwserver_adapters.video.stream import Picture


class Target:
    """Takes a stream.

    Args:
        route: to the address. No reports go to the port after it, where another stream may be sent.
        stats: of the adapter.
    """

    def __init__(self, route: Route, stats: AdapterStats) -> None:
        self._route = route
        self._stats = stats

    def take(self, picture: Picture) -> None:
        """Send a picture, unless those before are still under way."""
        if not self._route.send(picture.packets):
            self._stats.dropped += 1
            return
        self._stats.samples_sent += 1
        self._stats.bytes_sent += picture.size
