"""What compiled loops say of time: clocks of copies are those of a world, and which copies have something to do."""

from fractions import Fraction

import numpy as np
import pytest

import uwserver
from uwserver.copies import kernels
from uwserver.copies.clocks import Clocks, carry_on, clocks_of, start
from uwserver.units import NANOSECONDS
from uwserver.world.ticks import Ticks

NEVER = np.iinfo(np.int64).max


def clocks_at(counts, rate):
    """Clocks at these ticks."""
    num, den = rate.numerator, rate.denominator
    t_ns = [Ticks(rate).time_of(count) for count in counts]
    rests = [(count * 2 * NANOSECONDS * den + num) % (2 * num) for count in counts]
    return Clocks(
        np.array(counts, np.int64),
        np.array([count * den / num for count in counts]),
        np.array(t_ns, np.int64),
        np.array(rests, np.int64),
    )


@pytest.mark.parametrize("rate", [Fraction(240), Fraction(1000, 7), Fraction(4000), Fraction("333.3"), Fraction(1)])
def test_a_tick_leads_to_the_times_that_a_world_tells(rate):
    """Half up where a tick falls between two nanoseconds; of months, too."""
    counts = [0, 1, 2, 6, 7, 239, 999, 10**6, 10**8 + 1, 4 * 10**8]
    if rate.denominator == 1:
        counts += [4_600_000_000]  # 222 days at 240 Hz
    clocks = clocks_at(counts, rate)
    kernels.tick(np.arange(len(counts)), clocks, rate.numerator, rate.denominator)
    assert clocks.ticks.tolist() == [count + 1 for count in counts]
    assert clocks.t_ns.tolist() == [Ticks(rate).time_of(count + 1) for count in counts]
    assert clocks.ts.tolist() == [(count + 1) * rate.denominator / rate.numerator for count in counts]


def test_a_time_between_two_nanoseconds_is_the_later_one():
    """1.5 ns a tick, which no world has, but which shows it."""
    rate = Fraction(2 * 10**9, 3)
    clocks = clocks_at([0, 1, 2, 3], rate)
    kernels.tick(np.arange(4), clocks, rate.numerator, rate.denominator)
    assert clocks.t_ns.tolist() == [2, 3, 5, 6] == [Ticks(rate).time_of(count) for count in (1, 2, 3, 4)]


def test_clocks_go_on_for_those_that_are_meant_alone():
    clocks = clocks_at([5, 6, 7, 8], Fraction(240))
    before = clocks_at([5, 6, 7, 8], Fraction(240))
    kernels.tick(np.array([1, 3]), clocks, 240, 1)
    for clock, old, new in zip(clocks, before, clocks_at([5, 7, 7, 9], Fraction(240)), strict=True):
        assert clock[[0, 2]].tolist() == old[[0, 2]].tolist()
        assert clock.tolist() == new.tolist()


@pytest.mark.parametrize("rate_hz", [240, 333.333333, 1000 / 3])
def test_rates_of_many_digits_have_times_that_are_those_of_a_world(rate_hz):
    """333.333333 is 333333333/1000000: whole numbers grow with the lower one, and 64 bits have an end."""
    rate = Fraction(str(rate_hz))
    counts = [0, 1, 999, 4610, 4611, 10**6, 10**8]
    clocks = clocks_at(counts, rate)
    carry_on(np.arange(len(counts)), clocks, rate)
    assert clocks.t_ns.tolist() == [Ticks(rate).time_of(count + 1) for count in counts]
    assert clocks.ts.tolist() == [(count + 1) * rate.denominator / rate.numerator for count in counts]


def test_clocks_begin_with_half_a_nanosecond():
    """So that their first tick is rounded as all others."""
    clocks, rate = clocks_of(3), Fraction(1000, 7)
    start(np.array([0, 2]), clocks, rate)
    for clock, at_start in zip(clocks, clocks_at([0, 0, 0], rate), strict=True):
        assert clock[[0, 2]].tolist() == at_start[[0, 2]].tolist()
    assert clocks.rests[1] == 0


class Due:
    """What `find_due` finds among copies of a real batch at these ticks, for sensors read each 6 and each 4 ticks."""

    def __init__(self, ticks, which=None, arrivals=None):
        self.batch = uwserver.batch("bluerov2_pool", len(ticks), sensors=())
        n, self.clocks = len(ticks), clocks_at(ticks, Fraction(240))
        told = np.zeros((n, 3), np.int64)
        told[:, 2] = NEVER
        for i, early_ns in (arrivals or {}).items():
            told[i, 2] = self.clocks.t_ns[i] - early_ns
        for copy in self.batch._copies:
            copy.world.instruments.set_time(-1)
        which = np.arange(n) if which is None else np.array(which)
        due, masks = np.full((2, n), -9)
        self.count = kernels.find_due(which, self.clocks, np.array([6, 4]), told, self.batch._tables.nows, due, masks)
        found = self.count if self.count >= 0 else -1 - self.count
        self.due, self.masks = due[:found].tolist(), masks[:found].tolist()
        assert (due[found:] == -9).all()

    @property
    def instants(self):
        """At which the sensors of each copy would read, ns; -1 where they were told nothing."""
        return [int(copy.world.instruments._place["t_ns"][0]) for copy in self.batch._copies]


def test_copies_that_are_due_for_the_same_are_counted():
    found = Due([12, 24, 5, 36])
    assert (found.count, found.due, found.masks) == (3, [0, 1, 3], [3, 3, 3])
    assert found.instants == [50_000_000, 100_000_000, -1, 150_000_000]


def test_nobody_is_due_between_two_readings():
    found = Due([1, 5, 7])
    assert (found.count, found.due, found.instants) == (0, [], [-1, -1, -1])


@pytest.mark.parametrize(
    ("ticks", "due", "masks"),
    [
        ([12, 6, 5, 4], [0, 1, 3], [3, 1, 2]),
        ([6, 6, 4], [0, 1, 2], [1, 1, 2]),  # the last alone
        ([6, 4, 6], [0, 1, 2], [1, 2, 1]),  # as the first again
        ([7, 4, 6], [1, 2], [2, 1]),
    ],
)
def test_where_copies_are_due_for_different_sensors_the_count_is_negative(ticks, due, masks):
    found = Due(ticks)
    assert (found.count, found.due, found.masks) == (-1 - len(due), due, masks)
    wanted = [t_ns if i in due else -1 for i, t_ns in enumerate(found.clocks.t_ns.tolist())]
    assert found.instants == wanted


def test_a_sample_that_arrives_makes_its_copy_due_though_no_sensor_reads():
    found = Due([5, 5, 5, 5], arrivals={1: 0, 2: -1, 3: 10**9})
    assert (found.count, found.due, found.masks) == (2, [1, 3], [0, 0])
    assert found.instants == [-1, found.clocks.t_ns[1], -1, found.clocks.t_ns[3]]


def test_an_arrival_beside_a_reading_is_another_mask():
    assert Due([5, 6], arrivals={0: 0}).count == -3
    assert Due([6, 6], arrivals={0: 0}).count == 2


def test_copies_that_are_not_meant_are_not_found_and_keep_their_instants():
    found = Due([12, 12, 6, 12], which=[1, 3], arrivals={2: 0})
    assert (found.count, found.due, found.masks) == (2, [1, 3], [3, 3])
    assert found.instants == [-1, 50_000_000, -1, 50_000_000]
