"""Places of strangers and of those that were admitted: who makes way, and how hosts are counted."""

from __future__ import annotations

import pytest

from uwserver.adapter import AdapterStats, Peers, Refusals, host_of


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
