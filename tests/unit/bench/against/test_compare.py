"""A comparison is as many pairs as asked for, or as time allows, of what worlds, fresh processes and servers tell."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from uwserver_bench.against import compare
from uwserver_bench.against.figures import Comparison
from uwserver_bench.against.pairs import Kind, Pairs, in_turns
from uwserver_bench.processes import BenchFailed

FACTS = {"folder": "/a", "python": "3", "packages": {}, "distributions": 1, "extras": ["mavlink"]}
KINDS = {
    "worlds": Kind("ticks", "a tick", "us"),
    "fresh": Kind("loading", "a load", "ms"),
    "servers": Kind("server", "a client", "ms"),
}
COST = {"ours": 3.0, "theirs": 2.0}
PAIR_NS = 60 * 10**9


class Both:
    """Worlds, or servers, of both versions."""

    files = ()

    def __init__(self, kind: str) -> None:
        self.kind = KINDS[kind]

    def warm_up(self, pairs: Pairs, say: object) -> None:
        pass

    def measure(self, pair: int, pairs: Pairs) -> None:
        pairs.measure(self.kind, in_turns(pair), COST.__getitem__)


@pytest.fixture
def extras(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What both versions have besides; each pair takes a minute."""
    found: list[str] = []
    now = [0]

    def servers(versions: object, place: object, quick: bool, extras: list[str]) -> Both:
        found.extend(extras)
        return Both("servers")

    def fresh(versions: object, files: object, place: object, pair: int, pairs: Pairs) -> None:
        now[0] += PAIR_NS
        Both("fresh").measure(pair, pairs)

    sides = {side: SimpleNamespace(facts=lambda place: FACTS) for side in COST}
    monkeypatch.setattr(compare, "ours", lambda: sides["ours"])
    monkeypatch.setattr(compare, "theirs", lambda venv: sides["theirs"])
    monkeypatch.setattr(compare, "EXTRAS", ("mavlink", "zenoh"))
    monkeypatch.setattr(compare, "Worlds", lambda *_: Both("worlds"))
    monkeypatch.setattr(compare, "Servers", servers)
    monkeypatch.setattr(compare, "measure_fresh", fresh)
    monkeypatch.setattr(compare.SystemTime, "now_ns", lambda self: now[0])
    return found


def compared(pairs: int, minutes: float, only: str = "") -> tuple[Comparison, list[str]]:
    said: list[str] = []
    return compare.compare(Path("/b"), pairs, minutes, True, only, said.append), said


def test_figures_come_in_the_order_of_their_groups_with_a_value_for_each_pair(extras: list[str]) -> None:
    found, said = compared(3, 60.0)
    assert [(figure.group, figure.ours, figure.theirs) for figure in found.figures] == [
        (group, (3.0,) * 3, (2.0,) * 3) for group in ("loading", "ticks", "server")
    ]
    assert said == ["pair 1 of 3", "pair 2 of 3, about 2 minutes more", "pair 3 of 3, about 1 minutes more"]
    assert (found.pairs, found.quick, found.versions) == (3, True, {"ours": FACTS, "theirs": FACTS})
    assert extras == ["mavlink"], "what one side has not is not compared"


def test_no_pair_begins_after_its_time(extras: list[str]) -> None:
    assert compared(15, 2.5)[0].pairs == 3


def test_what_is_not_asked_for_is_not_there_and_nothing_at_all_is_a_failure(extras: list[str]) -> None:
    assert [figure.name for figure in compared(1, 60.0, "tick")[0].figures] == ["a tick"]
    with pytest.raises(BenchFailed, match='no figure has "tack" in its name'):
        compared(1, 60.0, "tack")
