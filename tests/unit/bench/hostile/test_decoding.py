"""What is told of work: how long it keeps a thread waiting that wants the interpreter, in processor time."""

from __future__ import annotations

import sys
import time

from uwserver_bench.hostile.decoding import Rival

WORK_NS = 20_000_000


def in_python() -> None:
    end = time.thread_time_ns() + WORK_NS
    while time.thread_time_ns() < end:
        pass


def in_one_piece() -> int:
    return pow(3, 1_200_000) & 1


def test_what_python_does_lets_others_in_and_what_is_compiled_does_not() -> None:
    before = sys.getswitchinterval()
    with Rival() as rival:
        interrupted = min(rival.cost(in_python).held_ns for _ in range(5))
        whole = rival.cost(in_one_piece)
        slept = rival.cost(lambda: time.sleep(0.02))
    assert interrupted < WORK_NS / 2
    assert whole.held_ns > 0.8 * whole.spent_ns
    assert max(slept) < WORK_NS / 2
    assert sys.getswitchinterval() == before
