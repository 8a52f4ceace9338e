"""One client: its subscriptions, and its requests to the world."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Protocol

from uwserver.adapter import AdapterContext, Conversation, InFlightLimit, RateMeter, Refusals, did_you_mean
from uwserver.ports import Fault, Refused, Reply
from uwserver_adapters.foxglove import codec
from uwserver_adapters.foxglove.catalogue import SCENE, Catalogue, parameters_of
from uwserver_adapters.foxglove.codec import BadMessage, ClientData, PlaybackControl, ServiceCall
from uwserver_adapters.foxglove.config import FoxgloveConfig
from uwserver_adapters.foxglove.outbox import Outbox
from uwserver_adapters.foxglove.playback import Playback

Call = tuple[str, Mapping[str, object]]
"""Path of a service, and arguments."""
_ERROR = 2
_SUBSCRIPTIONS_OF_A_CHANNEL = 8
_ENTRIES_OF_A_REQUEST = 8
"""Number of entries in a list that count as one more request."""
_TEXT_LIMIT = 2000


class Server(Protocol):
    """The adapter, as its clients see it.

    Attributes:
        config: config of the adapter.
        context: the world.
        catalogue: what is offered.
        refusals: counts what is refused.
        playback: playback of a recording.
        scene: time, ns, and bytes of the newest scene; None before the first.
    """

    config: FoxgloveConfig
    context: AdapterContext
    catalogue: Catalogue
    refusals: Refusals
    playback: Playback
    scene: tuple[int, bytes] | None

    def follow(self) -> None:
        """Follow a change of the clients' subscriptions."""


