"""One client: its requests, and the answers to them. Knows no socket."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial

from uwserver.adapter import Conversation, InFlightLimit, Undecodable, did_you_mean
from uwserver.ports import Refused, Reply
from uwserver_adapters.native.outbox import Outgoing
from uwserver_adapters.ros.feed import call, command
from uwserver_adapters.ros.messages.plain import built, plain
from uwserver_adapters.ros.messages.types import BadMessage, full_name
from uwserver_adapters.ros.parameters import Parameters
from uwserver_adapters.rosbridge.actions import Goals, Offers
from uwserver_adapters.rosbridge.codec import (
    Gathered,
    binary_frame,
    cbor,
    fragments,
    json_text,
    parsed,
    text_frame,
)
from uwserver_adapters.rosbridge.hub import TOPICS, Hub
from uwserver_adapters.rosbridge.rosapi import Rosapi
from uwserver_adapters.rosbridge.subscriptions import Options, Room, Subscription, TopicMessage
from uwserver_adapters.rosbridge.wishes import (
    LONGEST_NAME,
    Asked,
    BadRequest,
    Map,
    arguments,
    asked_of,
    name_of,
    offered_type,
    options_of,
    shorten,
)

LEVELS = ("none", "error", "warning", "info")
"""Levels of status messages. A client gets those of the level that it asks for and of all before it."""
ANSWER_S = 60.0
"""Wall time that a client has to answer a call of a service that it offers."""


class Session:
    """The session of one client. Implements `uwserver_adapters.rosbridge.hub.Client`.

    Args:
        hub: what all clients share.
        rosapi: answers calls of rosapi.
        outbox: where answers and messages wait.
        wake: called after an answer that came later than its request.
        serial: number of the client.

    Attributes:
        name: name of the client, as a node.
    """

    def __init__(self, hub: Hub, rosapi: Rosapi, outbox: Outgoing, wake: Callable[[], None], serial: int) -> None:
        self.name = f"/rosbridge_client_{serial}"
        self._hub, self._rosapi, self._outbox, self._wake = hub, rosapi, outbox, wake
        source = f"{hub.context.name}:{serial}"
        self._conversation = Conversation(hub.context, source, InFlightLimit(hub.config.max_unanswered))
        self._parameters = Parameters(self._conversation, lambda: hub.feed.catalogue.settings)
        self._subscriptions: dict[str, Subscription] = {}
        self._room = Room(hub.config.queue_bytes)
        self._subscribed = self._advertisements = 0
        self._advertised: dict[str, set[object]] = {}
        self._calls: dict[str, tuple[Callable[[bool, object], None], asyncio.TimerHandle]] = {}
        self._last_call = self._pieces = 0
        self._level = LEVELS.index("error")
        self._gathered = Gathered()
        self._goals = Goals(hub, self._conversation, self._send, self._answer)
        self._offers = Offers(hub, self._send)
        self._operations: Mapping[str, Callable[[Map], None]] = {
            "subscribe": self._subscribe, "unsubscribe": self._unsubscribe, "advertise": self._advertise,
            "unadvertise": self._unadvertise, "publish": self._publish, "call_service": self._call_service,
            "advertise_service": self._advertise_service, "unadvertise_service": self._unadvertise_service,
            "service_response": self._service_response, "set_level": self._set_level, "status": lambda _: None,
            "fragment": self._fragment, "auth": self._auth, "send_action_goal": self._goals.begin,
            "cancel_action_goal": self._goals.cancel, "advertise_action": self._offers.advertise,
            "unadvertise_action": self._offers.unadvertise, "action_feedback": self._offers.feedback,
            "action_result": self._offers.result,
        }  # fmt: skip

    # -- in ---------------------------------------------------------------------------------------------------------------------------------

    def take(self, body: bytes) -> None:
        """Carry out a message of the client. The client is told its faults; they raise nothing."""
        message: Map = {}
        try:
            message = parsed(body)
            shorten(message)
            operation = message.get("op")
            act = self._operations.get(operation) if isinstance(operation, str) else None
            if act is None:
                word, known = str(operation)[:60], ", ".join(self._operations)
                raise BadRequest(f'no operation "{word}"{did_you_mean(word, self._operations)}; there are: {known}')
            act(message)
        except (BadRequest, BadMessage) as error:
            self._wrong("message", str(error), message)
        except (Undecodable, Refused) as error:
            self._wrong(error.fault.code, error.fault.text, message)

    def _wrong(self, cause: str, text: str, message: Map) -> None:
        self._hub.context.stats.errors += 1
        self._hub.refusals.note(cause, text)
        if message.get("op") == "call_service":
            self._respond(asked_of(message), str(message.get("service", ""))[:LONGEST_NAME], False, text)
        elif message.get("op") == "send_action_goal":
            self._goals.refuse(message, text)
        else:
            self.tell("error", text, message.get("id"))

    def overloaded(self, text: str) -> None:
        """Tell the client that it sends too many messages, and that one was not taken."""
        self._hub.refusals.note("rate", text)
        self.tell("error", text, None)

    def tell(self, level: str, text: str, about: object) -> None:
        """Send a status message if the client wants those of this level.

        Args:
            level: one of `LEVELS`.
            text: text of the message.
            about: id of the client's message; None for none.
        """
        if LEVELS.index(level) > self._level:
            return
        status: Map = {"op": "status", "level": level, "msg": text}
        if about is not None:
            status["id"] = about if isinstance(about, str | int | float) else str(about)[:200]
        self._send(status)

    def _answer(self, asked: Asked, message: Map) -> None:
        """Send the answer to a request, with its id and in the form that it asked for."""
        self._send(message if asked.id is None else {**message, "id": asked.id}, asked.options)

    def _send(self, message: Map, options: Options | None = None) -> None:
        compression, size = ("none", None) if options is None else (options.compression, options.fragment_size)
        if compression in ("cbor", "cbor-raw"):
            self._outbox.put_reply(binary_frame(cbor(message)))
        else:
            text = json_text(message)
            if size is not None and len(text) > size:
                self._pieces += 1
                for piece in fragments(text, size, -self._pieces):
                    self._outbox.put_reply(piece)
            else:
                self._outbox.put_reply(text_frame(text))
        self._wake()

    def _set_level(self, message: Map) -> None:
        level = message.get("level")
        if level not in LEVELS:
            raise BadRequest(f"level is one of {', '.join(LEVELS)}, not {level!r:.60}")
        self._level = LEVELS.index(level)

    def _auth(self, message: Map) -> None:
        raise BadRequest("auth is not spoken here: give the token in the address, as ws://HOST:PORT/?token=...")

    def _fragment(self, message: Map) -> None:
        whole = self._gathered.take(message)
        if whole is not None:
            if b'"fragment"' in whole[:200]:
                raise BadRequest("fragments of fragments are not taken")
            self.take(whole)

    # -- topics -----------------------------------------------------------------------------------------------------------------------------

    def _subscribe(self, message: Map) -> None:
        topic, options = name_of(message, "topic"), options_of(message)
        asked, known = message.get("type"), self._hub.type_of(topic)
        if isinstance(asked, str) and asked and known and full_name(asked) != known:
            raise BadRequest(f'"{topic}" is of type {known}, not {asked[:100]}')
        subscription, key = self._subscriptions.get(topic), message.get("id")
        if subscription is None or key not in subscription.options:
            if self._subscribed >= self._hub.config.max_subscriptions:
                raise BadRequest(f"there are {self._subscribed} subscriptions: unsubscribe, or raise max_subscriptions")
            self._subscribed += 1
        if subscription is None:
            subscription = self._subscriptions[topic] = Subscription(topic, self._outbox, self.flush, self._room)
        subscription.add(key, options)
        last = self._hub.subscribe(self, topic)
        if last is not None:
            subscription.put(last)
            self._wake()
        if not known and topic not in self._hub.feed.topics:
            near = did_you_mean(topic, self._hub.topics())
            self.tell("warning", f'nobody publishes "{topic}"{near} yet', message.get("id"))

    def _unsubscribe(self, message: Map) -> None:
        topic = name_of(message, "topic")
        subscription = self._subscriptions.get(topic)
        if subscription is None:
            return
        before = len(subscription.options)
        is_over = subscription.remove(message.get("id"))
        self._subscribed -= before - len(subscription.options)
        if is_over:
            self._hub.unsubscribe(self, topic)
            subscription.close()
            del self._subscriptions[topic]

    def _advertise(self, message: Map) -> None:
        topic, kind = name_of(message, "topic"), message.get("type")
        if not isinstance(kind, str) or not kind:
            raise BadRequest('advertise needs a "type", as "geometry_msgs/msg/Twist"')
        self._admit(topic, full_name(kind), message.get("id"))

    def _admit(self, topic: str, kind: str, key: object) -> None:
        """Let the client publish on a topic, which may be new, until it withdraws this advertisement.

        Args:
            topic: its name.
            kind: full name of its type.
            key: id of the advertisement.

        Raises:
            BadRequest: it cannot publish there.
        """
        if len(kind) > LONGEST_NAME:
            raise BadRequest(f"a type has at most {LONGEST_NAME} characters")
        if topic in self._hub.feed.topics:
            raise BadRequest(f'"{topic}" is published by the simulator alone')
        known = self._hub.type_of(topic)
        if known and known != kind:
            raise BadRequest(f'"{topic}" is of type {known}, not {kind[:100]}')
        keys = self._advertised.get(topic, set())
        if key not in keys and self._advertisements >= self._hub.config.max_subscriptions:
            raise BadRequest(
                f"there are {self._advertisements} advertisements: unadvertise, or raise max_subscriptions"
            )
        if topic not in self._hub.advertised and len(self._hub.advertised) >= TOPICS:
            raise BadRequest(f"clients have advertised {TOPICS} topics, and no more are taken")
        self._advertisements += key not in keys
        self._advertised.setdefault(topic, set()).add(key)
        _, advertisers = self._hub.advertised.setdefault(topic, (kind, set()))
        advertisers.add(self)

    def _unadvertise(self, message: Map) -> None:
        topic, key = name_of(message, "topic"), message.get("id")
        keys = self._advertised.get(topic, set())
        withdrawn = keys & {key} if key is not None else set(keys)
        keys -= withdrawn
        self._advertisements -= len(withdrawn)
        if not keys:
            self._advertised.pop(topic, None)
            self._hub.unadvertise(self, topic)

    def _publish(self, message: Map) -> None:
        topic, given = name_of(message, "topic"), message.get("msg", {})
        command_topic = self._hub.feed.catalogue.command_topics.get(topic)
        if command_topic is not None:
            value = command_topic.value(built(self._hub.types, command_topic.type, given))
            command(self._conversation, command_topic, value, partial(self._commanded, topic, message.get("id")))
            return
        if topic not in self._advertised:
            kind = message.get("type")
            if not isinstance(kind, str):
                near = did_you_mean(topic, self._hub.feed.catalogue.command_topics)
                text = f'"{topic}" commands nothing{near}; to publish for other clients, advertise it with its type'
                raise BadRequest(text)
            self._admit(topic, full_name(kind), None)
        if not isinstance(given, dict):
            raise BadMessage("msg must be a map")
        kind = self._hub.type_of(topic)
        if kind in self._hub.types:
            built(self._hub.types, kind, given)  # only to refuse a message that is not of its type
        self._hub.relay(topic, given)

    def _commanded(self, topic: str, about: object, reply: Reply) -> None:
        if reply.fault is not None:
            self._hub.refusals.note(reply.fault.code, reply.fault.text)
            self.tell("error", f"{topic}: {reply.fault.text}", about)

    def hear(self, topic: str, message: TopicMessage) -> None:
        """Send a message of a topic."""
        subscription = self._subscriptions.get(topic)
        if subscription is not None:
            subscription.put(message)

    # -- services ---------------------------------------------------------------------------------------------------------------------------

    def _call_service(self, message: Map) -> None:
        name, args = name_of(message, "service"), message.get("args", {})
        respond = partial(self._respond, asked_of(message), name)
        offer, served = self._hub.feed.catalogue.offers.get(name), self._hub.served.get(name)
        if name.startswith("/rosapi/"):
            given = args if isinstance(args, dict) else {}
            if not self._rosapi.ask(name.removeprefix("/rosapi/"), self._parameters, given, partial(respond, True)):
                raise BadRequest(f'no service "{name[:100]}"{did_you_mean(name, self._rosapi.names)}')
        elif offer is not None:
            types = self._hub.types

            def told(response: object | None, text: str) -> None:
                respond(response is not None, text if response is None else plain(types, response))

            call(self._conversation, offer, arguments(types, f"{offer.type}_Request", args), told)
        elif served is not None:
            self._conversation.in_flight.add()

            def passed(result: bool, values: object) -> None:
                self._conversation.in_flight.count -= 1
                if not self._conversation.is_closed:
                    respond(result, values)

            served[1].serve(name, args, passed)
        else:
            near = did_you_mean(name, [*self._hub.feed.catalogue.offers, *self._hub.served])
            raise BadRequest(f'no service "{name[:100]}"{near}; /rosapi/services lists them')

    def _respond(self, asked: Asked, service: str, result: bool, values: object) -> None:
        self._answer(asked, {"op": "service_response", "service": service, "values": values, "result": result})

    def _advertise_service(self, message: Map) -> None:
        name, kind = name_of(message, "service"), offered_type(message, "srv")
        if name in self._hub.feed.catalogue.offers or name.startswith("/rosapi/"):
            raise BadRequest(f'"{name}" is a service of the simulator')
        known = self._hub.served.get(name)
        if known is not None and known[1] is not self:
            raise BadRequest(f'"{name}" is offered by another client')
        if sum(client is self for _, client in self._hub.served.values()) >= self._hub.config.max_subscriptions:
            raise BadRequest("too many services are offered")
        self._hub.served[name] = (kind, self)

    def _unadvertise_service(self, message: Map) -> None:
        name = name_of(message, "service")
        if self._hub.served.get(name, ("", None))[1] is self:
            del self._hub.served[name]

    def serve(self, service: str, args: object, answer: Callable[[bool, object], None]) -> None:
        """Pass on a call of another client to this one, which offers the service."""
        if len(self._calls) >= self._hub.config.max_unanswered:
            answer(False, f"{service}: too many calls wait for its client")
            return
        self._last_call += 1
        key = f"call_service:{service}:{self._last_call}"
        self._send({"op": "call_service", "id": key, "service": service, "args": args})
        timer = asyncio.get_running_loop().call_later(ANSWER_S, self._overdue, key)
        self._calls[key] = (answer, timer)

    def _overdue(self, key: str) -> None:
        answer, _ = self._calls.pop(key)
        answer(False, f"no answer within {ANSWER_S:g} s")

    def _service_response(self, message: Map) -> None:
        answer, timer = self._calls.pop(str(message.get("id")), (None, None))
        if answer is None or timer is None:
            raise BadRequest("service_response: no call of this id waits")
        timer.cancel()
        answer(message.get("result") is not False, message.get("values", {}))

    # -- out --------------------------------------------------------------------------------------------------------------------------------

    def flush(self) -> None:
        """Send what waits."""
        self._outbox.flush()

    def close(self) -> None:
        """End everything that the client has begun or offers: it has gone."""
        self._conversation.close()
        self._goals.close()
        self._offers.close()
        self._hub.leave(self)
        for subscription in self._subscriptions.values():
            subscription.close()
        for answer, timer in list(self._calls.values()):
            timer.cancel()
            answer(False, "the client that offers this service has gone")
        self._calls.clear()
