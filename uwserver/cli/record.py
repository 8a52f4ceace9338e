"""`uwserver record`: what a running server serves, written down from another process."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import click
import msgspec

from uwserver.ports import Event, Port, Sample

if TYPE_CHECKING:
    from uwserver.recording.writer import RecordingWriter

log = logging.getLogger(__name__)

FLUSH_S = 0.5
"""A chunk is written at the latest after this wall time: that much a killed recorder loses."""
MOST_ANSWER_BYTES = 32 << 20
"""Of one line of the server, whose own limit is half of it."""
MOST_WAITING = 10_000
"""Samples of ports that the server has not described yet."""
FIRST_BACKOFF_S, LAST_BACKOFF_S = 0.25, 5.0
_CHUNK = 1 << 16


class Ended(Exception):
    """The recording is at its end; the text says why."""


class Failed(Exception):
    """The server does not answer as it should, or is another one; the text says what to do."""


@click.command(short_help="Record what a running server serves.")
@click.argument("where", nargs=-1, required=True, metavar="[SERVER] OUT")
@click.option("--ports", multiple=True, metavar="PATTERN", help="Only these, as 'rov/*'; may be given several times.")
@click.option("--seconds", type=click.FloatRange(0.0, 1e9), help="End after so much wall time; default: at Ctrl-C.")
@click.option("--token", envvar="UWSERVER_TOKEN", default="", help="That the server asks for; default: UWSERVER_TOKEN.")
def record(where: tuple[str, ...], ports: tuple[str, ...], seconds: float | None, token: str) -> None:
    """Record the samples and events of a running SERVER (HOST:PORT of its sockets adapter, default 127.0.0.1:7600) to the file OUT.

    uwserver record 127.0.0.1:7600 dive.mcap --ports 'rov/*' --seconds 60

    A lost connection is made again. The file has what was served: it can be plotted, compared and played, with boxes for vehicles, but not
    replayed, as the scenario and the commands of others are not in it (`uwserver run --record` has them).
    """
    if len(where) > 2:
        raise click.UsageError("give a server, as 127.0.0.1:7600, and one file")
    server, out = where[0] if len(where) == 2 else "127.0.0.1:7600", Path(where[-1])
    host, colon, number = server.removeprefix("tcp://").rpartition(":")
    if not (colon and host and number.isdigit()):
        raise click.UsageError(f'"{server}" is no HOST:PORT, as 127.0.0.1:7600')
    attached = Attached((host.strip("[]"), int(number)), out, ports or ("**",), token)
    try:
        why = asyncio.run(_run(attached, seconds))
    except (Failed, OSError) as error:
        raise click.ClickException(str(error)) from error
    click.echo(f"wrote {out}: {attached.samples} samples, {attached.lost} lost; {why}")


async def _run(attached: Attached, seconds: float | None) -> str:
    """Record until the time is over, a signal comes, or the server ends; says which."""
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
    """A client of the native protocol that writes what it gets.

    Attributes:
        samples: written.
        lost: that the server dropped because this client was too slow, or while it was not connected.
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
        """Record until the server ends; says so.

        Raises:
            OSError: the server cannot be reached at first, or the file not be written.
            Failed: it refuses, or is another run when it comes back.
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
        self._agreed = 0 if self._agreed < len(self._patterns) else self._agreed
        hello = {"version": 1, "name": "uwserver-record", **({"token": self._token} if self._token else {})}
        self._send(sender, "hello", hello)
        self._send(sender, "describe", {})
        rest, loop = b"", asyncio.get_running_loop()
        while True:
            chunk = await self._chunk(reader)
            if not chunk:
                raise ConnectionError("the server closed the connection")
            *lines, rest = (rest + chunk).split(b"\n") if b"\n" in chunk else (rest + chunk,)
            if len(rest) > MOST_ANSWER_BYTES:
                raise Failed(f"a line of more than {MOST_ANSWER_BYTES} bytes: that is no uwserver")
            for line in lines:
                self._take(line, sender)
            if loop.time() - self._flushed >= FLUSH_S:
                self._flush()
                self._flushed = loop.time()

    async def _chunk(self, reader: asyncio.StreamReader) -> bytes:
        """What comes next; b"" at the end. What is written already goes to the disk meanwhile."""
        read = asyncio.ensure_future(reader.read(_CHUNK))
        try:
            while not read.done():
                await asyncio.wait(
                    {read}, timeout=FLUSH_S
                )  # `wait_for` would lose a cancellation that comes together with data
                if not read.done():
                    self._flush()
            return read.result()
        except ConnectionError:
            raise
        except OSError as error:  # of the network, not of the disk
            raise ConnectionError(error.strerror or str(error)) from error
        finally:
            read.cancel()

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

    def _described(self, told: dict[str, Any], sender: asyncio.StreamWriter) -> None:
        found = {port["path"]: msgspec.convert(port, Port) for port in told["ports"]}
        if self._writer is None:
            self._begin(told, found)
        else:
            self._writer.know(port for path, port in found.items() if self._ports.get(path) != port)
        # Equal ports stay the objects that they are: the writer tells kinds apart by them.
        self._ports |= {path: port for path, port in found.items() if self._ports.get(path) != port}
        if not self._is_described:
            self._is_described = True
            for pattern in self._patterns:
                self._send(sender, "subscribe", {"pattern": pattern, "delivery": "ring"})
        waiting, self._waiting = self._waiting, []
        for params in waiting:
            self._write(params)

    def _begin(self, told: dict[str, Any], ports: dict[str, Port]) -> None:
        from uwserver.recording.format import FORMAT, versions_here
        from uwserver.recording.opening import new_file
        from uwserver.recording.parts import SERVED
        from uwserver.recording.writer import RecordingWriter

        head = {
            "format": FORMAT,
            **msgspec.structs.asdict(versions_here()),
            SERVED: "{}:{}".format(*self._address),
            "describe": msgspec.json.encode(told).decode(),
        }
        self._file = new_file(self._out)
        try:
            self._writer = RecordingWriter(self._file, head, ports)
        except BaseException:
            self._file.close()
            self._out.unlink(missing_ok=True)
            raise
        click.echo(f"recording {told['world']['scenario']} to {self._out}; Ctrl-C ends it", err=True)

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
        """Close the file as it is: readable up to its last chunk. Where the server never agreed to all patterns, nothing is left of it."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
            if self._agreed < len(self._patterns):
                with contextlib.suppress(OSError):
                    self._out.unlink()


COMMANDS = (record,)