class Client:
    """The client of one connection. Loop thread.

    Args:
        server: the adapter.
        name: name of the peer, for the world.
        outbox: takes what is sent to it.
        origin: origin of a page that may only watch; None for a client that may command.

    Attributes:
        subscriptions: number of a channel -> numbers of the client's subscriptions to it.
        outbox: as given.
    """

    def __init__(self, server: Server, name: str, outbox: Outbox, origin: str | None = None) -> None:
        self.subscriptions: dict[int, list[int]] = {}
        self.outbox = outbox
        self._server, self._origin = server, origin
        self._channel_of: dict[int, int] = {}
        self._publishes: dict[int, str] = {}
        self._rate = RateMeter(server.config.max_requests_per_s)
        self._asked = Conversation(server.context, name, InFlightLimit(server.config.max_unanswered))
        self._loop = asyncio.get_running_loop()

    def close(self) -> None:
        """End the calls and subscriptions of the client, which has gone."""
        self._asked.close()
        self.subscriptions.clear()

    def hear(self, message: str | bytes) -> float:
        """Carry out a message of the client. A wrong message changes nothing, and the client is told once.

        Returns:
            Wall time for which the client should not be read, s: 0 unless it sends too much.
        """
        now = self._loop.time()
        self._rate.take(now)
        try:
            if isinstance(message, bytes):
                self._binary(codec.read_binary(message))
            else:
                self._text(codec.read_text(message))
        except BadMessage as error:
            self._server.context.stats.errors += 1
            self.complain(f"Invalid message: {error}")
        except Refused as refused:
            self.complain(refused.fault.text)
        if not self._rate.is_flooded(now):
            return 0.0
        self._server.refusals.note("flood", "a client asks more than max_requests_per_s")
        self.complain(f"more than {self._rate.most} requests a second: the others wait (max_requests_per_s)")
        return self._rate.end - now

    def complain(self, *faults: str) -> None:
        """Show the first fault to the person at the client, and how many more there are in the message; nothing without faults."""
        for text in faults[:1]:
            others = f" (and {len(faults) - 1} more of this message)" if len(faults) > 1 else ""
            self.outbox.put(codec.status(_ERROR, text[:_TEXT_LIMIT] + others), is_text=True)

    def tell(self, **message: Any) -> None:
        """Send a text message."""
        self.outbox.put(codec.encode(message), is_text=True)

    def show(self, channel: int, t_ns: int, payload: bytes) -> None:
        """Send a message of a channel once for each subscription to it."""
        for subscription in self.subscriptions.get(channel, ()):
            self.outbox.put(codec.data(subscription, t_ns, payload), is_sample=True)

    # -- texts ------------------------------------------------------------------------------------------------------------------------

    def _text(self, message: dict[str, Any]) -> None:
        operations: Mapping[str, Callable[[dict[str, Any]], None]] = {
            "subscribe": self._subscribe,
            "unsubscribe": self._unsubscribe,
            "advertise": self._advertise,
            "unadvertise": self._unadvertise,
            "getParameters": self._get_parameters,
            "setParameters": self._set_parameters,
            "subscribeParameterUpdates": self._watch,
            "unsubscribeParameterUpdates": self._watch,
        }
        if message["op"] not in operations:
            raise BadMessage(f'no "op" is "{message["op"][:100]}"; there are: {", ".join(operations)}')
        operations[message["op"]](message)

    def _entries(self, message: Mapping[str, Any], key: str, kind: type) -> list[Any]:
        """Return a list of a message, and count it as requests.

        Raises:
            BadMessage: there is no such list, or it is too long.
        """
        found, most = message.get(key), self._server.config.max_subscriptions
        if not isinstance(found, list) or not all(isinstance(entry, kind) for entry in found):
            raise BadMessage(f'"{message["op"]}" needs a list "{key}"')
        if len(found) > most:
            raise BadMessage(f'"{key}" has {len(found)} entries: at most {most} a message (max_subscriptions)')
        self._rate.take(self._loop.time(), len(found) // _ENTRIES_OF_A_REQUEST)
        return found

    def _subscribe(self, message: dict[str, Any]) -> None:
        entries = self._entries(message, "subscriptions", dict)
        faults = [self._add_subscription(_number(entry, "id"), _number(entry, "channelId")) for entry in entries]
        self.complain(*filter(None, faults))
        self._server.follow()

    def _add_subscription(self, number: int, channel: int) -> str:
        """Add a subscription, or return why it cannot be added; else ""."""
        catalogue, most = self._server.catalogue, self._server.config.max_subscriptions
        if channel not in catalogue.channels:
            return f"there is no channel {channel}"
        if number in self._channel_of:
            return f"subscription {number} is there already"
        if len(self._channel_of) >= most:
            return f"at most {most} subscriptions (max_subscriptions)"
        if len(self.subscriptions.get(channel, ())) >= _SUBSCRIPTIONS_OF_A_CHANNEL:
            times = f"{_SUBSCRIPTIONS_OF_A_CHANNEL} times already"
            return f"channel {channel} is subscribed {times}: unsubscribe one of these"
        self._channel_of[number] = channel
        self.subscriptions.setdefault(channel, []).append(number)
        if channel == catalogue.numbers.get(SCENE) and self._server.scene is not None:
            self.outbox.put(codec.data(number, *self._server.scene))
        return ""

    def _unsubscribe(self, message: dict[str, Any]) -> None:
        faults: list[str] = []
        for number in self._entries(message, "subscriptionIds", int):
            channel = self._channel_of.pop(number, None)
            if channel is None:
                faults.append(f"there is no subscription {number}"[:_TEXT_LIMIT])
                continue
            self.subscriptions[channel].remove(number)
            if not self.subscriptions[channel]:
                del self.subscriptions[channel]
        self.complain(*faults)
        self._server.follow()

    def forget(self, channels: Collection[int]) -> None:
        """End the subscriptions to channels that have gone."""
        for channel in channels:
            for number in self.subscriptions.pop(channel, ()):
                del self._channel_of[number]

    def _advertise(self, message: dict[str, Any]) -> None:
        self._may_change()
        for entry in self._entries(message, "channels", dict):
            topic, encoding = entry.get("topic"), entry.get("encoding")
            if not isinstance(topic, str) or encoding != "json":
                raise BadMessage('a channel needs a "topic", and "json" as its encoding')
            path, ports = topic.removeprefix("/"), self._server.context.ports
            if path not in ports or ports[path].direction != "actuator":
                actuators = [p for p, port in ports.items() if port.direction == "actuator"]
                raise BadMessage(f'"{path[:200]}" is no actuator port{did_you_mean(path, actuators)}')
            if len(self._publishes) >= self._server.config.max_subscriptions:
                raise BadMessage(f"at most {self._server.config.max_subscriptions} channels (max_subscriptions)")
            self._publishes[_number(entry, "id")] = path

    def _unadvertise(self, message: dict[str, Any]) -> None:
        for number in self._entries(message, "channelIds", int):
            self._publishes.pop(number, None)

    def _may_change(self) -> None:
        """Check that the client may change the world.

        Raises:
            Refused: it may not.
        """
        self._may_steer()
        if self._origin is not None:
            text = f"pages and programs of {self._origin} may only watch: name that origin in allowed_origins of the adapter's table"
            raise Refused("denied", text)

    def _may_steer(self) -> None:
        """Check that the client may play, pause and seek a recording, which changes no world.

        Raises:
            Refused: it may not.
        """
        if self._server.config.read_only:
            raise Refused("denied", "this server may only be watched: read_only is set in its table")

    # -- binary -----------------------------------------------------------------------------------------------------------------------

    def _binary(self, message: ClientData | ServiceCall | PlaybackControl) -> None:
        if isinstance(message, ClientData):
            self._command(message)
        elif isinstance(message, ServiceCall):
            self._call(message)
        else:
            self._control(message)

    def _command(self, message: ClientData) -> None:
        port = self._publishes.get(message.channel)
        if port is None:
            raise BadMessage(f"channel {message.channel} was not advertised")
        self._may_change()
        told = codec.read_object(message.payload)
        value = told["value"] if set(told) == {"value"} and isinstance(told["value"], dict) else told
        self._asked.command(port, value, self._report)

    def _report(self, reply: Reply) -> None:
        if reply.fault is not None:
            self.complain(reply.fault.text)

    def _call(self, message: ServiceCall) -> None:
        def fail(fault: Fault) -> None:
            self.outbox.put(codec.call_failed(message.service, message.call, fault.text[:_TEXT_LIMIT]), is_text=True)

        def answer(reply: Reply) -> None:
            if reply.fault is not None:
                fail(reply.fault)
            else:
                self.outbox.put(codec.response(message.service, message.call, codec.encode(reply.result)))

        service = self._server.catalogue.services.get(message.service)
        try:
            if service is None:
                raise Refused("unknown_service", f"there is no service {message.service}")
            if message.encoding != "json":
                raise Refused("bad_argument", f'arguments come as "json", not as "{message.encoding[:50]}"')
            if not service.reads_only and not service.path.endswith("/get"):
                self._may_change()
            self._asked.call(service.path, codec.read_object(message.payload), answer)
        except BadMessage as error:
            fail(Fault("parse_error", str(error)))
        except Refused as refused:
            fail(refused.fault)

    def _control(self, message: PlaybackControl) -> None:
        services = self._server.context.services
        if "playback/state" not in services:
            raise Refused("denied", "this is a running world: you can seek only in a recording")
        self._may_steer()
        wanted: list[Call] = []
        if math.isfinite(message.speed) and message.speed > 0.0:
            wanted.append(("playback/speed", {"speed": message.speed}))
        if message.seek_ns is not None:
            wanted.append(("playback/seek", {"t_s": codec.seconds(message.seek_ns)}))
        wanted.append(("playback/resume" if message.plays else "playback/pause", {}))

        def finish(replies: Sequence[Reply]) -> None:
            for reply in replies:
                self._report(reply)
            self._server.playback.tell(message.seek_ns is not None, message.request, self.outbox.put)

        self._asked.call_all(wanted, finish)

    # -- parameters -------------------------------------------------------------------------------------------------------------------

    def _get_parameters(self, message: dict[str, Any]) -> None:
        self._answer_parameters(frozenset(self._entries(message, "parameterNames", str)), message.get("id"))

    def _answer_parameters(self, names: frozenset[str], request: object) -> None:
        """Ask each component that has one of these settings, by default all, and send all settings together."""
        known = parameters_of(self._server.context.services)
        wanted = [name for name in known if not names or name in names]
        components = list(dict.fromkeys(known[name][0] for name in wanted))

        def finish(replies: Sequence[Reply]) -> None:
            found = {component: reply.result for component, reply in zip(components, replies, strict=True)}
            told = [
                {"name": name, "value": settings[known[name][1]]}
                for name in wanted
                if isinstance(settings := found.get(known[name][0]), dict) and settings.get(known[name][1]) is not None
            ]
            self.tell(op="parameterValues", parameters=told, **({} if request is None else {"id": request}))

        self._asked.call_all([(f"{component}/get", {}) for component in components], finish)

    def _set_parameters(self, message: dict[str, Any]) -> None:
        self._may_change()
        known = parameters_of(self._server.context.services)
        entries = [e for e in self._entries(message, "parameters", dict) if isinstance(e.get("name"), str)]
        if not entries:
            return
        faults: list[str] = []
        calls: list[Call] = []
        for name, value in ((entry["name"], entry.get("value")) for entry in entries):
            if name in known:
                calls.append((f"{known[name][0]}/set", {known[name][1]: value}))
            else:
                # Only the first unknown name is compared with the known ones, which takes long.
                faults.append(f'no parameter "{name[:200]}"{"" if faults else did_you_mean(name, known)}')
        names = frozenset(entry["name"] for entry in entries if entry["name"] in known)

        def finish(replies: Sequence[Reply]) -> None:
            self.complain(*faults, *(reply.fault.text for reply in replies if reply.fault is not None))
            self._answer_parameters(names or frozenset("-"), message.get("id"))

        self._asked.call_all(calls, finish)

    def _watch(self, message: dict[str, Any]) -> None:
        """Accept a subscription to parameters, which viewers send. Changes of settings are not sent by themselves."""
        self._entries(message, "parameterNames", str)


def _number(entry: Mapping[str, Any], key: str) -> int:
    found = entry.get(key)
    if not isinstance(found, int) or not 0 <= found < 1 << 32:
        raise BadMessage(f'"{key}" must be a number of 32 bits')
    return found
