"""Which page steers which vehicle: one page at a time, which must renew its lease."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from uwserver.ports import Refused

HELD_S = 2.0
"""Wall time for which a lease lasts without being renewed."""


@dataclass
class Lease:
    """A vehicle that a page steers.

    Attributes:
        page: serial number of the page.
        owner: the name that it gives itself.
        until: loop time at which the lease ends.
    """

    page: int
    owner: str
    until: float


class Leases:
    """All leases of an adapter.

    Args:
        steady: a clock that never jumps, s (the loop's).
        lost: called with a vehicle and the page whose lease has ended, in whatever way.
    """

    def __init__(self, steady: Callable[[], float], lost: Callable[[str, int], None]) -> None:
        self._steady = steady
        self._lost = lost
        self._held: dict[str, Lease] = {}

    def owner(self, vehicle: str) -> Lease | None:
        """Return the lease of a vehicle now."""
        lease = self._held.get(vehicle)
        return lease if lease is not None and lease.until > self._steady() else None

    def check(self, page: int, vehicle: str) -> None:
        """Refuse a page that does not steer the vehicle.

        Raises:
            Refused: `denied`.
        """
        lease = self.owner(vehicle)
        if lease is None:
            raise Refused("denied", f'no page steers "{vehicle}": call web/lease/take first', vehicle)
        if lease.page != page:
            raise Refused(
                "denied", f'"{vehicle}" is steered by {lease.owner}: ask, or take it with force = true', vehicle
            )

    def take(self, page: int, owner: str, vehicle: str, force: bool) -> None:
        """Give a vehicle to a page. It is taken from another page only by force.

        Raises:
            Refused: `denied`, because another page has it.
        """
        if not force and self.owner(vehicle) is not None:
            self.check(page, vehicle)
        held = self._held.get(vehicle)
        if held is not None and held.page != page:  # also if it has run out and was not ended yet
            self.end(vehicle)
        self._held[vehicle] = Lease(page, owner, self._steady() + HELD_S)

    def keep(self, page: int) -> list[str]:
        """Renew the leases of a page, and return its vehicles."""
        now = self._steady()
        mine = [vehicle for vehicle, lease in self._held.items() if lease.page == page and lease.until > now]
        for vehicle in mine:
            self._held[vehicle].until = now + HELD_S
        return mine

    def give(self, page: int, vehicle: str | None = None) -> list[str]:
        """End the lease of a page for a vehicle, or all its leases. Returns the vehicles."""
        mine = [v for v, lease in self._held.items() if lease.page == page and vehicle in (None, v)]
        for each in mine:
            self.end(each)
        return mine

    def end(self, vehicle: str) -> None:
        """End the lease of a vehicle, if there is one."""
        lease = self._held.pop(vehicle, None)
        if lease is not None:
            self._lost(vehicle, lease.page)

    def expire(self) -> None:
        """End the leases that were not renewed."""
        now = self._steady()
        for vehicle in [vehicle for vehicle, lease in self._held.items() if lease.until <= now]:
            self.end(vehicle)
