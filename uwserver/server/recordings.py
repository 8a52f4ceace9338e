"""Recordings that clients begin and end while the server runs: ``recording/start``, ``recording/stop`` and ``recording/state``. Loop thread.

A client names a file, never a folder: all of them lie in `[server] recordings`. The file begins with the state of the world at the border of a tick,
so that a replay needs nothing from before. Files are made, written and closed beside the loop.
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
from uwserver.simulation.bus import Bus
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
"""Recordings in the folder."""
RESERVE_BYTES = 200_000_000
"""That a recording leaves free on its disk."""
MAX_WAITING = 64
"""Requests that may wait for the disk: who begins and ends all the time keeps nobody else from ending for long."""
LOOK_S = 0.5
"""Wall time between two looks at how much was written; so much more than the limit there can be."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_TRIES = 100
_LOST = "somebody has moved or deleted the file"


class Recordings:
    """The recordings of a server, one at a time.

    Args:
        folder: where the files are; None for a server on which clients begin none.
        most_bytes: of all files in the folder.
        resolved: what the world was built from.
        simulation, bus: of the server.
        given: the recording for which the command line asked; None for none.
        foxglove: whether recordings hold channels for Foxglove, Lichtblick and rerun, too.
    """

    def __init__(
        self,
        folder: Path | None,
        most_bytes: int,
        resolved: Resolved,
        simulation: Simulation,
        bus: Bus,
        given: Recorder | None = None,
        *,
        foxglove: bool = True,
    ) -> None:
        self._folder, self._most_bytes, self._resolved, self._foxglove = folder, most_bytes, resolved, foxglove
        self._simulation, self._bus, self._given = simulation, bus, given
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
            Refused: no file can have that name, this server records nothing for clients, or too much is asked at once.
        """
        if len(self._tasks) >= MAX_WAITING:
            text = f"{MAX_WAITING} requests about recordings wait to be answered already: ask again when they are"
            raise Refused("busy", text)
        if service == STATE.path:
            self._spawn(self._answered(self._state(), on_reply))
        elif service == STOP.path:
            self._spawn(self._answered(self._stop(f"{STOP.path} by {source}"), on_reply))
        else:
            name = str(args["name"])
            if self._folder is None:
                text = "clients may record nothing here: set [server] recordings in the scenario, or run with --record"
                raise Refused("denied", text)
            if name and not _NAME.fullmatch(name):
                text = f'"{name[:80]}" cannot name a recording: letters, digits, ., _ and -, no folders, at most 100'
                raise Refused("bad_argument", text, "name")
            self._spawn(self._answered(self._start(self._folder, name, source), on_reply))

    def status(self) -> dict[str, Json] | None:
        """For ``world/status``: the recording that goes on, or the last; None where there was none."""
        return None if self._last is None else self._last.status()

    def abandon(self, reason: str) -> None:
        """Give a recording up, as its world cannot be asked any more."""
        if self._now is not None:
            self._now.abandon(reason)

    async def finish(self) -> None:
        """The simulation thread has ended: end the recording in order, and wait for the disk. May be called again."""
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

    async def _answered(self, work: Coroutine[Any, Any, Json], on_reply: OnReply) -> None:
        world = self._simulation.world
        try:
            result = await work
            on_reply(Reply(world.tick, world.t_ns, result))
        except Refused as refused:
            on_reply(Reply(world.tick, world.t_ns, fault=refused.fault))
        except Exception as error:  # ours; who asked must not wait for ever
            log.exception("a recording could not be begun or ended")
            on_reply(Reply(world.tick, world.t_ns, fault=Refused("internal", f"internal fault: {error}").fault))

    async def _state(self) -> Json:
        folder, sizes = self._folder, dict[str, int]()
        if folder is not None:
            try:
                sizes = await _beside(partial(sizes_in, folder))
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
                recorder, most = await _beside(partial(self._opened, folder, name))
            except OSError as error:
                raise Refused("denied", f"nothing can be recorded to {folder}: {error.strerror or error}") from error
            try:
                await self._begin(recorder)
            except BaseException:
                self._leave()
                await _beside(partial(_discard, recorder))
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
        if self._simulation.failure:
            raise Refused("denied", f"{self._simulation.failure}\nCall world/reset or world/restore first.")

    def _opened(self, folder: Path, name: str) -> tuple[Recorder, int]:
        """A new file, and how large it may become. Not on the loop: it waits for the disk."""
        folder.mkdir(exist_ok=True)
        sizes = sizes_in(folder)
        left = self._most_bytes - sum(sizes.values())
        if len(sizes) >= MAX_FILES or left <= 0:
            text = f"there are {len(sizes)} recordings in {folder}, of {sum(sizes.values()) / 1e6:.0f} MB together"
            most = f"at most {MAX_FILES} of {self._most_bytes / 1e6:.0f} MB ([server] recordings_mb)"
            raise Refused("busy", f"{text}; {most}: have some of them deleted")
        if (free := shutil.disk_usage(folder).free) < RESERVE_BYTES:
            text = f"the disk of {folder} is full: {free / 1e6:.0f} MB are free, {RESERVE_BYTES / 1e6:.0f} MB stay so"
            raise Refused("busy", text)
        stem = name.removesuffix(SUFFIX) if name else self._usual_name()
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

    def _usual_name(self) -> str:
        scenario = re.sub(r"[^A-Za-z0-9._-]", "_", self._resolved.name).lstrip("._-")[:60] or "run"
        return f"{scenario}-{utc_text()}"

    async def _begin(self, recorder: Recorder) -> None:
        end_heed = self._bus.heed(recorder)  # so that all samples of its first tick are made

        def attach() -> None:
            self._detach = self._bus.attach(recorder)

        try:
            state = await self._between_ticks(lambda: recorder.begin(self._simulation), attach)
        finally:
            end_heed()
        try:
            await _beside(partial(recorder.write_from, state))
        except Exception as error:
            text = (error.strerror if isinstance(error, OSError) else None) or str(error)
            recorder.abandon(text)
            await self._end(recorder)  # there, as the simulation thread tells it of each tick
            if not isinstance(error, OSError | Refused):
                raise
            raise Refused("denied", f"nothing can be recorded: {text}") from error

    async def _watch(self, recorder: Recorder, most: int) -> None:
        """End a recording that may not, or cannot, go on."""
        while True:
            await asyncio.sleep(LOOK_S)
            free = await _beside(partial(_free_beside, recorder.path))
            status = recorder.status()
            written = status["bytes"]
            if free is None:
                recorder.abandon(_LOST)
                reason = _LOST
            elif status["error"]:
                reason = str(status["error"])
            elif isinstance(written, int) and written >= most:
                reason = f"recordings have {self._most_bytes / 1e6:.0f} MB together, which is all they may"
            elif free < RESERVE_BYTES:
                reason = f"the disk is full: {free / 1e6:.0f} MB are free"
            else:
                continue
            self._watcher = None  # which `_stop` must not cancel
            self._spawn(self._answered(self._stop(reason), lambda reply: None))
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
            await _beside(recorder.close)
            if await _beside(partial(_free_beside, recorder.path)) is None:
                recorder.abandon(_LOST)
            self._now = None
        status = recorder.status()
        self._say(f"the recording to {recorder.path} has ended: {status['error'] or reason}")
        return status

    async def _end(self, recorder: Recorder) -> None:
        """Follow the run no more."""
        try:
            await self._between_ticks(recorder.end, self._leave)
        except Refused:  # the simulation thread has ended: nobody else is there
            recorder.end()
            self._leave()

    def _leave(self) -> None:
        if self._detach is not None:
            self._detach()
            self._detach = None

    # -- the simulation ---------------------------------------------------------------------------------------------------------------

    async def _between_ticks(self, action: Callable[[], T], then: Callable[[], None]) -> T:
        """What an action of the simulation thread gave. `then` is called on the loop behind all that was published before the action, and before
        anything that is published after it.

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


