"""Saved states as files in the server's state folder. Other threads than the loop's read and write them, and the simulation thread never
does."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import re
import stat
import tempfile
from collections.abc import Callable, Coroutine, Mapping
from pathlib import Path

from uwserver.ports import Call, Json, OnReply, Refused, Reply
from uwserver.scenario.load.resolved import Resolved
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.thread import Simulation
from uwserver.world.state import snapshot
from uwserver.world.state.saving import in_one_piece
from uwserver.world.state.snapshot import MAX_BYTES, Snapshot

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

log = logging.getLogger(__name__)

SUFFIX = ".uwstate"
"""Added to every name, so that a client can reach no other file."""
MAX_FILES = 64
"""Most states in a folder: a GiB altogether."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_PART = re.compile(rf"{_NAME.pattern}\{SUFFIX}\.[a-z0-9_]{{8}}\.part")


def state_folder(resolved: Resolved) -> Path | None:
    """Return the folder of a scenario's states, beside the scenario's file unless the path is absolute; None for none."""
    name = resolved.scenario.server.state_folder
    if not name:
        return None
    return (Path.cwd() if resolved.path is None else resolved.path.parent) / name


def read_state(path: Path) -> bytes:
    """Return a saved state. A longer file is cut, and refused when it is loaded.

    Raises:
        OSError: it cannot be read, or is no file.
    """
    with os.fdopen(_open(path), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(f"{path} is no file")
        return file.read(MAX_BYTES + 1)


def write_state(path: Path, data: bytes) -> None:
    """Write a state as a whole or not at all: if the server is killed meanwhile, the old file stays.

    Raises:
        OSError: it cannot be written.
    """
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f"{path.name}.", suffix=".part", delete=False) as file:
        try:
            # Held as long as the writer lives, so that `remove_parts` can tell which files a dead writer has left.
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
            if fcntl is None:  # on Windows, where an open file cannot be moved
                file.close()
            Path(file.name).replace(path)
        except OSError:
            if fcntl is None:
                file.close()
            Path(file.name).unlink(missing_ok=True)
            raise


def remove_parts(folder: Path) -> None:
    """Remove the files that servers have left in a folder when they were killed while writing a state. Other files, and files that are
    being written, stay."""
    try:
        paths = [*folder.iterdir()] if folder.is_dir() else []
    except OSError as error:
        log.warning(
            "cannot look into the state folder %s: %s; world/save and world/load of files fail", folder, error.strerror
        )
        return
    for path in paths:
        if not _PART.fullmatch(path.name):
            continue
        if fcntl is None:
            # On Windows, a file cannot be removed while its writer has it open.
            with contextlib.suppress(OSError):
                if path.is_file() and not path.is_symlink():
                    path.unlink()
                    log.warning("removed %s, which a server that was killed had left", path)
            continue
        with contextlib.suppress(OSError), os.fdopen(_open(path), "rb") as file:
            if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
                log.warning("removed %s, which a server that was killed had left", path)


def check_room(path: Path) -> None:
    """Refuse one more state in a full folder.

    Raises:
        Refused: there are `MAX_FILES` others, and none of this name.
    """
    if not path.exists() and sum(1 for _ in path.parent.glob(f"*{SUFFIX}")) >= MAX_FILES:
        text = f"there are {MAX_FILES} states in the folder already: save under a used name, or have some of its files deleted"
        raise Refused("busy", text, "name")


def _open(path: Path) -> int:
    """Open a file for reading. Links are refused, as they could lead out of the folder, and pipes do not block."""
    no_follow = getattr(os, "O_NOFOLLOW", 0)
    if not no_follow and path.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    return os.open(path, os.O_RDONLY | no_follow | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))


class StateFiles:
    """Answers ``world/save`` and ``world/load`` with a file name. Loop thread.

    Args:
        folder: where the files are; None for a server that has none.
        simulation, mailbox: those of the server.
        call_soon: lets the loop call a function, from any thread.
    """

    def __init__(
        self,
        folder: Path | None,
        simulation: Simulation,
        mailbox: Mailbox,
        call_soon: Callable[[Callable[[], None]], None],
    ) -> None:
        self._folder = folder
        self._simulation = simulation
        self._mailbox = mailbox
        self._call_soon = call_soon
        self._running: set[asyncio.Task[None]] = set()
        self._one_at_a_time = asyncio.Lock()
        if folder is not None:
            remove_parts(folder)

    def call(self, service: str, args: Mapping[str, Json], source: str, on_reply: OnReply) -> None:
        """Begin to save or load a file.

        Raises:
            Refused: there is no folder, or the name is not possible.
        """
        path = self._path(str(args["name"]))
        if service == "world/load":
            self._begin(self._load(path, source, on_reply))
        else:
            self._simulation.steer(lambda: self.save_now(path, on_reply))

    def save_now(self, path: Path, on_reply: OnReply) -> None:
        """Take the state between two ticks, on the simulation thread, and let the loop write it."""
        kept = snapshot.take(self._simulation.world)
        self._call_soon(lambda: self._begin(self._save(path, kept, on_reply)))

    async def finish(self) -> None:
        """Wait for files that are being written."""
        while self._running:
            await asyncio.wait(self._running)

    def _begin(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._running.add(task)
        task.add_done_callback(self._running.discard)

    def _path(self, name: str) -> Path:
        if self._folder is None:
            text = "this server keeps no files: set [server] state_folder in its scenario, or leave the name out"
            raise Refused("denied", text, "name")
        if not _NAME.fullmatch(name):
            text = f'"{name[:80]}" cannot name a state: letters, digits, ., _ and -, no folders, at most 100'
            raise Refused("bad_argument", text, "name")
        return self._folder / f"{name.removesuffix(SUFFIX)}{SUFFIX}"

    async def _save(self, path: Path, kept: Snapshot, on_reply: OnReply) -> None:
        world = self._simulation.world

        def write() -> int:
            data = snapshot.to_bytes(world, kept)
            if path.parent == self._folder:
                path.parent.mkdir(exist_ok=True)
                check_room(path)
            write_state(path, data)
            return len(data)

        t_ns = world.ticks.time_of(kept.tick)
        try:
            async with self._one_at_a_time:
                size = await asyncio.to_thread(write)
        except OSError as error:
            on_reply(Reply(kept.tick, t_ns, fault=_failure(f"the state was not saved to {path}", error).fault))
            return
        except Refused as refused:
            on_reply(Reply(kept.tick, t_ns, fault=refused.fault))
            return
        log.info("saved the state of tick %d to %s", kept.tick, path)
        on_reply(Reply(kept.tick, t_ns, {"tick": kept.tick, "t_ns": t_ns, "bytes": size, "name": path.name}))

    async def _load(self, path: Path, source: str, on_reply: OnReply) -> None:
        world = self._simulation.world
        try:
            data = await asyncio.to_thread(read_state, path)
            self._mailbox.post(Call("world/load", in_one_piece(data), source), on_reply)
        except OSError as error:
            on_reply(Reply(world.tick, world.t_ns, fault=_failure(f"{path.name} cannot be read", error).fault))
        except Refused as refused:
            on_reply(Reply(world.tick, world.t_ns, fault=refused.fault))


def _failure(what: str, error: OSError) -> Refused:
    return Refused("bad_argument", f"{what}: {error.strerror or error}", "name")
