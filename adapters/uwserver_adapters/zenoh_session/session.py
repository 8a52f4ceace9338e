"""Opening a zenoh session, watching it, callbacks of zenoh's threads, and sending large payloads."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
import socket
from collections.abc import AsyncIterator, Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from uwserver.adapter import AdapterContext, AdapterStats, CannotServe, Worker, install_command, within
from uwserver_adapters.zenoh_session.config import ZenohConfig, endpoints, is_exposed, settings

if TYPE_CHECKING:
    import zenoh

log = logging.getLogger(__name__)
T = TypeVar("T")

RETRY_S = 0.5
"""Wall time between two attempts to open a session that must connect first."""
LARGE_BYTES = 1 << 15
"""Longest payload that is sent on the loop, bytes. zenoh sends a longer one in fragments, and may wait for them."""
REFUSED_PEERS = "error,zenoh_link_tls=warn,zenoh_link_quic=warn"
"""What zenoh logs (on stdout, as always) where certificates decide who may connect; RUST_LOG overrides it."""


WATCH_S = 2.0
"""Wall time between two checks of a session."""
ANSWER_S = 2.0
"""Wall time in which a session must pass its check, and in which it must close."""


class SessionBroken(Exception):
    """The session no longer works, by a fault of the library; its adapter must be started again."""


class NobodyThere(Exception):
    """The session needs a connection, and nobody answers yet."""


@contextlib.asynccontextmanager
async def open_session(
    config: ZenohConfig, context: AdapterContext, thread: str
) -> AsyncIterator[tuple[zenoh.Session, Worker]]:
    """Open a session, and a thread for what may block; close both at the end.

    While nobody answers, it is tried again. The session is checked now and then: a peer may break it for everybody (see `watch`).

    Args:
        config: the session's settings.
        context: its stats get the address.
        thread: name of the thread.

    Raises:
        CannotServe: zenoh is not installed, a setting is wrong, or an endpoint cannot be had.
        SessionBroken: the session has failed its check.
    """
    stats = context.stats
    sender = Worker(thread, stats)
    held: list[zenoh.Session] = []  # also holds a session whose opening was cancelled meanwhile
    try:
        while not held:
            listen = _endpoints(config)
            try:
                await sender.run(lambda listen=listen: held.append(opened(config, listen)))  # type: ignore[misc]
            except NobodyThere as error:
                stats.state, stats.last_error = "retrying", str(error)
                await asyncio.sleep(RETRY_S)
        stats.address = ", ".join(listen or config.connect) or (
            "" if config.scouting is False else "multicast scouting"
        )
        if is_exposed(config, listen):
            log.warning(
                "%s listens at %s, which others can reach, unrestricted: set access_control or TLS in `config`, or listen on loopback",
                context.name, stats.address,
            )  # fmt: skip
        async with _watched(held[0], context):
            yield held[0], sender
    finally:
        await _closed(sender, held, context)
        stats.state = "stopped"
        stats.peers = 0


async def _closed(sender: Worker, sessions: list[zenoh.Session], context: AdapterContext) -> None:
    """Close the sessions. One that is broken fails to close, and frees its endpoints nevertheless."""
    try:
        await within(ANSWER_S, sender.close(lambda: [session.close() for session in sessions]), "zenoh did not close")
    except BaseException as error:
        if not (isinstance(error, OSError) or _is_panic(error)):
            raise
        log.warning("%s: the session of zenoh did not close in order: %s", context.name, error)
        _cut_connections(frozenset(re.findall(r":(\d+)(?:,|$)", context.stats.address)))


def _cut_connections(ports: Collection[str]) -> None:
    """End the connections of this process at these TCP ports (on Linux). A broken session may keep those of its peers alive, who would then never
    look for the new one."""
    names = set()
    for table in (Path("/proc/self/net/tcp"), Path("/proc/self/net/tcp6")):
        for line in table.read_text().splitlines()[1:] if table.exists() else ():
            words = line.split()
            if str(int(words[1].rpartition(":")[2], 16)) in ports:
                names.add(f"socket:[{words[9]}]")
    for entry in Path("/proc/self/fd").iterdir() if names else ():
        with contextlib.suppress(OSError):  # it may be closed meanwhile
            if str(entry.readlink()) in names:
                with socket.socket(fileno=os.dup(int(entry.name))) as connection:
                    connection.shutdown(socket.SHUT_RDWR)


@contextlib.asynccontextmanager
async def _watched(session: zenoh.Session, context: AdapterContext) -> AsyncIterator[None]:
    """Watch a session while the block runs, and break the block off when it is broken."""
    owner = asyncio.current_task()
    assert owner is not None
    watching = asyncio.get_running_loop().create_task(watch(session, f"{context.name} watch"))
    watching.add_done_callback(lambda task: None if task.cancelled() else owner.cancel())
    try:
        yield
    except asyncio.CancelledError:
        if watching.done() and not watching.cancelled():
            raise watching.exception() or SessionBroken() from None
        raise
    except BaseException as error:
        if _is_panic(error):  # it is no Exception, so nobody else would take it for a fault of the adapter
            raise SessionBroken(_broken(error)) from None
        raise
    finally:
        watching.cancel()


async def watch(session: zenoh.Session, thread: str) -> None:
    """Check a session every `WATCH_S`, until it fails.

    zenoh 1.10.2 takes a key from a peer unchecked. One that is malformed makes the library panic when somebody declares a key next, and from then on
    it holds a lock that nothing can take any more: the session looks alive, and answers nobody. So declaring a key is the check.

    Args:
        session: the session.
        thread: name of the thread that checks, as a broken session may hold it for ever.

    Raises:
        SessionBroken: the session has failed the check.
    """
    key = f"uwserver/@watch/{session.zid()}"

    def declare() -> None:
        session.declare_subscriber(key, lambda _: None).undeclare()

    pool = ThreadPoolExecutor(1, thread)
    try:
        while True:
            await asyncio.sleep(WATCH_S)
            check = asyncio.get_running_loop().run_in_executor(pool, declare)
            await asyncio.wait([check], timeout=ANSWER_S)
            error = check.exception() if check.done() else TimeoutError(f"no key is declared in {ANSWER_S:g} s")
            if error is not None:
                raise SessionBroken(_broken(error))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _is_panic(error: BaseException) -> bool:
    """Tell whether a library in Rust has panicked. pyo3 raises an error for it whose class cannot be imported."""
    return type(error).__name__ == "PanicException"


def _broken(error: BaseException) -> str:
    return f"the session of zenoh is broken and is opened again ({str(error)[:200]})"


def opened(config: ZenohConfig, listen: tuple[str, ...]) -> zenoh.Session:
    """Open a session. This may take half a second, so it must not run on the loop.

    Raises:
        NobodyThere: it must connect first, and nobody answers.
        CannotServe: zenoh is not installed, or a setting is wrong.
    """
    try:
        import zenoh
    except ImportError as error:
        raise CannotServe(f"{error.name} is not installed: {install_command('uwserver')}") from error
    try:
        made = zenoh.Config.from_file(config.config_file) if config.config_file else zenoh.Config()
    except zenoh.ZError as error:
        raise CannotServe(f"config_file {config.config_file}: {str(error).split(' at /')[0]}") from None
    for path, value in settings(config, listen):
        try:
            made.insert_json5(path, value)
        except zenoh.ZError as error:
            reason = str(error).split(" at /")[0]
            raise CannotServe(f'zenoh refuses the setting "{path}" = {value[:200]}: {reason}') from None
    if any(endpoint.startswith(("tls/", "quic/")) for endpoint in listen):
        zenoh.init_log_from_env_or(REFUSED_PEERS)
    try:
        return zenoh.open(made)
    except zenoh.ZError as error:
        reason = str(error).split(" at /")[0].strip()
        if "nable to connect" in reason:
            raise NobodyThere(
                f"{reason} It is tried again; start what should be there, or correct `connect`."
            ) from None
        hint = "stop what uses it, or change `listen`" if "in use" in reason else "correct the adapter's table"
        raise CannotServe(f"zenoh cannot open a session: {reason}: {hint}") from None


def _endpoints(config: ZenohConfig) -> tuple[str, ...]:
    """Return where the session listens, with free ports where the table says 0.

    Raises:
        CannotServe: this machine has no such address.
    """
    try:
        return endpoints(config)
    except OSError as error:
        raise CannotServe(
            f"cannot listen at {', '.join(config.listen or ())}: {error}; 127.0.0.1 is always there, 0.0.0.0 means all"
        ) from None


def direct(callback: Callable[[T], None]) -> Callable[[T], None]:
    """Return a callback for zenoh that must only hand over to the loop: zenoh calls it without starting a Python thread."""
    import zenoh

    return zenoh.handlers.Callback(callback, indirect=False)


class Lane:
    """Sends the payloads of one publisher in their order.

    Small payloads go out on the loop. From the first large one on, all go out on the sender's thread, so that none overtakes another; while one
    is under way there, further ones are dropped.

    Args:
        sender: the thread.
        stats: counts what is dropped.
    """

    def __init__(self, sender: Worker, stats: AdapterStats) -> None:
        self._sender, self._stats = sender, stats
        self._is_busy = self._is_large = False

    def put(self, size: int, put: Callable[[], object]) -> bool:
        """Send a payload of this size, bytes, by calling `put`; return whether it is not dropped."""
        if size <= LARGE_BYTES and not self._is_large:
            put()
            return True
        self._is_large = True
        return self.put_aside(put)

    def put_aside(self, put: Callable[[], object]) -> bool:
        """Call `put` on the sender's thread; return False if it is dropped as the one before is still under way."""
        if self._is_busy:
            self._stats.dropped += 1
            return False

        def work() -> None:
            try:
                put()
            finally:
                self._is_busy = False

        self._is_busy = True  # before the thread can be done with it
        is_sent = self._sender.send(work)
        if not is_sent:
            self._is_busy = False
        return is_sent
