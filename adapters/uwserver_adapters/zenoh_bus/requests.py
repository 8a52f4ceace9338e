"""Commands, calls and questions: what comes in from the network, and its answers. Knows no session."""

from __future__ import annotations

import asyncio
import difflib
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from uwserver.adapter import AdapterContext
from uwserver.ports import Fault, Progress, Refused, Reply, Sample
from uwserver_adapters.values import SampleForm
from uwserver_adapters.zenoh_bus.codec import (
    Caller,
    Codec,
    EncodingName,
    FaultText,
    command_value,
    decode_caller,
    decode_map,
    encoding_of,
)
from uwserver_adapters.zenoh_bus.keys import KeyScheme

_log = logging.getLogger(__name__)

UNNAMED = "unnamed"
"""Who sends without an attachment; two such are not told apart."""
UNANSWERED = 1024
"""Commands and calls that may wait for the world."""
CAUSES = 256
"""Different causes of refusal that are logged, once each."""
CLIENTS = 1024
"""Named clients that may be there at once."""


@dataclass(frozen=True)
class Put:
    """A put (or delete) of a peer."""

    key: str
    payload: bytes
    media: str
    attachment: bytes | None
    is_delete: bool = False


class Answer(Protocol):
    """Where the answers to one question go. Any number of replies, then one `end`."""

    def reply(self, key: str, payload: bytes, media: str, attachment: bytes | None = None) -> None:
        """A result."""

    def refuse(self, payload: bytes, media: str) -> None:
        """An error."""

    def end(self) -> None:
        """Nothing more comes."""


class Parameters(Protocol):
    """What stands after the ``?`` of a selector."""

    def get(self, key: str, default: str | None = None) -> str | None:
        """The value of one."""


@dataclass(frozen=True)
class Question:
    """A get of a peer. `intersects` tells whether a key fits its key expression, which may have wildcards."""

    key: str
    parameters: Parameters
    payload: bytes | None
    media: str
    attachment: bytes | None
    answer: Answer
    intersects: Callable[[str], bool]


@dataclass(eq=False)
class _Running:
    cancel: Callable[[], bool]
    client: str
    id: int | None
    overdue: asyncio.TimerHandle | None = None
    is_late: bool = False


