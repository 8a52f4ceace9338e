"""Loops that threads share: each row is done once, whoever does it; who shares never waits for one who sleeps.

Also of uwserver.physics.kernel.atomics.
"""

import threading

import numpy as np
import pytest

from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.places import ASLEEP, DONE, FUTEX, JOB, THREADS
from uwserver.physics.kernel.sharing import MOST_RANGES, share
from uwserver.physics.kernel.team import ALONE, Team

pytestmark = pytest.mark.skipif(not FUTEX, reason="threads wait in compiled code on Linux alone")


@compiled
def _count(first, end, me, times, who, gain, nothing):
    for i in range(first, end):
        for _ in range(200):
            times[i] += gain
        who[i] = me


@entry
def count_rows(team, times, who, gain, least):
    share(team, _count, (times, who, gain, None), len(times), least)


@pytest.fixture
def team():
    made = Team(3)
    made.begin()
    made.shares = True
    yield made
    made.end()


@pytest.mark.parametrize("n", [0, 1, 15, 16, 17, 1000, 16 * MOST_RANGES + 5])
def test_each_row_is_done_once(team, n):
    for turn in range(1, 4):
        times, who = np.zeros(n), np.full(n, -1)
        count_rows(team.numbers, times, who, 0.5 * turn, 8)
        assert (times == 100.0 * turn).all()
        assert ((who >= 0) & (who < 3)).all()


def test_thousands_of_loops_of_all_lengths_one_after_the_other(team):
    rng = np.random.default_rng(3)
    for n in rng.integers(16, 200, 3000):
        times, who = np.zeros(n), np.full(n, -1)
        count_rows(team.numbers, times, who, 1.0, 8)
        assert (times == 200.0).all()


def test_the_others_do_a_part_of_it(team):
    """They are awake sooner or later: a million rows take longer than that."""
    helped = set()
    for _ in range(200):
        times, who = np.zeros(20_000), np.full(20_000, -1)
        count_rows(team.numbers, times, who, 1.0, 8)
        helped |= set(who.tolist())
        if helped == {0, 1, 2}:
            return
    raise AssertionError(f"only the threads {helped} have done anything")


def test_few_rows_are_not_shared(team):
    before = team.numbers[JOB]
    who = np.full(15, -1)
    count_rows(team.numbers, np.zeros(15), who, 1.0, 8)
    assert not who.any()
    assert team.numbers[JOB] == before
    count_rows(team.numbers, np.zeros(16), np.zeros(16, int), 1.0, 8)
    assert team.numbers[JOB] == before + 1


def test_who_shares_does_not_wait_for_threads_that_never_come():
    alone = Team(2)
    alone.numbers[THREADS] = 2
    times, who = np.zeros(100), np.full(100, -1)
    count_rows(alone.numbers, times, who, 1.0, 8)
    assert not who.any()
    assert alone.numbers[DONE] == 0


def test_threads_sleep_when_nothing_is_shared(team):
    until = threading.Event()
    for _ in range(200):
        if team.numbers[ASLEEP] == 2:
            break
        until.wait(0.02)
    assert team.numbers[ASLEEP] == 2
    count_rows(team.numbers, np.zeros(100), np.zeros(100, int), 1.0, 8)


def test_who_shares_with_nobody_has_no_job():
    count_rows(ALONE, np.zeros(100), np.zeros(100, int), 1.0, 8)
    assert ALONE[JOB] == 0
