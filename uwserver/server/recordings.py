"""Recordings that clients begin and end while the server runs: ``recording/start``, ``recording/stop`` and ``recording/state``. Loop
thread.

A client names a file, never a folder: all files are in `[server] recordings`. A file begins with the state of the world between two ticks,
so that a replay needs nothing from before. Files are opened, written and closed in other threads than the loop's.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import shutil
import stat
from collections.abc import Callable, Coroutine, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from uwserver.ports import Argument, Event, Json, OnReply, Refused, Reply, Service
from uwserver.recording.recorder import Recorder
from uwserver.scenario.load.resolved import Resolved
from uwserver.simulation.clock import utc_text
from uwserver.simulation.thread import Simulation

log = logging.getLogger(__name__)

T = TypeVar("T")

START = Service(
    "recording/start",
    "Begin a recording at the next border of a tick, in the server's folder of recordings. Answers when the file is there.",
    (
        Argument(
            "name", "str", "of the file, without folders; default: scenario and time (UTC)", required=False, default=""
        ),
    ),
)
STOP = Service("recording/stop", "End the recording that recording/start began. Answers when the file is whole.")
STATE = Service(
    "recording/state",
    "What is recorded now, or was last; the folder of the recordings, its files, and the bytes that more may have.",
    reads_only=True,
)
SERVICES = {service.path: service for service in (START, STOP, STATE)}

SUFFIX = ".mcap"
MAX_FILES = 256
"""Most recordings in the folder."""
RESERVE_BYTES = 200_000_000
"""Bytes that a recording leaves free on its disk."""
MAX_WAITING = 64
"""Most requests that may wait for the disk, so that a client with many requests does not keep another from ending a recording for long."""
POLL_S = 0.5
"""Wall time between two checks of the file size. A recording may exceed its limit by what is written in that time."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_TRIES = 100
_LOST = "the file was moved or deleted"


