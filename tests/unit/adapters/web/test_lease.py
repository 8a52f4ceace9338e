"""Who steers a vehicle: one page at a time, which must say that it is there."""

from __future__ import annotations

import pytest
from uwserver_adapters.web.lease import HELD_S, Leases

from uwserver.ports import Refused


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def lost() -> list[tuple[str, int]]:
    return []


@pytest.fixture
def leases(clock: Clock, lost: list[tuple[str, int]]) -> Leases:
    return Leases(clock, lambda vehicle, page: lost.append((vehicle, page)))


def test_one_page_steers_and_others_are_told_who(leases: Leases) -> None:
    leases.take(1, "helm", "rov", False)
    leases.check(1, "rov")
    for ask in (lambda: leases.check(2, "rov"), lambda: leases.take(2, "other", "rov", False)):
        with pytest.raises(Refused, match="helm") as refused:
            ask()
        assert refused.value.fault.code == "denied"
    leases.take(2, "other", "auv", False)
    leases.check(2, "auv")


def test_nobody_steers_without_a_lease(leases: Leases) -> None:
    with pytest.raises(Refused, match="web/lease/take"):
        leases.check(1, "rov")


def test_force_takes_it_and_who_had_it_is_told(leases: Leases, lost: list[tuple[str, int]]) -> None:
    leases.take(1, "helm", "rov", False)
    leases.take(1, "helm", "rov", False)
    assert lost == []
    leases.take(2, "other", "rov", True)
    assert lost == [("rov", 1)]
    with pytest.raises(Refused):
        leases.check(1, "rov")


def test_a_lease_needs_signs_of_its_page(leases: Leases, clock: Clock, lost: list[tuple[str, int]]) -> None:
    leases.take(1, "helm", "rov", False)
    for _ in range(5):
        clock.now += 0.9 * HELD_S
        assert leases.keep(1) == ["rov"]
        leases.expire()
    clock.now += HELD_S
    with pytest.raises(Refused):
        leases.check(1, "rov")
    assert leases.keep(1) == []
    assert leases.owner("rov") is None
    leases.expire()
    assert lost == [("rov", 1)]
    leases.expire()
    assert lost == [("rov", 1)]


def test_another_page_takes_what_was_lost_without_force(
    leases: Leases, clock: Clock, lost: list[tuple[str, int]]
) -> None:
    leases.take(1, "helm", "rov", False)
    clock.now += HELD_S + 0.1
    leases.take(2, "other", "rov", False)
    assert lost == [("rov", 1)], "whoever has lost it is neutral before another one begins"
    leases.check(2, "rov")


def test_what_is_given_back_is_free(leases: Leases, lost: list[tuple[str, int]]) -> None:
    for vehicle in ("rov", "auv"):
        leases.take(1, "helm", vehicle, False)
    assert leases.give(2) == []
    assert leases.give(1, "auv") == ["auv"]
    assert leases.give(1) == ["rov"]
    assert lost == [("auv", 1), ("rov", 1)]
    leases.take(2, "other", "rov", False)
