"""The line that tells how far a long step is: only for people, only in long steps, and never with other numbers."""

from __future__ import annotations

import io
import sys
from types import SimpleNamespace

import pytest

import uwserver
from uwserver.in_process import progress
from uwserver.ports.sample_batch import Samples
from uwserver.units import NANOSECONDS


class Terminal(io.StringIO):
    """A stream that is a terminal, or is none."""

    def __init__(self, is_terminal: bool = True) -> None:
        super().__init__()
        self._is_terminal = is_terminal

    def isatty(self) -> bool:
        return self._is_terminal


@pytest.fixture
def clock(monkeypatch):
    """Wall time that a test sets; `per_tick` ns pass in each tick."""
    wall = SimpleNamespace(now=0, per_tick=NANOSECONDS // 100)
    monkeypatch.setattr(progress, "SystemTime", lambda: SimpleNamespace(now_ns=lambda: wall.now))
    return wall


def told(monkeypatch, clock, n: int, out: Terminal, err: Terminal) -> str:
    """Return what a step of n ticks writes to standard error."""
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    pieces = []

    def step(piece: int) -> Samples:
        clock.now += piece * clock.per_tick
        pieces.append(piece)
        samples = Samples()
        samples.add([piece])
        return samples

    assert sum(progress.with_progress(step, n, 1 / 240)) == n
    assert sum(pieces) == n
    return err.getvalue()


def test_a_long_step_tells_how_far_it_is_and_clears_its_line(monkeypatch, clock):
    text = told(monkeypatch, clock, 24000, Terminal(), Terminal())
    lines = text.split("\r")
    assert " 50 %: " in text
    assert "of 100.0 s, 0.417 times real time, about 120 s left" in text
    assert 100 < len(lines) < 1000, "about four lines a second for 240 s"
    assert lines[-1] == ""
    assert not lines[-2].strip()


def test_a_short_step_tells_nothing(monkeypatch, clock):
    assert told(monkeypatch, clock, 256, Terminal(), Terminal()) == ""
    clock.per_tick = NANOSECONDS // 100_000
    assert told(monkeypatch, clock, 24000, Terminal(), Terminal()) == "", "it is over in 0.24 s"


@pytest.mark.parametrize(("out", "err"), [(True, False), (False, True), (False, False)])
def test_a_file_or_a_pipe_gets_nothing(monkeypatch, clock, out, err):
    assert told(monkeypatch, clock, 24000, Terminal(out), Terminal(err)) == ""


def test_the_variable_turns_it_off(monkeypatch, clock):
    monkeypatch.setenv(progress.SWITCH, "0")
    assert told(monkeypatch, clock, 24000, Terminal(), Terminal()) == ""


def test_a_notebook_gets_it_and_a_shell_of_ipython_does_not(monkeypatch, clock):
    shell = SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    assert told(monkeypatch, clock, 24000, Terminal(False), Terminal(False))
    del shell.kernel
    assert told(monkeypatch, clock, 24000, Terminal(False), Terminal(False)) == ""


def test_the_line_is_cleared_when_the_step_is_broken_off(monkeypatch, clock):
    monkeypatch.setattr(sys, "stdout", Terminal())
    monkeypatch.setattr(sys, "stderr", Terminal())

    def step(piece: int) -> Samples:
        clock.now += piece * clock.per_tick
        if clock.now > 10 * NANOSECONDS:
            raise KeyboardInterrupt
        return Samples()

    with pytest.raises(KeyboardInterrupt):
        progress.with_progress(step, 24000, 1 / 240)
    assert sys.stderr.getvalue().endswith("\r")
    assert not sys.stderr.getvalue().split("\r")[-2].strip()


def test_pieces_make_the_same_numbers_and_a_wrong_number_is_refused_as_ever(monkeypatch):
    with uwserver.load("bluerov2_pool") as world, uwserver.load("bluerov2_pool") as other:
        wanted = world.step(1000)
        monkeypatch.setattr(progress, "is_watched", lambda: True)
        assert other.step(1000) == wanted
        assert other.save() == world.save()
        for wrong in (0, -5, 300.5, "300"):
            with pytest.raises(uwserver.Refused, match="whole number"):
                other.step(wrong)
