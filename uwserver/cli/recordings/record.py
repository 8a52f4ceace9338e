"""The command `record`: records from another process what a running server serves."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import click
import msgspec

from uwserver.cli.terminal import told
from uwserver.ports import Event, Port, Sample

if TYPE_CHECKING:
    from uwserver.recording.writer import RecordingWriter

log = logging.getLogger(__name__)

FLUSH_S = 0.5
"""Wall time after which a chunk is written at the latest, and so what a killed recorder loses."""
MOST_ANSWER_BYTES = 32 << 20
"""Longest line that is accepted from the server, whose own limit is half of it."""
MOST_WAITING = 10_000
"""Samples that may wait for the description of their ports."""
FIRST_BACKOFF_S, LAST_BACKOFF_S = 0.25, 5.0
_CHUNK = 1 << 16


class Ended(Exception):
    """The recording has ended; the text says why."""


class Failed(Exception):
    """The server does not answer as it should, or is another server; the text says what to do."""


@click.command(short_help="Record what a running server serves.")
@click.argument("where", nargs=-1, required=True, metavar="[SERVER] OUT")
@click.option(
    "--ports",
    multiple=True,
    metavar="PATTERN",
    help="Record only ports that match this pattern, such as 'rov/*'; may be given several times.",
)
@click.option("--seconds", type=click.FloatRange(0.0, 1e9), help="End after this wall time; default: at Ctrl-C.")
@click.option(
    "--token",
    envvar="UWSERVER_TOKEN",
    default="",
    help="Token of the server; default: the environment variable UWSERVER_TOKEN.",
)
def record(where: tuple[str, ...], ports: tuple[str, ...], seconds: float | None, token: str) -> None:
    """Record the samples and events of a running server to the file OUT.

    SERVER is HOST:PORT of its sockets adapter, by default 127.0.0.1:7600.

    uwserver record 127.0.0.1:7600 dive.mcap --ports 'rov/*' --seconds 60

    A lost connection is opened again. The file holds what was served. It can be plotted, compared and played, with boxes for vehicles. It
    cannot be replayed, because it holds neither the scenario nor the commands of other clients; a file of `uwserver run --record` does.
    """
    if len(where) > 2:
        raise click.UsageError("give a server, as 127.0.0.1:7600, and one file")
    server, out = where[0] if len(where) == 2 else "127.0.0.1:7600", Path(where[-1])
    host, colon, number = server.removeprefix("tcp://").rpartition(":")
    if not (colon and host and number.isdigit()):
        raise click.UsageError(f'"{server}" is no HOST:PORT, as 127.0.0.1:7600')
    attached = Attached((host.strip("[]"), int(number)), out, ports or ("**",), token)
    with told(out, Failed):
        why = asyncio.run(_run(attached, seconds))
    click.echo(f"wrote {out}: {attached.samples} samples, {attached.lost} lost; {why}")


async def _run(attached: Attached, seconds: float | None) -> str:
    """Record until the time is over, a signal comes, or the server ends; return which of these it was."""
    loop = asyncio.get_running_loop()
    task = loop.create_task(attached.run())
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):
            loop.add_signal_handler(number, task.cancel)
    await asyncio.wait([task], timeout=seconds)
    why = "ended by a signal"
    if not task.done():
        task.cancel()
        why = f"after {seconds:g} s"
    try:
        why = await task
    except asyncio.CancelledError:
        pass
    except BaseException:
        attached.give_up()
        raise
    attached.finish()
    return why


class Attached:
    """A client of the native protocol that records what it receives.

    Attributes:
        samples: how many samples were written.
        lost: how many the server dropped because this client was too slow or not connected.
    """

    def __init__(self, address: tuple[str, int], out: Path, patterns: tuple[str, ...], token: str) -> None:
        self.samples = self.lost = 0
        self._address, self._out, self._patterns, self._token = address, out, patterns, token
        self._file: IO[bytes] | None = None
        self._writer: RecordingWriter | None = None
        self._ports: dict[str, Port] = {}
        self._waiting: list[dict[str, Any]] = []
        self._sequence: dict[str, int] = {}
        self._newest_ns = -1
        self._flushed = 0.0
        self._is_described = self._is_subscribed = False
        self._agreed = 0

    async def run(self) -> str:
        """Record until the server ends, and return why it ended. A lost connection is opened again, with growing pauses.

        Raises:
            OSError: the file cannot be written.
            Failed: the server cannot be reached at first, refuses a request, or answers in another protocol.
        """
        backoff, host = FIRST_BACKOFF_S, "{}:{}".format(*self._address)
        while True:
            try:
                reader, sender = await asyncio.open_connection(*self._address)
            except OSError as error:
                if self._writer is None:
                    text = f"no server answers at {host}: {error.strerror or error}; start one by `uwserver run`"
                    raise Failed(text) from error
            else:
                try:
                    await self._session(reader, sender)
                except Ended as ended:
                    return str(ended)
                except (ConnectionError, asyncio.IncompleteReadError) as error:
                    log.info("%s", error)
                finally:
                    sender.close()
                click.echo(f"the connection to {host} is lost: trying again", err=True)
                if self._is_subscribed:
                    backoff = FIRST_BACKOFF_S
            self._flush()
            await asyncio.sleep(backoff)
            backoff = min(2.0 * backoff, LAST_BACKOFF_S)

    async def _session(self, reader: asyncio.StreamReader, sender: asyncio.StreamWriter) -> None:
        self._is_described = self._is_subscribed = False
        # Agreement to all patterns is remembered: from then on the file is kept whatever happens (see `give_up`).
        self._agreed = 0 if self._agreed < len(self._patterns) else self._agreed
        hello = {"version": 1, "name": "uwserver-record", **({"token": self._token} if self._token else {})}
        self._send(sender, "hello", hello)
        self._send(sender, "describe", {})
        rest, loop = b"", asyncio.get_running_loop()
        while chunk := await self._chunk(reader):
            *lines, rest = (rest + chunk).split(b"\n")
            if len(rest) > MOST_ANSWER_BYTES:
                raise Failed(f"a line of more than {MOST_ANSWER_BYTES} bytes: that is no uwserver")
            for line in lines:
                self._take(line, sender)
            if loop.time() - self._flushed >= FLUSH_S:
                self._flush()
                self._flushed = loop.time()
        raise ConnectionError("the server closed the connection")

    async def _chunk(self, reader: asyncio.StreamReader) -> bytes:
        """Return the next bytes, b"" at the end. While none come, what is written already goes to the disk."""
        read = asyncio.ensure_future(reader.read(_CHUNK))
        try:
            while not read.done():
                # Not `wait_for`, which would lose a cancellation that comes together with data.
                await asyncio.wait({read}, timeout=FLUSH_S)
                if not read.done():
                    self._flush()
        finally:
            read.cancel()
        try:
            return read.result()
        except OSError as error:
            # Tells faults of the network, such as "no route to host", from those of the disk.
            raise ConnectionError(error.strerror or str(error)) from error

    def _send(self, sender: asyncio.StreamWriter, method: str, params: dict[str, Any]) -> None:
        message = {"jsonrpc": "2.0", "id": method, "method": method, "params": params}
        sender.write(msgspec.json.encode(message) + b"\n")

    def _take(self, line: bytes, sender: asyncio.StreamWriter) -> None:
        try:
            message = msgspec.json.decode(line)
            if "error" in message:
                raise Failed(f"{message.get('id') or 'the server'}: {message['error']['message']}")
            method = message.get("method")
            if method == "sample":
                self._sample(message["params"])
            elif method == "event":
                self._event(msgspec.convert(message["params"], Event), sender)
            elif message.get("id") == "describe":
                self._described(message["result"], sender)
            elif message.get("id") == "subscribe":
                self._is_subscribed = True
                self._agreed += 1
        except (msgspec.MsgspecError, KeyError, TypeError, AttributeError) as error:
            raise Failed(f"an answer that cannot be read ({error}): give the address of a sockets adapter") from error

    def _described(self, description: dict[str, Any], sender: asyncio.StreamWriter) -> None:
        """Take in the answer to `describe`, subscribe after the first one, and write the samples that have waited for it."""
        ports = [msgspec.convert(port, Port) for port in description["ports"]]
        # Equal ports stay the same objects, by which the writer tells them apart.
        changed = {port.path: port for port in ports if self._ports.get(port.path) != port}
        if self._writer is None:
            self._begin(description, changed)
        else:
            self._writer.know(changed.values())
        self._ports |= changed
        if not self._is_described:
            self._is_described = True
            for pattern in self._patterns:
                self._send(sender, "subscribe", {"pattern": pattern, "delivery": "ring"})
        waiting, self._waiting = self._waiting, []
        for params in waiting:
            self._write(params)

    def _begin(self, description: dict[str, Any], ports: dict[str, Port]) -> None:
        from uwserver.recording.format import FORMAT, versions_here
        from uwserver.recording.parts import SERVED, new_file
        from uwserver.recording.writer import RecordingWriter

        head = {
            "format": FORMAT,
            **msgspec.structs.asdict(versions_here()),
            SERVED: "{}:{}".format(*self._address),
            "describe": msgspec.json.encode(description).decode(),
        }
        self._file = new_file(self._out)
        try:
            self._writer = RecordingWriter(self._file, head, ports)
        except BaseException:
            self._file.close()
            self._out.unlink(missing_ok=True)
            raise
        click.echo(f"recording {description['world']['scenario']} to {self._out}; Ctrl-C ends it", err=True)

    def _sample(self, params: dict[str, Any]) -> None:
        if params["port"] in self._ports:
            self._write(params)
        elif len(self._waiting) < MOST_WAITING:
            self._waiting.append(params)
        else:
            self.lost += 1

    def _write(self, params: dict[str, Any]) -> None:
        port = self._ports.get(params["port"])
        if port is None or params["value"].keys() != {field.name for field in port.fields}:
            self.lost += 1
            return
        t_ns, seq = params["t_sent_ns"], params["seq"]
        before = self._sequence.get(port.path)
        if before is not None and seq <= before and t_ns + 10**9 < self._newest_ns:
            raise Ended("the server is another run, or its time was set back: record that to a file of its own")
        self.lost += 0 if before is None else max(0, seq - before - 1)
        self._sequence[port.path] = seq
        self._newest_ns = max(self._newest_ns, t_ns)
        assert self._writer is not None
        value = tuple(params["value"][field.name] for field in port.fields)
        self._writer.sample(Sample(port.path, seq, params["t_ns"], t_ns, params["valid"], value), self._ports)
        self.samples += 1

    def _event(self, event: Event, sender: asyncio.StreamWriter) -> None:
        if self._writer is None:
            return
        self._writer.event(event)
        if event.event == "shutdown":
            raise Ended("the server has shut down")
        if event.event == "ports_changed":
            self._send(sender, "describe", {})

    def _flush(self) -> None:
        if self._writer is not None:
            self._writer.flush()

    def finish(self) -> None:
        """Write the file's index and close it."""
        if self._writer is None or self._file is None:
            return
        try:
            self._writer.finish()
        finally:
            self._file.close()

    def give_up(self) -> None:
        """Close the file as it is, readable up to its last chunk. If the server never agreed to all patterns, remove it."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
            if self._agreed < len(self._patterns):
                with contextlib.suppress(OSError):
                    self._out.unlink()