def recordings_of(
    resolved: Resolved, simulation: Simulation, bus: Bus, given: Recorder | None, *, foxglove: bool
) -> Recordings:
    """Those of a server of this scenario; arguments as for `Recordings`."""
    config = resolved.scenario.server
    folder = Path.cwd() / config.recordings if config.recordings else None
    return Recordings(folder, config.recordings_mb * 1_000_000, resolved, simulation, bus, given, foxglove=foxglove)


def sizes_in(folder: Path) -> dict[str, int]:
    """Bytes of each recording in a folder, by name; none where there is no folder. Raises OSError."""
    if not folder.is_dir():
        return {}
    sizes = {}
    for path in folder.glob(f"*{SUFFIX}"):
        with contextlib.suppress(FileNotFoundError):  # somebody tidies up meanwhile
            if stat.S_ISREG((status := path.stat()).st_mode):
                sizes[path.name] = status.st_size
    return sizes


def _discard(recorder: Recorder) -> None:
    """Leave no file of a recording that did not begin."""
    recorder.abandon("it could not begin")
    recorder.end()
    recorder.close()
    recorder.path.unlink(missing_ok=True)


def _free_beside(path: Path) -> int | None:
    """Bytes that are free on the disk of a file; None where that file is no more."""
    try:
        path.lstat()
        return shutil.disk_usage(path.parent).free
    except OSError:
        return None


async def _beside(work: Callable[[], T]) -> T:
    """Wait for the disk without keeping the loop."""
    return await asyncio.get_running_loop().run_in_executor(None, work)


def _shutdown() -> Refused:
    return Refused("shutdown", "the server is shutting down")
