"""Who may steer which vehicle: one page at a time, which says again and again that it is there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from uwserver.ports import Refused

HELD_S = 2.0
"""Wall time for which a lease is held without a sign of its page."""


@dataclass
class Lease:
    """A vehicle in the hands of a page.

    Attributes:
        page: its serial.
        owner: what it calls itself.
        until: loop time at which it is lost.
    """

    page: int
    owner: str
    until: float


class Leases:
    """All leases of an adapter.

    Args:
        steady: a clock that never jumps, s (that of the loop).
        lost: called with a vehicle and the page that has lost it without giving it back.
    """

    def __init__(self, steady: Callable[[], float], lost: Callable[[str, int], None]) -> None:
        self._steady = steady
        self._lost = lost
        self._held: dict[str, Lease] = {}

    def owner(self, vehicle: str) -> Lease | None:
        """Who has a vehicle now."""
        lease = self._held.get(vehicle)
        return lease if lease is not None and lease.until > self._steady() else None

    def check(self, page: int, vehicle: str) -> None:
        """Refuse a page that does not steer the vehicle.

        Raises:
            Refused: `denied`.
        """
        lease = self.owner(vehicle)
        if lease is None:
            raise Refused("denied", f'nobody steers "{vehicle}": take it first by web/lease/take', vehicle)
        if lease.page != page:
            raise Refused(
                "denied", f'"{vehicle}" is steered by {lease.owner}: ask, or take it with force = true', vehicle
            )

    def take(self, page: int, owner: str, vehicle: str, force: bool) -> None:
        """Give a vehicle to a page; from another one only by force, which that page is told by `lost`.

        Raises:
            Refused: `denied`; somebody else has it.
        """
        lease = self.owner(vehicle)
        if lease is not None and lease.page != page and not force:
            self.check(page, vehicle)
        held = self._held.get(vehicle)
        if held is not None and held.page != page:  # perhaps run out, and not ended yet
            self._end(vehicle)
        self._held[vehicle] = Lease(page, owner, self._steady() + HELD_S)

    def keep(self, page: int) -> list[str]:
        """A sign of a page; returns the vehicles that it has."""
        now = self._steady()
        mine = [vehicle for vehicle, lease in self._held.items() if lease.page == page and lease.until > now]
        for vehicle in mine:
            self._held[vehicle].until = now + HELD_S
        return mine

    def give(self, page: int, vehicle: str | None = None) -> list[str]:
        """A page gives a vehicle back, or all that it has; returns those."""
        mine = [v for v, lease in self._held.items() if lease.page == page and vehicle in (None, v)]
        for each in mine:
            self._end(each)
        return mine

    def end(self, vehicle: str) -> None:
        """Nobody steers a vehicle any more."""
        if vehicle in self._held:
            self._end(vehicle)

    def expire(self) -> None:
        """End those whose page gave no sign."""
        now = self._steady()
        for vehicle in [vehicle for vehicle, lease in self._held.items() if lease.until <= now]:
            self._end(vehicle)

    def _end(self, vehicle: str) -> None:
        self._lost(vehicle, self._held.pop(vehicle).page)
