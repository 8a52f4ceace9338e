"""Refusals are counted by cause and logged once; similar words are suggested."""

from __future__ import annotations

import pytest

from uwserver.adapter import AdapterStats, Refusals, did_you_mean
from uwserver.adapter.base import CAUSES, TELL_S, WORD_LIMIT


class Clock:
    now = 5.0

    def __call__(self) -> float:
        return self.now


def test_the_first_of_each_cause_is_logged_all_are_counted(caplog: pytest.LogCaptureFixture):
    stats = AdapterStats()
    refusals = Refusals("mine", stats, Clock())
    assert "refused" not in stats.details
    for _ in range(3):
        refusals.note("rate", "too many " + "x" * 1000)
    refusals.note("slow", "too slow")
    assert stats.details["refused"] == {"rate": 3, "slow": 1}
    assert len(caplog.records) == 2
    assert caplog.messages[0].startswith("mine refused (rate): too many xxx")
    assert len(caplog.messages[0]) < 700


def test_a_cause_is_told_again_each_minute_with_the_count_since(caplog: pytest.LogCaptureFixture):
    clock = Clock()
    refusals = Refusals("mine", AdapterStats(), clock)
    for _ in range(1000):
        refusals.note("rate", "too many")
    clock.now += TELL_S - 0.1
    refusals.note("rate", "too many")
    assert len(caplog.records) == 1
    clock.now += 0.1
    refusals.note("rate", "too many")
    refusals.note("rate", "too many")
    assert len(caplog.records) == 2
    assert "too many (1000 more since the last such line)" in caplog.messages[1]
    clock.now += TELL_S
    refusals.note("rate", "too many")
    assert "(1 more" in caplog.messages[2]


def test_however_many_causes_there_are_the_log_and_the_status_are_bounded(caplog: pytest.LogCaptureFixture):
    stats = AdapterStats()
    refusals = Refusals("mine", stats, Clock())
    for number in range(2 * CAUSES):
        refusals.note(str(number), "no")
    counts = stats.details["refused"]
    assert isinstance(counts, dict)
    assert len(counts) == len(caplog.records) == CAUSES + 1
    assert counts["other"] == CAUSES


def test_similar_words():
    assert did_you_mean("subscibe", ["subscribe", "call"]) == ' (did you mean "subscribe"?)'
    assert did_you_mean("xyz", ["subscribe", "call"]) == ""
    assert did_you_mean("s" * (WORD_LIMIT + 1), ["s" * WORD_LIMIT]) == ""


def test_a_refusal_may_be_an_error_too():
    stats = AdapterStats()
    Refusals("mine", stats, Clock()).note_error("not taken", "x" * 9999)
    assert (stats.errors, stats.details["refused"]) == (1, {"not taken": 1})
    assert stats.last_error == "x" * 500