class Requests:
    """Carries out puts and gets on a context. Loop thread.

    Args:
        call_timeout_s: wall time after which the call of an unnamed caller is cancelled.
        tell: publishes a message under a key.
        look: finds who subscribes. Declarations overtake queries: who has subscribed and then asks misses nothing after the answer.
    """

    def __init__(
        self, context: AdapterContext, keys: KeyScheme, codecs: Mapping[EncodingName, Codec], default: EncodingName,
        call_timeout_s: float, tell: Callable[[str, object], None], look: Callable[[], None],
    ) -> None:  # fmt: skip
        self._context = context
        self._keys = keys
        self._codecs = codecs
        self._default: EncodingName = default
        self._call_timeout_s = call_timeout_s
        self._tell = tell
        self._look = look
        self._unanswered = 0
        self._running: dict[_Running, None] = {}
        self._leave: dict[str, Callable[[], None]] = {}
        self._names: dict[str, str] = {}
        self._told: set[tuple[str, str]] = set()

    # -- puts -------------------------------------------------------------------------------------------------------------------------

    def take_put(self, put: Put) -> None:
        """A command. There is nobody to answer: a refusal is published, and logged once per cause."""
        path = self._keys.path(put.key)
        if path is None:
            return
        client = UNNAMED
        try:
            client = decode_caller(put.attachment).client or UNNAMED
            if put.is_delete:
                raise Refused("bad_argument", f'"{path}" cannot be deleted: put a value to command an actuator', path)
            self._check_port(path)
            encoding = encoding_of(put.media, self._default)
            value = command_value(self._context.ports[path], put.payload, put.media, encoding)
            self._context.stats.commands += 1
            self._context.command(path, value, client, self._put_refused(client, path))
        except Refused as refused:
            self._refused_put(client, path, refused.fault)
        except Exception:  # noqa: BLE001  # a fault of ours must not end the adapter
            _log.exception("a put to %s failed", path[:200])
            self._context.stats.errors += 1

    def take_loss(self, put: Put) -> None:
        """A client tells how many samples did not reach it since it last did: zenoh tells a publisher of none."""
        try:
            samples = decode_map(put.payload, encoding_of(put.media, self._default)).get("samples")
            if type(samples) is not int or not 0 < samples < 1 << 32:
                raise Refused("bad_argument", '"samples" is the number of those lost since the last report', "samples")
        except Refused as refused:
            self._count("@lost", refused.fault)
        else:
            self._context.stats.dropped += samples

    def _put_refused(self, client: str, path: str) -> Callable[[Reply | Progress], None]:
        def on_reply(outcome: Reply | Progress) -> None:
            if isinstance(outcome, Reply) and outcome.fault is not None:
                self._refused_put(client, path, outcome.fault)

        return on_reply

    def _refused_put(self, client: str, path: str, fault: Fault) -> None:
        self._count(path, fault)
        known = path if path in self._context.ports else "unknown"
        told = FaultText(fault.code, fault.text[:2000], fault.where[:256], path[:256])
        self._tell(self._keys.error(client, known), told)

    def _check_port(self, path: str) -> None:
        if path not in self._context.ports:
            raise Refused(
                "unknown_port",
                f'no port "{path[:256]}"{self._similar(path, self._context.ports)}; get {self._keys.describe} lists them',
                path,
            )

    def _count(self, path: str, fault: Fault) -> None:
        stats = self._context.stats
        stats.errors += 1
        stats.last_error = f"{path[:256]}: {fault.text[:500]}"
        self._log_once(path, fault)

    def _log_once(self, path: str, fault: Fault) -> None:
        known = path in self._context.ports or path in self._context.services or path.startswith("@")
        # Names that are none are a peer's choice: they are one cause, or they would use up the log.
        cause = (path if known else "", fault.code)
        if cause not in self._told and len(self._told) < CAUSES:
            self._told.add(cause)
            _log.warning("%s refused [%s]: %s (told once)", path[:256], fault.code, fault.text[:500])

    # -- gets -------------------------------------------------------------------------------------------------------------------------

    def take_question(self, question: Question) -> None:
        """Answer, at once or when the world has the answer."""
        codec = self._codecs[self._default]
        try:
            encoding = encoding_of(question.media, self._default)
            codec = self._codecs[encoding]
            is_answered = self._answer(question, codec)
        except Refused as refused:
            self._log_once(self._keys.path(question.key) or question.key.rsplit("/", 1)[-1], refused.fault)
            self._refuse(question, codec, refused.fault)
        except Exception:  # noqa: BLE001  # a fault of ours must not end the adapter
            _log.exception("a get of %s failed", question.key[:200])
            self._refuse(
                question,
                codec,
                Fault("internal", "the server failed to answer: please report it with the server's log"),
            )
        else:
            if is_answered:
                question.answer.end()

    def _answer(self, question: Question, codec: Codec) -> bool:
        """Whether the answer is complete; else it comes later."""
        key = question.key
        if "*" in key:
            self._last_values(question)
            return True
        if key == self._keys.describe:
            self._look()
            result = self._context.describe(question.parameters.get("pattern") or "**")
            question.answer.reply(key, codec.encode(result), codec.media)
            return True
        if key == self._keys.hello:
            question.answer.reply(key, codec.encode(self._hello(question, codec)), codec.media)
            return True
        if key == self._keys.cancel:
            caller = decode_caller(question.attachment)
            question.answer.reply(key, codec.encode({"cancelled": self._cancel(caller)}), codec.media)
            return True
        return self._port_or_service(question, codec)

    def _port_or_service(self, question: Question, codec: Codec) -> bool:
        path = self._keys.path(question.key) or ""
        port = self._context.ports.get(path)
        if port is not None and port.direction == "sensor":
            if question.payload:
                raise Refused("bad_argument", f'"{path}" is a sensor: it takes no commands', path)
            self._last_values(question)
            return True
        caller = decode_caller(question.attachment)
        if port is not None:
            value = command_value(port, question.payload, question.media, codec.name)
            self._context.stats.commands += 1
            source = caller.client or UNNAMED
            shape = lambda reply: {"tick": reply.tick, "t_ns": reply.t_ns, "conflict": reply.conflict}  # noqa: E731
            self._context.command(path, value, source, self._expect(question, codec, shape))
            return False
        if path not in self._context.services:
            known = (*self._context.ports, *self._context.services)
            raise Refused(
                "unknown_service",
                f'no port or service "{path[:256]}"{self._similar(path, known)}; get {self._keys.describe} lists them',
                path,
            )
        self._call(question, codec, path, decode_map(question.payload, codec.name), caller)
        return False

    def _last_values(self, question: Question) -> None:
        self._look()
        codec = self._codecs[self._default]
        for path, port in self._context.ports.items():
            key = self._keys.of(path)
            if port.direction == "sensor" and question.intersects(key):
                sample: Sample | None = self._context.last(path)
                if sample is not None:
                    question.answer.reply(key, *codec.sample(SampleForm(port), sample))

    # -- calls ------------------------------------------------------------------------------------------------------------------------

    def _call(self, question: Question, codec: Codec, path: str, args: dict[str, object], caller: Caller) -> None:
        self._context.stats.calls += 1
        timeout_s = self._timeout(question)
        running = _Running(lambda: False, caller.client, caller.id)
        shape = lambda reply: {"tick": reply.tick, "t_ns": reply.t_ns, "value": reply.result}  # noqa: E731
        answer = self._expect(question, codec, shape)
        finished = False

        def on_reply(outcome: Reply | Progress) -> None:
            nonlocal finished
            if isinstance(outcome, Progress):
                if caller.client and caller.id is not None:
                    progress = {"id": caller.id, "fraction": outcome.fraction, "t_ns": outcome.t_ns}
                    self._tell(self._keys.progress(caller.client, caller.id), progress)
                return
            finished = True
            self._running.pop(running, None)
            if running.overdue is not None:
                running.overdue.cancel()
            if running.is_late and outcome.fault is not None:
                text = f"not done within {timeout_s:g} s and therefore cancelled: ask with ?timeout_s=... for longer"
                outcome = Reply(outcome.tick, outcome.t_ns, fault=Fault("timeout", text, path))
            answer(outcome)

        source = caller.client or UNNAMED
        name = self._names.get(caller.client, "")
        try:
            running.cancel = self._context.call(path, args, source, on_reply, name)
        except BaseException:
            self._unanswered -= 1
            raise
        if not finished and self._context.services[path].long_running:
            self._running[running] = None
            if caller.client not in self._leave:
                running.overdue = asyncio.get_running_loop().call_later(timeout_s, self._give_up, running)

    def _timeout(self, question: Question) -> float:
        given = question.parameters.get("timeout_s")
        try:
            timeout_s = self._call_timeout_s if given is None else float(given)
        except ValueError:
            timeout_s = -1.0
        if not 0.0 < timeout_s < 1e9:
            raise Refused("bad_argument", "timeout_s is a number of seconds above zero", "timeout_s")
        return timeout_s

    def _give_up(self, running: _Running) -> None:
        running.is_late = True
        running.cancel()

    def _expect(
        self, question: Question, codec: Codec, shape: Callable[[Reply], object]
    ) -> Callable[[Reply | Progress], None]:
        if self._unanswered >= UNANSWERED:
            raise Refused("overload", f"{UNANSWERED} commands and calls wait for their answer: wait for some of them")
        self._unanswered += 1

        def answer(outcome: Reply | Progress) -> None:
            if isinstance(outcome, Progress):
                return
            self._unanswered -= 1
            if outcome.fault is not None:
                self._refuse(question, codec, outcome.fault)
                return
            question.answer.reply(question.key, codec.encode(shape(outcome)), codec.media)
            question.answer.end()

        return answer

    def _refuse(self, question: Question, codec: Codec, fault: Fault) -> None:
        self._context.stats.errors += 1
        question.answer.refuse(codec.fault(fault), codec.media)
        question.answer.end()

    # -- clients ----------------------------------------------------------------------------------------------------------------------

    def _hello(self, question: Question, codec: Codec) -> dict[str, object]:
        args = decode_map(question.payload, codec.name)
        client, name, version = args.get("client"), args.get("name"), args.get("version", 1)
        if version != 1:
            raise Refused("version", f"this server speaks version 1, not {str(version)[:20]}", "version")
        if (
            not isinstance(client, str)
            or not client
            or decode_caller(codec.encode({"client": client})).client != client
        ):
            raise Refused("bad_argument", '"client" is the id whose token the client has declared', "client")
        if name is not None and not (isinstance(name, str) and 0 < len(name) <= 256):
            raise Refused("bad_argument", '"name" is a text of 1 to 256 characters', "name")
        self.client_left(client)
        if len(self._leave) >= CLIENTS:
            raise Refused("overload", f"{CLIENTS} named clients are the most there can be")
        self._leave[client] = self._context.join(name) if name is not None else _nothing
        self._names[client] = name or ""
        hello: dict[str, object] = {**self._context.hello(), "encoding": self._default}
        return hello

    def client_left(self, client: str) -> None:
        """Its token vanished: nobody waits for its calls any more, and it grants no ticks."""
        leave = self._leave.pop(client, None)
        self._names.pop(client, None)
        if leave is not None:
            leave()
            for running in [entry for entry in self._running if entry.client == client]:
                running.cancel()

    def _cancel(self, caller: Caller) -> bool:
        if not caller.client or caller.id is None:
            raise Refused("bad_argument", 'the attachment must name "client" and "id" of the call', "attachment")
        found = [entry for entry in self._running if (entry.client, entry.id) == (caller.client, caller.id)]
        cancelled = [entry.cancel() for entry in found]
        return any(cancelled)

    def close(self) -> None:
        """Cancel what is under way and let all clients go."""
        for client in list(self._leave):
            self.client_left(client)
        for running in list(self._running):
            if running.overdue is not None:
                running.overdue.cancel()
            running.cancel()

    @staticmethod
    def _similar(path: str, known: Mapping[str, object] | tuple[str, ...]) -> str:
        near = difflib.get_close_matches(path, list(known), n=1, cutoff=0.6) if len(path) <= 256 else []
        return f' (did you mean "{near[0]}"?)' if near else ""


def _nothing() -> None:
    """Leave no barrier."""
