"""What all readers subscribe to together: as much as the one that subscribes to most."""

from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any

import pytest

from uwserver.ports.decimation import EVERY_SAMPLE, Decimation
from uwserver.simulation.subscriptions import Subscriptions, merged, merged_decimations

SLOW, SLOWER = Decimation(10.0, 0), Decimation(1.0, 5)


def reader(*subscriptions: str, **decimations: tuple[Decimation, ...]) -> Any:
    return SimpleNamespace(subscriptions=subscriptions, decimations=decimations)


def test_who_says_nothing_wants_all() -> None:
    assert merged([reader("a"), object()]) is None
    assert merged([reader("a"), reader("b", "a")]) == {"a", "b"}
    assert merged([]) == frozenset()


def test_what_one_wants_whole_is_not_decimated_and_of_others_all_count() -> None:
    readers = [reader("a", "b", "c", a=(SLOW,), b=(SLOW,), c=(SLOW,)), reader("b", "c", c=(SLOW, SLOWER))]
    assert merged_decimations(readers, {"a", "b", "c"}) == {"a": {SLOW}, "c": {SLOW, SLOWER}}


def test_what_nobody_wants_is_not_told_of() -> None:
    assert merged_decimations([reader("a", a=(SLOW,), z=(SLOW,))], {"a"}) == {"a": {SLOW}}
    assert merged_decimations([reader("a", "b", a=())], {"a", "b"}) == {}, "without any, all are needed"


def test_one_that_cannot_tell_gets_all(caplog: pytest.LogCaptureFixture) -> None:
    class Broken:
        subscriptions = ("a", "b")

        @property
        def decimations(self) -> Any:
            raise ValueError("broken")

    assert merged_decimations([Broken(), reader("a", "c", a=(SLOW,), c=(SLOW,))], {"a", "b", "c"}) == {"c": {SLOW}}
    assert "it gets all" in caplog.text
    assert {record.levelno for record in caplog.records} == {logging.ERROR}


def test_ports_that_readers_have_not_heard_of_are_wanted() -> None:
    subscriptions = Subscriptions({"a"}, {"a", "b"})
    assert "a" in subscriptions
    assert "b" not in subscriptions
    assert "new" in subscriptions
    assert (subscriptions.jumps, subscriptions.decimations) == (0, EVERY_SAMPLE)
