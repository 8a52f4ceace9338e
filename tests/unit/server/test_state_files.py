"""Files of saved states: whole or not at all, and no way out of the folder."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

import pytest

from uwserver.ports import Refused
from uwserver.server import state_files
from uwserver.server.state_files import MAX_FILES, check_room, read_state, remove_parts, write_state

KILLED = """
import os, signal, sys
from pathlib import Path
from uwserver.server import state_files

state_files.os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL)
state_files.write_state(Path(sys.argv[1]), b"half of it")
"""


def test_two_at_once_leave_one_of_both_whole(tmp_path: Path) -> None:
    path, contents = tmp_path / "x.uwstate", [bytes([k]) * 300_000 for k in range(4)]
    for _ in range(5):
        threads = [threading.Thread(target=write_state, args=(path, content)) for content in contents]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30)
        assert path.read_bytes() in contents
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_written_leaves_nothing_behind(tmp_path: Path) -> None:
    target = tmp_path / "x.uwstate"
    (target / "full").mkdir(parents=True)  # a folder that is not empty cannot be replaced
    with pytest.raises(OSError, match="irectory"):
        write_state(target, b"x")
    assert list(tmp_path.iterdir()) == [target]


def test_a_link_at_the_old_name_of_the_part_is_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(b"mine")
    (tmp_path / "x.uwstate.part").symlink_to(victim)
    write_state(tmp_path / "x.uwstate", b"state")
    assert victim.read_bytes() == b"mine"
    assert read_state(tmp_path / "x.uwstate") == b"state"


def test_only_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    for name in ("pipe", "link", ".", "missing"):
        with pytest.raises(OSError, match=r"."):
            read_state(tmp_path / name)


def test_what_a_killed_server_was_writing_is_removed_and_the_old_state_stays(tmp_path: Path) -> None:
    path = tmp_path / "x.uwstate"
    write_state(path, b"old")
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], timeout=60)
    assert done.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 2
    remove_parts(tmp_path)
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"old"


def test_only_parts_of_states_that_nobody_writes_are_removed(tmp_path: Path) -> None:
    remove_parts(tmp_path / "none yet")
    victim = tmp_path / "victim"
    victim.write_bytes(b"mine")
    for name in (
        "a.uwstate",
        "a.uwstate.part",
        "a.uwstate.abcd12.part",
        "a.txt.abcd1234.part",
        ".b.uwstate.abcd1234.part",
    ):
        (tmp_path / name).write_bytes(b"kept")
    (tmp_path / "link.uwstate.abcd1234.part").symlink_to(victim)
    (tmp_path / "folder.uwstate.abcd1234.part").mkdir()
    os.mkfifo(tmp_path / "pipe.uwstate.abcd1234.part")
    with (tmp_path / "living.uwstate.abcd1234.part").open("wb") as living:
        fcntl.flock(living, fcntl.LOCK_EX)
        kept = set(tmp_path.iterdir())
        (tmp_path / "dead.uwstate.abcd1234.part").write_bytes(b"half")
        remove_parts(tmp_path)
        assert set(tmp_path.iterdir()) == kept
    assert victim.read_bytes() == b"mine"


def test_a_full_folder_takes_used_names_only(tmp_path: Path) -> None:
    for k in range(MAX_FILES):
        check_room(tmp_path / f"{k}.uwstate")
        (tmp_path / f"{k}.uwstate").write_bytes(b"")
    check_room(tmp_path / "0.uwstate")
    with pytest.raises(Refused, match="used name"):
        check_room(tmp_path / "more.uwstate")


ANOTHER_USER = """
import os, sys
from pathlib import Path
from uwserver.recording.recorder import Recorder
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.server.state_files import remove_parts, write_state
from uwserver.simulation.bus import Bus
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.clock import SystemTime, Timing
from uwserver.simulation.thread import Simulation

resolved = load(Scenario(schema=1), adapters={})
world, bus = build(resolved), Bus(lambda _: None)
simulation = Simulation(world, Timing(), SystemTime(), bus, Mailbox())
import mcap.writer
os.chdir(sys.argv[1])
os.setuid(65534)

def told(action):
    try:
        action()
    except OSError as error:
        return f"{type(error).__name__}: {error}"
    return "nothing"

def record():
    with Recorder(Path("readable/run.mcap"), world, resolved).running(simulation, bus):
        pass

print(told(record))
print(told(lambda: write_state(Path("readable/x.uwstate"), b"x")))
print(told(lambda: remove_parts(Path("closed"))))
print(told(lambda: remove_parts(Path("closed/below"))))
"""


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root can become another user")
def test_folders_in_which_a_user_may_not_write_or_look(tmp_path: Path) -> None:
    (tmp_path / "readable").mkdir(mode=0o755)
    (tmp_path / "closed").mkdir(mode=0o700)
    tmp_path.chmod(0o755)
    done = subprocess.run(
        [sys.executable, "-c", ANOTHER_USER, str(tmp_path)], capture_output=True, text=True, timeout=120, check=False
    )
    record, save, *clean = done.stdout.splitlines() or [done.stderr]
    assert (
        "cannot record to readable/run.mcap: Permission denied; give --record a place that can be written" in record
    ), done.stderr
    assert save.startswith("PermissionError")
    assert clean == ["nothing", "nothing"], "the server begins all the same"
    assert done.stderr.count("cannot look into the state folder") == 2
    assert [*(tmp_path / "readable").iterdir()] == []


def test_a_system_without_locks_and_links_reads_and_writes_as_well(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As on Windows: no fcntl, no O_NOFOLLOW, and an open file cannot be moved or removed."""
    monkeypatch.setattr(state_files, "fcntl", None)
    for flag in ("O_NOFOLLOW", "O_NONBLOCK"):
        monkeypatch.delattr(os, flag)
    closed_first: list[bool] = []
    real, move = tempfile.NamedTemporaryFile, Path.replace
    opened: list[Any] = []

    def remember(**keys: Any) -> Any:
        opened.append(real(**keys))
        return opened[-1]

    def replace(self: Path, target: Path) -> Path:
        closed_first.append(opened[-1].closed)
        return move(self, target)

    monkeypatch.setattr(tempfile, "NamedTemporaryFile", remember)
    monkeypatch.setattr(Path, "replace", replace)
    path, link = tmp_path / "a.uwstate", tmp_path / "b.uwstate"
    write_state(path, b"one\r\n\x1a two")
    assert read_state(path) == b"one\r\n\x1a two"
    assert closed_first == [True]
    link.symlink_to(path)
    with pytest.raises(OSError, match="symbolic"):
        read_state(link)
    part = tmp_path / "a.uwstate.abcd_123.part"
    part.write_bytes(b"half")
    remove_parts(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.uwstate", "b.uwstate"]
