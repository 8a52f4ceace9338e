"""Which sender is behind which link, and where a message goes: the rules of ArduPilot's MAVLink_routes."""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

ROUTES = 64
"""Senders that are remembered; a new one replaces the oldest."""
NEVER_FORWARDED = frozenset({"RADIO", "RADIO_STATUS", "SETUP_SIGNING"})
"""Messages that concern only the two ends of one link."""


class Destinations(Struct, frozen=True):
    """Where a message goes: whether it is for us, and the other channels to which it is forwarded unchanged."""

    is_ours: bool
    to: tuple[int, ...] = ()


class Routes:
    """Learns which senders are behind which channels, and decides where messages go.

    Args:
        system, component: our own numbers.
    """

    def __init__(self, system: int, component: int) -> None:
        self._own = (system, component)
        self._seen: dict[tuple[int, int, int], None] = {}

    def destinations(
        self, channel: int, sender: tuple[int, int], target: tuple[int, int], name: str, others: Iterable[int]
    ) -> Destinations:
        """Return where a message goes.

        Args:
            channel: the channel on which it came.
            sender: system and component that sent it.
            target: addressed system and component; 0 for all, or where the message has none.
            name: name of the message.
            others: all open channels.
        """
        if sender == self._own:
            return Destinations(False)  # our own message, which a forwarding peer sent back
        if sender[0]:
            key = (*sender, channel)
            self._seen.pop(key, None)
            self._seen[key] = None
            if len(self._seen) > ROUTES:
                del self._seen[next(iter(self._seen))]
        system, component = target
        is_ours = system == 0 or (system == self._own[0] and component in (0, self._own[1]))
        if name in NEVER_FORWARDED:
            return Destinations(is_ours)
        if system == 0:
            return Destinations(True, tuple(other for other in others if other != channel))
        if is_ours and component:
            return Destinations(True)
        known = {c for s, k, c in self._seen if s == system and component in (0, k) and c != channel}
        return Destinations(is_ours, tuple(other for other in others if other in known))

    def forget(self, channel: int) -> None:
        """Forget all senders behind a channel that has been closed."""
        for key in [key for key in self._seen if key[2] == channel]:
            del self._seen[key]