class Recordings:
    """The recordings of a server, one at a time.

    Args:
        resolved: the scenario of the world; its `[server]` names the folder of the recordings, and their size altogether.
        simulation: simulation of the server.
        given: the recording that the command line has requested; None for none.
        foxglove: whether recordings have channels for Foxglove, Lichtblick and rerun, too.
    """

    def __init__(
        self, resolved: Resolved, simulation: Simulation, given: Recorder | None = None, *, foxglove: bool = True
    ) -> None:
        config = resolved.scenario.server
        self._folder = Path.cwd() / config.recordings if config.recordings else None
        self._most_bytes = config.recordings_mb * 1_000_000
        self._resolved, self._foxglove = resolved, foxglove
        self._simulation, self._bus, self._given = simulation, simulation.bus, given
        self._now: Recorder | None = None
        self._last = given
        self._detach: Callable[[], None] | None = None
        self._watcher: asyncio.Task[None] | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._one_at_a_time = asyncio.Lock()
        self._waiting: asyncio.Future[Any] | None = None
        self._is_over = False

    def call(self, service: str, args: Mapping[str, Json], source: str, on_reply: OnReply) -> None:
        """Begin to answer one of `SERVICES`, with checked arguments.

        Raises:
            Refused: no file can have that name, clients cannot record on this server, or too many requests wait.
        """
        if len(self._tasks) >= MAX_WAITING:
            text = f"{MAX_WAITING} requests about recordings wait to be answered already: ask again when they are"
            raise Refused("busy", text)
        if service == STATE.path:
            self._spawn(self._reply_with(self._state(), on_reply))
        elif service == STOP.path:
            self._spawn(self._reply_with(self._stop(f"{STOP.path} by {source}"), on_reply))
        else:
            name = str(args["name"])
            if self._folder is None:
                text = "clients may record nothing here: set [server] recordings in the scenario, or run with --record"
                raise Refused("denied", text)
            if name and not _NAME.fullmatch(name):
                text = f'"{name[:80]}" cannot name a recording: letters, digits, ., _ and -, no folders, at most 100'
                raise Refused("bad_argument", text, "name")
            self._spawn(self._reply_with(self._start(self._folder, name, source), on_reply))

    def status(self) -> dict[str, Json] | None:
        """Return the status of the present recording, or of the last one, for ``world/status``; None if there was none."""
        return None if self._last is None else self._last.status()

    def abandon(self, reason: str) -> None:
        """Give the present recording up, as its world can no longer be read."""
        if self._now is not None:
            self._now.abandon(reason)

    async def finish(self) -> None:
        """End the recording in order after the simulation thread has ended, and wait for the disk. May be called again."""
        self._is_over = True
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_exception(_shutdown())
        while self._tasks:
            await asyncio.wait(self._tasks)
        if self._now is not None:
            await self._stop("the server ends")

    # -- answers ----------------------------------------------------------------------------------------------------------------------

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _reply_with(self, work: Coroutine[Any, Any, Json], on_reply: OnReply) -> None:
        world = self._simulation.world
        try:
            result = await work
            on_reply(Reply(world.tick, world.t_ns, result))
        except Refused as refused:
            on_reply(Reply(world.tick, world.t_ns, fault=refused.fault))
        except Exception as error:  # A fault of ours; the client must get an answer all the same.
            log.exception("a recording could not be begun or ended")
            on_reply(Reply(world.tick, world.t_ns, fault=Refused("internal", f"internal fault: {error}").fault))

    async def _state(self) -> Json:
        folder, sizes = self._folder, dict[str, int]()
        if folder is not None:
            try:
                sizes = await asyncio.to_thread(sizes_in, folder)
            except OSError as error:
                raise Refused("denied", f"{folder} cannot be read: {error.strerror or error}") from error
        return {
            "recorder": self.status(),
            "folder": None if folder is None else str(folder),
            "files": [{"name": name, "bytes": size} for name, size in sorted(sizes.items())],
            "bytes_left": max(0, self._most_bytes - sum(sizes.values())) if folder is not None else 0,
        }

    # -- begin ------------------------------------------------------------------------------------------------------------------------

    async def _start(self, folder: Path, name: str, source: str) -> Json:
        async with self._one_at_a_time:
            self._check_idle()
            try:
                recorder, most = await asyncio.to_thread(self._opened, folder, name)
            except OSError as error:
                raise Refused("denied", f"nothing can be recorded to {folder}: {error.strerror or error}") from error
            try:
                await self._begin(recorder)
            except BaseException:
                self._detach_recorder()
                await asyncio.to_thread(_discard, recorder)
                raise
            self._now = self._last = recorder
            self._watcher = asyncio.get_running_loop().create_task(self._watch(recorder, most))
        began = recorder.status()
        self._say(f"recording to {recorder.path}, asked for by {source}")
        return {"name": recorder.path.name, "path": str(recorder.path), "t_ns": began["since_ns"]}

    def _check_idle(self) -> None:
        if self._is_over:
            raise _shutdown()
        for recorder, end in ((self._given, "with the server"), (self._now, f"by {STOP.path}")):
            if recorder is not None and recorder.status()["recording"]:
                raise Refused("busy", f"{recorder.path} is being recorded already: that ends {end}")
        if self._now is not None:
            raise Refused("busy", f"the recording {self._now.path} is just ending")
        self._simulation.check_runs()

    def _opened(self, folder: Path, name: str) -> tuple[Recorder, int]:
        """Return a new file, and how large it may become. Not called on the loop, as it waits for the disk."""
        folder.mkdir(exist_ok=True)
        sizes = sizes_in(folder)
        left = self._most_bytes - sum(sizes.values())
        if len(sizes) >= MAX_FILES or left <= 0:
            text = f"there are {len(sizes)} recordings in {folder}, of {sum(sizes.values()) / 1e6:.0f} MB together"
            most = f"at most {MAX_FILES} of {self._most_bytes / 1e6:.0f} MB ([server] recordings_mb)"
            raise Refused("busy", f"{text}; {most}: have some of them deleted")
        if (free := shutil.disk_usage(folder).free) < RESERVE_BYTES:
            text = f"the disk of {folder} is full: {free / 1e6:.0f} MB are free, and {RESERVE_BYTES / 1e6:.0f} MB must stay free"
            raise Refused("busy", text)
        stem = name.removesuffix(SUFFIX) if name else self._default_name()
        for attempt in range(1, _TRIES if not name else 2):
            path = folder / f"{stem if attempt == 1 else f'{stem}-{attempt}'}{SUFFIX}"
            recorder = Recorder(path, self._simulation.world, self._resolved, foxglove=self._foxglove)
            try:
                recorder.open(self._simulation.timing)
            except FileExistsError:
                continue
            return recorder, left
        text = f"{stem}{SUFFIX} is there already, and a recording is never overwritten: give another name"
        raise Refused("bad_argument", text, "name")

    def _default_name(self) -> str:
        scenario = re.sub(r"[^A-Za-z0-9._-]", "_", self._resolved.name).lstrip("._-")[:60] or "run"
        return f"{scenario}-{utc_text()}"

    async def _begin(self, recorder: Recorder) -> None:
        end_reading = self._bus.add_reader(recorder)  # so that all samples of its first tick are made

        def attach() -> None:
            self._detach = self._bus.attach(recorder)

        try:
            state = await self._between_ticks(lambda: recorder.begin(self._simulation), attach)
        finally:
            end_reading()
        try:
            await asyncio.to_thread(recorder.write_from, state)
        except Exception as error:
            text = (error.strerror if isinstance(error, OSError) else None) or str(error)
            recorder.abandon(text)
            await self._end(recorder)  # Ended on the simulation thread, which shows it each tick.
            if not isinstance(error, OSError | Refused):
                raise
            raise Refused("denied", f"nothing can be recorded: {text}") from error

    async def _watch(self, recorder: Recorder, most: int) -> None:
        """End a recording that must not, or cannot, go on."""
        while True:
            await asyncio.sleep(POLL_S)
            free = await asyncio.to_thread(_free_bytes, recorder.path)
            status = recorder.status()
            written = status["bytes"]
            if free is None:
                recorder.abandon(_LOST)
                reason = _LOST
            elif status["error"]:
                reason = str(status["error"])
            elif isinstance(written, int) and written >= most:
                reason = f"recordings have {self._most_bytes / 1e6:.0f} MB together, which is the limit"
            elif free < RESERVE_BYTES:
                reason = f"the disk is full: {free / 1e6:.0f} MB are free"
            else:
                continue
            self._watcher = None  # `_stop` must not cancel this task.
            self._spawn(self._reply_with(self._stop(reason), lambda reply: None))
            return

    # -- end --------------------------------------------------------------------------------------------------------------------------

    async def _stop(self, reason: str) -> Json:
        async with self._one_at_a_time:
            recorder = self._now
            if recorder is None:
                if self._given is not None and self._given.status()["recording"]:
                    text = f"{self._given.path} was asked for on the command line: it ends with the server"
                    raise Refused("denied", text)
                raise Refused("denied", f"nothing is being recorded: {START.path} begins a recording")
            if self._watcher is not None:
                self._watcher.cancel()
                self._watcher = None
            await self._end(recorder)
            await asyncio.to_thread(recorder.close)
            if await asyncio.to_thread(_free_bytes, recorder.path) is None:
                recorder.abandon(_LOST)
            self._now = None
        status = recorder.status()
        self._say(f"the recording to {recorder.path} has ended: {status['error'] or reason}")
        return status

    async def _end(self, recorder: Recorder) -> None:
        """Stop following the run."""
        try:
            await self._between_ticks(recorder.end, self._detach_recorder)
        except Refused:  # The simulation thread has ended, so no other thread uses the recorder.
            recorder.end()
            self._detach_recorder()

    def _detach_recorder(self) -> None:
        if self._detach is not None:
            self._detach()
            self._detach = None

    # -- the simulation ---------------------------------------------------------------------------------------------------------------

    async def _between_ticks(self, action: Callable[[], T], then: Callable[[], None]) -> T:
        """Return the result of an action of the simulation thread. `then` is called on the loop after everything that was published before
        the action, and before everything that is published after it.

        Raises:
            Refused: that thread has ended.
        """
        if self._is_over:
            raise _shutdown()
        done: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        self._waiting = done

        def act() -> None:
            result = action()
            self._bus.hand_over(partial(arrived, result))

        def arrived(result: T) -> None:
            then()
            if not done.done():
                done.set_result(result)

        self._simulation.steer(act, always=True)
        try:
            return await done
        finally:
            self._waiting = None

    def _say(self, text: str) -> None:
        world = self._simulation.world
        self._bus.say(Event("recording", world.tick, world.t_ns, text))


def sizes_in(folder: Path) -> dict[str, int]:
    """Return the size (bytes) of each recording in a folder, by name; empty if there is no folder. Raises OSError."""
    if not folder.is_dir():
        return {}
    sizes = {}
    for path in folder.glob(f"*{SUFFIX}"):
        with contextlib.suppress(FileNotFoundError):  # the file was deleted meanwhile
            if stat.S_ISREG((status := path.stat()).st_mode):
                sizes[path.name] = status.st_size
    return sizes


def _discard(recorder: Recorder) -> None:
    """Remove the file of a recording that did not begin."""
    recorder.abandon("it could not begin")
    recorder.end()
    recorder.close()
    recorder.path.unlink(missing_ok=True)


def _free_bytes(path: Path) -> int | None:
    """Return the free bytes on the disk of a file; None if the file is gone."""
    try:
        path.lstat()
        return shutil.disk_usage(path.parent).free
    except OSError:
        return None


def _shutdown() -> Refused:
    return Refused("shutdown", "the server is shutting down")
