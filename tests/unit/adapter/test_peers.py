"""Places of strangers and of those that were admitted: who makes way, and how hosts are counted."""

from __future__ import annotations

import pytest

from uwserver.adapter import AdapterStats, Peers, RateMeter, Refusals, host_of, peers
from uwserver.adapter.peers import TurnTimes


class Guest:
    def __init__(self, peers: Peers, host: str, is_admitted: bool = False) -> None:
        self.is_half_open = False
        self.ended = ""
        self.peers = peers
        peers.enter(self, host)
        self.fault = peers.admit(self) if is_admitted else None

    def close(self) -> None:
        self.ended = "closed"
        self.peers.leave(self)

    def abort(self) -> None:
        self.ended = "aborted"


def peers_of(stats: AdapterStats, most: int = 4, per_host: int = 2, strangers: int = 3) -> Peers:
    return Peers(most, Refusals("mine", stats, lambda: 0.0), stats, most_per_host=per_host, strangers=strangers)


def test_silent_strangers_take_no_place_of_others():
    stats = AdapterStats()
    peers = peers_of(stats)
    known = [Guest(peers, "127.0.0.1", True) for _ in range(3)]
    flood = [Guest(peers, "192.0.2.1") for _ in range(100)]
    assert [guest.ended for guest in known] == [""] * 3
    assert [guest.ended for guest in flood] == ["aborted"] * 97 + [""] * 3
    late = Guest(peers, "127.0.0.1")
    assert flood[97].ended == "aborted", "the oldest of the host that has most"
    assert peers.admit(late) is None
    assert stats.details["refused"] == {"strangers": 98}


def test_a_flooding_host_pushes_out_its_own():
    peers = peers_of(AdapterStats())
    shy = Guest(peers, "192.0.2.9")
    flood = [Guest(peers, "192.0.2.1") for _ in range(50)]
    assert shy.ended == ""
    assert sum(guest.ended == "" for guest in flood) == 2


def test_one_host_has_not_all_places_but_this_machine_may():
    peers = peers_of(AdapterStats())
    others = [Guest(peers, "192.0.2.1", True) for _ in range(3)]
    assert [guest.fault is None for guest in others] == [True, True, False]
    assert others[2].fault is not None
    assert "max_clients_per_host" in others[2].fault.text
    peers.leave(others[0])
    assert peers.admit(others[2]) is None
    here = [Guest(peers, "127.0.0.1", True) for _ in range(3)]
    assert [guest.fault is None for guest in here] == [True, True, False]
    assert here[2].fault is not None
    assert "raise max_clients of" in here[2].fault.text
    here[0].is_half_open = True
    assert peers.admit(here[2]) is None
    assert here[0].ended == "aborted", "who only listens on makes way"


@pytest.mark.parametrize(
    ("address", "host"),
    [
        (("192.0.2.1", 7), "192.0.2.1"),
        (("::ffff:192.0.2.1", 7, 0, 0), "192.0.2.1"),
        (("2001:db8::1", 7, 0, 0), "2001:db8::/64"),
        (("2001:db8::ffff:1", 7, 0, 0), "2001:db8::/64"),
        (("fe80::1%eth0", 7, 0, 2), "fe80::/64"),
        (("::1", 7, 0, 0), "::1"),
        (None, ""),
        ("", ""),
        (("here", 7), "here"),
    ],
)
def test_hosts_of_addresses(address: object, host: str):
    assert host_of(address) == host


def test_so_many_in_a_window_and_then_a_new_one():
    meter = RateMeter(3, window_s=2.0)
    assert [meter.take(10.0) for _ in range(5)] == [True, True, True, False, False]
    assert meter.is_flooded(11.9)
    assert meter.is_full(11.9)
    assert not meter.is_full(12.0)
    assert not meter.is_flooded(12.0)
    assert meter.take(12.0)
    assert not meter.is_flooded(12.0)
    assert (meter.count, meter.end) == (1, 14.0)


def test_a_window_is_a_second_unless_told_otherwise(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(peers, "WINDOW_S", 7.0)
    meter = RateMeter(1)
    meter.take(0.0)
    assert meter.end == 7.0


def test_turns_come_one_after_the_other_with_a_rest_before_each():
    turns = TurnTimes()
    assert [turns.after(10.0, 2.0, 4.0) for _ in range(3)] == [14.0, 20.0, 26.0]
    assert turns.after(31.0, 2.0, 4.0) == 35.0
    assert turns.after(100.0, 2.0, 4.0) == 104.0


def test_one_that_costs_as_much_as_several():
    meter = RateMeter(10)
    assert meter.take(0.0, 9)
    assert not meter.take(0.0, 2)
    assert meter.take(1.0, 10)


def test_it_is_full_one_before_it_is_flooded():
    meter = RateMeter(2, window_s=2.0)
    meter.take(10.0)
    assert not meter.is_full(10.0)
    meter.take(10.0)
    assert meter.is_full(10.0)
    assert not meter.is_flooded(10.0)
