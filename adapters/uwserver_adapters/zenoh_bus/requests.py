"""Commands, calls and questions from the network, and their answers. Knows no session."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from uwserver.adapter import (
    AdapterContext,
    BackgroundWork,
    Conversation,
    EncodingName,
    InFlightLimit,
    Refusals,
    SampleForm,
    did_you_mean,
)
from uwserver.ports import Fault, Progress, Refused, Reply, Sample
from uwserver_adapters.zenoh_bus.codec import (
    Caller,
    Codec,
    FaultText,
    command_value,
    decode_caller,
    decode_map,
    encoding_of,
)
from uwserver_adapters.zenoh_bus.keys import KeyScheme

log = logging.getLogger(__name__)

UNNAMED = "unnamed"
"""Source of requests without an attachment; such callers cannot be told apart."""
AT_ONCE = 32
"""Ports that are looked at, or whose last values are answered, before others have their turn: it takes about 0.1 ms."""
CLIENTS = 1024
"""Most named clients at a time."""


@dataclass(frozen=True)
class Put:
    """A put or delete of a peer."""

    key: str
    payload: bytes
    media: str
    attachment: bytes | None
    is_delete: bool = False


class Answer(Protocol):
    """Takes the answers to one question: any number of replies or a refusal, then one `end`."""

    def reply(self, key: str, payload: bytes, media: str, attachment: bytes | None = None) -> None:
        """Send a result."""

    def refuse(self, payload: bytes, media: str) -> None:
        """Send an error."""

    def end(self) -> None:
        """Say that nothing more comes."""


class Parameters(Protocol):
    """The parameters after the ``?`` of a selector."""

    def get(self, key: str, default: str | None = None) -> str | None:
        """Return the value of a parameter."""


@dataclass(frozen=True)
class Question:
    """A get of a peer. `intersects` returns whether a key matches its key expression, which may have wildcards."""

    key: str
    parameters: Parameters
    payload: bytes | None
    media: str
    attachment: bytes | None
    answer: Answer
    intersects: Callable[[str], bool]


class Requests:
    """Carries out puts and gets on a context. Loop thread.

    Args:
        context: the world.
        keys: keys of this server.
        codecs: codecs of both encodings.
        default: encoding of answers to requests without a payload.
        call_timeout_s: wall time after which a long-running call of an unnamed caller is cancelled, s.
        tell: publishes a message under a key.
        refresh_matching: finds new subscribers. Declarations overtake queries: a peer that subscribes and then asks misses no sample after the
            answer.
    """

    def __init__(
        self, context: AdapterContext, keys: KeyScheme, codecs: Mapping[EncodingName, Codec], default: EncodingName,
        call_timeout_s: float, tell: Callable[[str, object], None], refresh_matching: Callable[[], None],
    ) -> None:  # fmt: skip
        self._context, self._keys, self._codecs = context, keys, codecs
        self._default: EncodingName = default
        self._call_timeout_s, self._tell, self._refresh_matching = call_timeout_s, tell, refresh_matching
        self._background = BackgroundWork()
        self._in_flight = InFlightLimit()
        self._strangers = Conversation(context, UNNAMED, self._in_flight)
        self._clients: dict[str, Conversation] = {}
        self._refusals = Refusals(context.name, context.stats, asyncio.get_running_loop().time)

    # -- puts -------------------------------------------------------------------------------------------------------------------------

    def take_put(self, put: Put) -> None:
        """Carry out a command. A put has no answer: a refusal is published, and logged once per cause."""
        path = self._keys.path(put.key)
        if path is None:
            return
        client = UNNAMED
        try:
            caller = decode_caller(put.attachment)
            client = caller.client or UNNAMED
            if put.is_delete:
                raise Refused("bad_argument", f'"{path}" cannot be deleted: put a value to command an actuator', path)
            port = self._context.ports.get(path)
            if port is None:
                hint = did_you_mean(path, self._context.ports)
                text = f'no port "{path[:256]}"{hint}; get {self._keys.describe} lists them'
                raise Refused("unknown_port", text, path)
            value = command_value(port, put.payload, put.media, encoding_of(put.media, self._default))
            answered = partial(self._put_answered, client, path)
            self._conversation(caller).command(path, value, answered, client)
        except Refused as refused:
            self._refused_put(client, path, refused.fault)
        except Exception:  # a fault of ours must not end the adapter
            log.exception("a put to %s failed", path[:200])
            self._context.stats.errors += 1

    def take_loss(self, put: Put) -> None:
        """Count the samples that a client reports as lost since its last report: zenoh does not tell a publisher of losses."""
        try:
            samples = decode_map(put.payload, encoding_of(put.media, self._default)).get("samples")
            if type(samples) is not int or not 0 < samples < 1 << 32:
                raise Refused("bad_argument", '"samples" is the number of those lost since the last report', "samples")
        except Refused as refused:
            self._count("@lost", refused.fault)
        else:
            self._context.stats.dropped += samples

    def _put_answered(self, client: str, path: str, reply: Reply) -> None:
        if reply.fault is not None:
            self._refused_put(client, path, reply.fault)

    def _refused_put(self, client: str, path: str, fault: Fault) -> None:
        self._count(path, fault)
        known = path if path in self._context.ports else "unknown"
        told = FaultText(fault.code, fault.text[:2000], fault.where[:256], path[:256])
        self._tell(self._keys.error(client, known), told)

    def _count(self, path: str, fault: Fault) -> None:
        self._context.stats.count_error(f"{path[:256]}: {fault.text}")
        self._log_once(path, fault)

    def _log_once(self, path: str, fault: Fault) -> None:
        known = path in self._context.ports or path in self._context.services or path.startswith("@")
        # Unknown names are a peer's choice. They count as one cause, so that they cannot fill the log.
        self._refusals.note(f"{path if known else 'unknown'} {fault.code}", fault.text)

    # -- gets -------------------------------------------------------------------------------------------------------------------------

    def take_question(self, question: Question) -> None:
        """Answer a get, at once or when the world has answered."""
        codec = self._codecs[self._default]
        try:
            codec = self._codecs[encoding_of(question.media, self._default)]
            self._answer(question, codec)
        except Refused as refused:
            self._log_once(self._keys.path(question.key) or question.key.rsplit("/", 1)[-1], refused.fault)
            self._refuse(question, codec, refused.fault)
        except Exception:  # a fault of ours must not end the adapter
            log.exception("a get of %s failed", question.key[:200])
            text = "the server failed to answer: please report it with the server's log"
            self._refuse(question, codec, Fault("internal", text))

    def _answer(self, question: Question, codec: Codec) -> None:
        key = question.key
        if "*" in key:
            self._refresh_matching()
            self._background.add(self._ask_all(question, codec))
        elif key == self._keys.describe:
            self._refresh_matching()
            self._reply(question, codec, self._context.describe(question.parameters.get("pattern") or "**"))
        elif key == self._keys.hello:
            self._reply(question, codec, self._hello(question, codec))
        elif key == self._keys.cancel:
            self._reply(question, codec, {"cancelled": self._cancel(decode_caller(question.attachment))})
        else:
            self._port_or_service(question, codec, self._keys.path(key) or "")

    def _port_or_service(self, question: Question, codec: Codec, path: str) -> None:
        port = self._context.ports.get(path)
        if port is not None and port.direction == "sensor":
            if question.payload:
                raise Refused("bad_argument", f'"{path}" is a sensor: it takes no commands', path)
            self._refresh_matching()
            self._ask(question, (path,))
            return
        caller = decode_caller(question.attachment)
        if port is not None:

            def answer(reply: Reply) -> None:
                result = {"tick": reply.tick, "t_ns": reply.t_ns, "conflict": reply.conflict}
                self._finish(question, codec, reply, result)

            value = command_value(port, question.payload, question.media, codec.name)
            self._conversation(caller).command(path, value, answer, caller.client)
        elif path in self._context.services:
            self._call(question, codec, path, decode_map(question.payload, codec.name), caller)
        else:
            hint = did_you_mean(path, (*self._context.ports, *self._context.services))
            text = f'no port or service "{path[:256]}"{hint}; get {self._keys.describe} lists them'
            raise Refused("unknown_service", text, path)

    def _ask_all(self, question: Question, codec: Codec) -> Iterator[None]:
        """Ask for the last samples of all ports that a question matches. It is done in pieces, as 600 ports take 3 ms."""
        paths = []
        for count, (path, port) in enumerate(list(self._context.ports.items()), 1):
            if port.direction == "sensor" and question.intersects(self._keys.of(path)):
                paths.append(path)
            if count % AT_ONCE == 0:
                yield
        try:
            self._ask(question, paths)
        except Refused as refused:
            self._refuse(question, codec, refused.fault)

    def _ask(self, question: Question, paths: Sequence[str]) -> None:
        """Ask for the last samples of these ports.

        Raises:
            Refused: too many requests wait already.
        """
        self._context.read(paths, lambda samples: self._background.add(self._last_values(question, samples)), UNNAMED)

    def _last_values(self, question: Question, samples: Sequence[Sample]) -> Iterator[None]:
        """Answer with the last samples, in pieces, and end."""
        codec = self._codecs[self._default]
        try:
            for count, sample in enumerate(samples, 1):
                port = self._context.ports.get(sample.port)
                if port is not None:
                    question.answer.reply(self._keys.of(sample.port), *codec.sample(SampleForm(port), sample))
                if count % AT_ONCE == 0:
                    yield
        finally:
            question.answer.end()

    # -- calls ------------------------------------------------------------------------------------------------------------------------

    def _conversation(self, caller: Caller) -> Conversation:
        return self._clients.get(caller.client, self._strangers)

    def _call(self, question: Question, codec: Codec, path: str, args: dict[str, object], caller: Caller) -> None:
        timeout_s = self._timeout(question)
        client, id = caller.client, caller.id
        is_limited = client not in self._clients and self._context.services[path].long_running

        def answer(reply: Reply) -> None:
            self._finish(question, codec, reply, {"tick": reply.tick, "t_ns": reply.t_ns, "value": reply.result})

        def progress(progress: Progress) -> None:
            if client and id is not None:
                message = {"id": id, "fraction": progress.fraction, "t_ns": progress.t_ns}
                self._tell(self._keys.progress(client, id), message)

        self._conversation(caller).call(
            path, args, answer, key=(client, id), progress=progress, timeout_s=timeout_s if is_limited else None,
            advice="ask with ?timeout_s=... for longer", source=client,
        )  # fmt: skip

    def _timeout(self, question: Question) -> float:
        given = question.parameters.get("timeout_s")
        try:
            timeout_s = self._call_timeout_s if given is None else float(given)
        except ValueError:
            timeout_s = -1.0
        if not 0.0 < timeout_s < 1e9:
            raise Refused("bad_argument", "timeout_s is a number of seconds above zero", "timeout_s")
        return timeout_s

    def _finish(self, question: Question, codec: Codec, reply: Reply, result: object) -> None:
        if reply.fault is not None:
            self._refuse(question, codec, reply.fault)
        else:
            self._reply(question, codec, result)

    def _reply(self, question: Question, codec: Codec, result: object) -> None:
        question.answer.reply(question.key, codec.encode(result), codec.media)
        question.answer.end()

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
        if len(self._clients) >= CLIENTS:
            raise Refused("overload", f"{CLIENTS} named clients are the most there can be")
        conversation = Conversation(self._context, client, self._in_flight)
        if name is not None:
            conversation.join(name)
        self._clients[client] = conversation
        return {**self._context.hello(), "encoding": self._default}

    def client_left(self, client: str) -> None:
        """End the calls of a client whose token has vanished; it grants no more ticks."""
        conversation = self._clients.pop(client, None)
        if conversation is not None:
            conversation.leave()
            conversation.end_calls()  # their questions are still answered, so that nothing of them is kept

    def _cancel(self, caller: Caller) -> bool:
        if not caller.client or caller.id is None:
            raise Refused("bad_argument", 'the attachment must name "client" and "id" of the call', "attachment")
        asked = (self._conversation(caller), self._strangers)
        cancelled = [conversation.cancel((caller.client, caller.id)) for conversation in asked]
        return any(cancelled)

    def close(self) -> None:
        """Cancel all calls and forget all clients."""
        for client in list(self._clients):
            self.client_left(client)
        self._background.close()
        self._strangers.end_calls()
