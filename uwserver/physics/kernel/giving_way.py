"""How a thread that steps a world lets the loop have the interpreter (`uwserver.physics.kernel.right_of_way`): in compiled code, without it.

The loop asks whenever it comes back from where it did not need the interpreter. Who steps the world sees that between two ticks, says so, and turns
round until the loop has gone again. So the lock of the interpreter is free where one of them takes it.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from uwserver.physics.kernel.arrays import Array, IntArray
from uwserver.physics.kernel.atomics import load_atomic, pause, poll, send, store_atomic
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.places import ANSWERED, ASKED, AWAKE, CALLED, GIVEN, HEARD, RUNS, WATCHED

_ASKING = 4000
"""Turns, some 100 us, for the end of a tick: of a large world it comes later, but that is in compiled code most of the time."""
GIVING = 20_000
"""Turns, some 500 us, for the loop: nearly all that it does in one go takes less."""
_ANSWERING, _LOOK = 4000, 256
"""Turns, some 100 us, for the answer of a world that was called: of a large one it comes later; and after how many the loop looks meanwhile whether
somebody else wants something."""


@compiled
def leave(numbers: Array) -> None:
    """The loop needs the interpreter no more."""
    store_atomic(numbers, ASKED, load_atomic(numbers, ASKED) + 1)


@compiled
def enter(numbers: Array) -> None:
    """The loop needs it again, and waits a moment for it."""
    asked = load_atomic(numbers, ASKED) + 1
    store_atomic(numbers, ASKED, asked)
    turns = 0
    while load_atomic(numbers, RUNS) != 0 and load_atomic(numbers, GIVEN) != asked and turns < _ASKING:
        pause()
        turns += 1


@compiled
def _is_answered(numbers: Array) -> bool:
    """The world was called, so that there will soon be an answer: stay awake for it, once for each call, and who brings it has to wake nobody.

    Either `answer` sees that nobody is awake any more, or what it has written is seen here: of two who each write, then read, one sees the other.
    """
    called, turns = load_atomic(numbers, CALLED), 0
    if load_atomic(numbers, RUNS) == 0 or called == load_atomic(numbers, HEARD):
        return False
    store_atomic(numbers, HEARD, called)
    store_atomic(numbers, AWAKE, 1)
    while load_atomic(numbers, ANSWERED) == 0 and turns < _ANSWERING:
        if turns % _LOOK == 0 and poll(numbers, WATCHED, 0) != 0:
            break
        pause()
        turns += 1
    store_atomic(numbers, AWAKE, 0)
    is_answered = load_atomic(numbers, ANSWERED) != 0
    store_atomic(numbers, ANSWERED, 0)
    return bool(is_answered)


@entry
def answer(numbers: Array) -> bool:
    """There is something for the loop. Returns whether it is awake, and goes on at once; else somebody must wake it."""
    if load_atomic(numbers, AWAKE) == 0:
        return False
    store_atomic(numbers, ANSWERED, 1)
    return bool(load_atomic(numbers, AWAKE) != 0)


@entry
def await_event(numbers: Array, milliseconds: int) -> None:
    """What the loop does until there is something to do: see `RightOfWay.sleep`."""
    leave(numbers)
    if milliseconds == 0 or not _is_answered(numbers):
        poll(numbers, WATCHED, milliseconds)
    enter(numbers)


@entry
def send_aside(numbers: Array, descriptor: int, data: Array) -> int:
    """See `RightOfWay.send`."""
    leave(numbers)
    sent = send(descriptor, data, len(data))
    enter(numbers)
    return int(sent)


@compiled
def lend(numbers: Array, asked: int) -> None:
    """The loop may have what it has asked for the so-manieth time."""
    store_atomic(numbers, GIVEN, asked)


@compiled
def take_back(numbers: Array, asked: int) -> int:
    """Wait until the loop has gone again. Returns how many turns that took, GIVING where it keeps the interpreter for long."""
    turns = 0
    while load_atomic(numbers, ASKED) == asked and turns < GIVING:
        pause()
        turns += 1
    store_atomic(numbers, GIVEN, 0)
    return turns


@entry
def give_way(numbers: Array) -> int:
    """Let the loop have what it asks for. Returns 0, or which time it was where the loop keeps it for long."""
    asked = load_atomic(numbers, ASKED)
    lend(numbers, asked)
    return asked if take_back(numbers, asked) == GIVING else 0


def load(numbers: IntArray) -> None:
    """Have what stands here ready, compiled or from the cache."""
    for kernel, given in (
        (await_event, (numbers, 0)),
        (send_aside, (numbers, 0, np.frombuffer(b"", np.uint8))),
        (give_way, (numbers,)),
        (answer, (numbers,)),
    ):
        cast("Any", kernel).load(*given)
