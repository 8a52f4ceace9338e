"""Threads of a team: they begin, and end with it, with the interpreter, and in a fork there are none."""

import gc
import os
import subprocess
import sys
import threading

import pytest

from uwserver.physics.kernel import team as teams
from uwserver.physics.kernel.places import FUTEX, SIZE
from uwserver.physics.kernel.team import ALONE, Team, why_alone

pytestmark = pytest.mark.skipif(not FUTEX, reason="threads wait in compiled code on Linux alone")


def names():
    return sorted(t.name for t in threading.enumerate() if t.name.startswith("uwserver-kernels"))


@pytest.fixture(autouse=True)
def nobody_before():
    gc.collect()
    assert names() == []
    yield
    gc.collect()
    assert names() == []


def test_the_numbers_begin_a_cache_line():
    assert ALONE.ctypes.data % 64 == 0
    assert len(ALONE) == SIZE


def test_threads_begin_and_end():
    team = Team(3)
    assert not names()
    team.begin()
    team.begin()
    assert names() == ["uwserver-kernels-1", "uwserver-kernels-2"]
    assert not team.shares
    team.shares = True
    assert team.shares
    team.end()
    assert not names()
    assert not team.shares
    team.shares = True
    team.begin()
    assert not team.shares
    assert not names()


def test_threads_end_with_a_team_that_is_dropped():
    team = Team(2)
    team.begin()
    team.shares = True
    del team
    gc.collect()
    assert not names()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_process_has_one_thread_and_the_interpreter_ends_with_threads_asleep():
    code = (
        "import os, threading\nfrom uwserver.physics.kernel.team import Team\nt = Team(2); t.begin(); t.shares = True\n"
        "child = os.fork()\n"
        "if child == 0:\n    ok = not t.shares; t.end(); os._exit(0 if ok else 1)\n"
        "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), t.shares, threading.active_count())"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert (found.returncode, found.stdout.strip()) == (0, "0 True 2"), found.stderr


def test_why_there_is_one_thread(monkeypatch):
    monkeypatch.setattr(teams, "cores", lambda: 2)
    assert why_alone() == ""
    monkeypatch.setattr(teams, "cores", lambda: 1)
    assert "one core" in why_alone()
    monkeypatch.setattr(teams, "FUTEX", 0)
    assert "Linux" in why_alone()
