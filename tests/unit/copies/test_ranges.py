"""Ranges of copies in several threads: each copy in one of them, done when the call returns, and no thread left behind."""

import gc
import os
import signal
import threading
import warnings

import numpy as np
import pytest

from uwserver.copies import ranges
from uwserver.copies.ranges import LEAST_COPIES, MOST_THREADS, Ranges, threads_for
from uwserver.ports import Refused


def living():
    return [thread for thread in threading.enumerate() if thread.name.startswith("uwserver-copies")]


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("n", [0, 1, 2, 3, 5, 9, 64])
def test_every_copy_is_in_one_part_and_every_part_in_a_range_of_its_own(count, n):
    which, seen = np.arange(n) * 3, []
    shared = Ranges(count)
    shared.run(which, lambda part, k: seen.append((k, part.tolist())))
    assert [i for _, part in sorted(seen) for i in part] == which.tolist()
    assert len({k for k, _ in seen}) == len(seen)
    assert all(k < count for k, _ in seen)
    shared.close()


def test_ranges_are_at_work_at_the_same_time():
    """Each waits for the others, which would not come if one thread did them in turn."""
    shared, meet = Ranges(3), threading.Barrier(3, timeout=20)
    shared.run(np.arange(6), lambda part, k: meet.wait())
    shared.close()


def test_what_a_range_raises_comes_when_all_are_done():
    shared, begun, done = Ranges(2), threading.Event(), []

    def loop(part, k):
        if k == 0:
            assert begun.wait(20)
            raise ValueError("of the caller's range")
        begun.set()
        threading.Event().wait(0.05)  # so that whoever does not wait for this one is seen
        done.append(part.tolist())
        raise KeyError("of another")

    with pytest.raises(ValueError, match="caller's"):
        shared.run(np.arange(4), loop)
    assert done == [[2, 3]]

    def other(part, k):
        if k:
            raise KeyError("of another")

    with pytest.raises(KeyError, match="of another"):
        shared.run(np.arange(4), other)
    shared.close()


def test_no_thread_with_one_and_none_left_when_closed_or_dropped():
    before = len(living())
    Ranges(1).run(np.arange(9), lambda part, k: None)
    assert len(living()) == before
    shared = Ranges(2)
    assert len(living()) == before, "they begin with the first loop"
    shared.run(np.arange(9), lambda part, k: None)
    assert len(living()) == before + 1
    shared.close()
    assert (len(living()), shared.count) == (before, 1)
    parts = []
    shared.run(np.arange(9), lambda part, k: parts.append(len(part)))
    assert (len(living()), parts) == (before, [9])
    shared = Ranges(2)
    shared.run(np.arange(9), lambda part, k: None)
    (dropped,) = living()[before:]
    del shared
    gc.collect()
    dropped.join(20)
    assert not dropped.is_alive()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_has_threads_of_its_own():
    """Those of its parent are not there, and who waits for them waits for ever."""
    shared = Ranges(2)
    shared.run(np.arange(4), lambda part, k: None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if not child:
        signal.alarm(20)
        seen = []
        shared.run(np.arange(4), lambda part, k: seen.append(len(part)))
        os._exit(0 if seen == [2, 2] else 3)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    shared.close()


def test_a_thread_a_core_where_there_are_copies_enough(monkeypatch):
    for cores, wanted in ((1, 1), (2, 2), (4, 4), (64, 4)):
        monkeypatch.setattr(ranges, "cores", lambda cores=cores: cores)
        assert threads_for(LEAST_COPIES, None) == wanted
        assert threads_for(LEAST_COPIES - 1, None) == 1
        assert threads_for(1, 3) == 3
    for wrong in (0, -1, MOST_THREADS + 1):
        with pytest.raises(Refused, match="1 to 16 threads"):
            threads_for(1000, wrong)
