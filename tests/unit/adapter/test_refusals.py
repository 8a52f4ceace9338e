"""Refusals are counted by cause and logged once; similar words are suggested."""

from __future__ import annotations

import pytest

from uwserver.adapter import AdapterStats, Refusals, did_you_mean
from uwserver.adapter.refusals import CAUSES, WORD_LIMIT


def test_the_first_of_each_cause_is_logged_all_are_counted(caplog: pytest.LogCaptureFixture):
    stats = AdapterStats()
    refusals = Refusals("mine", stats)
    assert "refused" not in stats.details
    for _ in range(3):
        refusals.note("rate", "too many " + "x" * 1000)
    refusals.note("slow", "too slow")
    assert stats.details["refused"] == {"rate": 3, "slow": 1}
    assert len(caplog.records) == 2
    assert caplog.messages[0].startswith("mine refused (rate): too many xxx")
    assert len(caplog.messages[0]) < 700


def test_however_many_causes_there_are_the_log_and_the_status_are_bounded(caplog: pytest.LogCaptureFixture):
    stats = AdapterStats()
    refusals = Refusals("mine", stats)
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
