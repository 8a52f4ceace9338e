"""The running world as a ROS graph sees it: topics with subscribers get their messages, each made once. Loop thread."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, TypeVar

from uwserver.adapter import AdapterContext, Conversation, Refusals, within
from uwserver.ports import Buffer, EntityList, Event, Present, Refused, Reply, Sample, SceneState
from uwserver_adapters.ros.messages import (
    CLOCK,
    TF_STATIC,
    Ask,
    BadMessage,
    Catalogue,
    CommandTopic,
    Errand,
    Facts,
    Mount,
    Offer,
    SensorTopic,
    Types,
    Value,
    mounts_of,
)
from uwserver_adapters.ros.messages.plain import plain

log = logging.getLogger(__name__)

_Form = TypeVar("_Form")

SCENE_S = 5.0
"""Wall time to wait for the mounts of sensors; without mounts their frames are those of the vehicle."""


def _size(value: object) -> int:
    """Return about how many bytes a sample's value takes."""
    if isinstance(value, tuple):
        return 64 + sum(map(_size, value))
    if isinstance(value, Buffer):
        return len(value.data)
    return len(value) if isinstance(value, str | bytes) else 16


Failed = Callable[[str, Exception], None]
"""Gets the type of a message that could not be made or encoded, and the error."""


class OutgoingMessage:
    """One outgoing message. Each form that a dialect needs is made when it is first asked for, and kept.

    If a form cannot be made, it is lost: `failed` is called once, and other forms and messages are not affected.

    Args:
        types: message types of the distribution.
        type_name: ``package/msg/Name``.
        failed: gets errors.
        sample: the sample that the message is made of; None where `made` is given.
        sensor_topic: makes the message of the sample.
        made: the message itself.
    """

    def __init__(
        self, types: Types, type_name: str, failed: Failed, sample: Sample | None = None, sensor_topic: SensorTopic | None = None,
        made: object = None,
    ) -> None:  # fmt: skip
        self.type = type_name
        self._types, self._failed, self._sample, self._sensor_topic, self._made = (
            types,
            failed,
            sample,
            sensor_topic,
            made,
        )
        self._encoded: dict[object, bytes | None] = {}

    def encoded(self, form: object, make: Callable[[], bytes | None]) -> bytes | None:
        """Return the bytes that `make` gives, made once for each key `form`; None where it gives none, or fails."""
        if form not in self._encoded:
            self._encoded[form] = self._attempt(make)
        return self._encoded[form]

    @cached_property
    def message(self) -> object | None:
        """The message; None where the sample gives none, or it could not be made."""
        sensor_topic, sample = self._sensor_topic, self._sample
        if sensor_topic is None or sample is None:
            return self._made
        return self._attempt(lambda: sensor_topic.make(sample))

    @property
    def size(self) -> int:
        """About how many bytes it holds."""
        return 64 if self._sample is None else _size(self._sample.value)

    @cached_property
    def raw(self) -> bytes | None:
        """CDR with its encapsulation, or ROS 1 bytes; None where the sample gives no message, or one with numbers that its type cannot hold."""
        return self._attempt(self._raw)

    def _raw(self) -> bytes | None:
        types, sensor_topic, sample = self._types, self._sensor_topic, self._sample
        if sensor_topic is not None and sensor_topic.cdr is not None and sample is not None:
            return sensor_topic.cdr(sample)
        if self.message is None:
            return None
        return types.ros1(self.message) if types.is_ros1 else types.cdr(self.message)

    @cached_property
    def plain(self) -> dict[str, Any] | None:
        """The message as a map, see `uwserver_adapters.ros.messages.plain`."""
        return self._attempt(lambda: None if self.message is None else plain(self._types, self.message))

    def _attempt(self, make: Callable[[], _Form | None]) -> _Form | None:
        try:
            return make()
        except Exception as error:  # noqa: BLE001  # only this message is lost
            self._failed(self.type, error)
            return None


_BEFORE = -1
"""A revision that no scene of a running world has."""
Deliver = Callable[[str, OutgoingMessage], None]
"""Gets a topic that has subscribers, and a message of it."""


class Feed:
    """Makes the messages of all topics that have subscribers. It is the adapter's `Subscriber`.

    Args:
        context: the world.
        refusals: refusals of the adapter; counts messages that could not be made or encoded.
        types: message types of the distribution.
        facts: what the adapter's table says of frames; mounts are added here.
        deliver: gets the messages.
        clock_hz: most messages of ``/clock`` in a second of simulated time.
        changed: called when topics have come or gone.

    Attributes:
        types: as given.
        catalogue: topics and services that exist now; there from `begin` on.
        topics: all topics that are published -> type.
        t_ns: newest simulation time that is known here, ns.
        subscriptions: ports whose samples are needed.
    """

    def __init__(
        self, context: AdapterContext, refusals: Refusals, types: Types, facts: Facts, deliver: Deliver,
        clock_hz: float = 100.0, changed: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        self.types = types
        self.t_ns = 0
        self.topics: Mapping[str, str] = {}
        self._context, self._refusals = context, refusals
        self._facts = facts
        self._deliver = deliver
        self._changed = changed
        self._clock_ns = round(1_000_000_000 / clock_hz)
        self._next_clock = 0
        self._heard: Counter[str] = Counter()
        self._latched: dict[str, OutgoingMessage] = {}
        self._by_port: Mapping[str, Sequence[SensorTopic]] = {}
        self._renewing: asyncio.Task[None] | None = None
        self.subscriptions: Collection[str] = ()
        self.catalogue: Catalogue

    def begin(self) -> None:
        """Make the catalogue before the first tick. The world does not answer yet: its vehicles are those of the scenario."""
        mounts: Mapping[str, Mount] = {}
        entities = EntityList(_BEFORE, tuple(Present(v.name, v.name) for v in self._context.world.vehicles), ())
        try:
            mounts = mounts_of(self._context.scene(entities))
        except KeyError:
            # The adapter was restarted, and a copy was spawned before: only the world knows of which vehicle it is one.
            self._renewing = asyncio.get_running_loop().create_task(self.renew())
        self._take(mounts)

    async def renew(self) -> None:
        """Ask the world for the mounts of sensors, and make the catalogue of the world as it is now."""
        found: asyncio.Future[SceneState] = asyncio.get_running_loop().create_future()

        def seen(state: SceneState) -> None:
            if not found.done():
                found.set_result(state)

        mounts: Mapping[str, Mount] = {}
        try:
            self._context.request_scene_state(seen)
            state = await within(SCENE_S, found, "no answer")
            mounts = mounts_of(self._context.scene(state.entities))
        except (Refused, TimeoutError) as error:
            text = "%s does not know the mounts of sensors (%s): their frames are those of their vehicle"
            log.warning(text, self._context.name, error)
        self._take(mounts)

    def _take(self, mounts: Mapping[str, Mount]) -> None:
        """Make the catalogue of the world as it is now."""
        world = self._context.world
        facts = replace(self._facts, epoch_ns=world.epoch_ns, tick_s=1.0 / world.rate_hz, mounts=mounts)
        self.catalogue = catalogue = Catalogue.of(self.types, facts, self._context)
        topics = {sensor_topic.name: sensor_topic.type for sensor_topic in catalogue.sensor_topics}
        self.topics = {**topics, CLOCK: "rosgraph_msgs/msg/Clock", TF_STATIC: "tf2_msgs/msg/TFMessage"}
        self._latched = {topic: outgoing for topic, outgoing in self._latched.items() if topic in topics}
        static = self.outgoing(self.topics[TF_STATIC], catalogue.tf_static)
        self._latched[TF_STATIC] = static
        self._follow()
        if self._heard[TF_STATIC]:
            self._deliver(TF_STATIC, static)
        self._changed()

    def outgoing(self, type_name: str, made: object) -> OutgoingMessage:
        """Return a message that is not made of a sample."""
        return OutgoingMessage(self.types, type_name, self._failed, made=made)

    def _failed(self, type_name: str, error: Exception) -> None:
        """Count and log a message that could not be made or encoded."""
        text = f"a message of {type_name} could not be made: {type(error).__name__}: {error}"
        self._refusals.note_error("encoding", text)
        log.debug("%s", text, exc_info=error)

    def now_ns(self) -> int:
        """Return simulation time, ns since 1970. The world is asked, as there may be no samples now that would tell it."""
        told: list[Reply] = []
        self._context.call("world/status", {}, self._context.name, told.append)  # type: ignore[arg-type]  # it only reads
        result = told[0].result if told else None
        t_ns = result.get("t_ns") if isinstance(result, dict) else None
        if not isinstance(t_ns, int):
            t_ns = told[0].t_ns if told else self.t_ns
        return self.catalogue.facts.epoch_ns + t_ns

    # -- subscribers ------------------------------------------------------------------------------------------------------------------------

    def is_latched(self, topic: str) -> bool:
        """Return whether late subscribers get the newest message."""
        return topic == TF_STATIC or any(o.name == topic and o.latched for o in self.catalogue.sensor_topics)

    def hear(self, topic: str) -> OutgoingMessage | None:
        """Count one more listener of a topic; return its newest message if late subscribers get it."""
        self._heard[topic] += 1
        if self._heard[topic] == 1:
            self._follow()
        return self._latched.get(topic)

    def leave(self, topic: str) -> None:
        """Count one listener fewer."""
        self._heard[topic] -= 1
        if self._heard[topic] <= 0:
            del self._heard[topic]
            self._follow()

    def _follow(self) -> None:
        """Ask for the samples of the ports that are needed, and of no others."""
        by_port: dict[str, list[SensorTopic]] = {}
        for sensor_topic in self.catalogue.sensor_topics:
            if self._heard[sensor_topic.name]:
                for path in sensor_topic.ports:
                    by_port.setdefault(path, []).append(sensor_topic)
        if self._heard[CLOCK]:
            # The clock advances with samples: it needs those of the fastest sensor.
            sensors = [port for port in self._context.ports.values() if port.direction == "sensor"]
            if sensors:
                fastest = max(sensors, key=lambda port: port.rate_hz or 0.0)
                by_port.setdefault(fastest.path, [])
        self._by_port = by_port
        self.subscriptions = by_port.keys()
        self._context.subscriptions_changed()

    # -- samples and events -----------------------------------------------------------------------------------------------------------------

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Make and deliver the messages of one tick."""
        by_port = self._by_port
        now = max((sample.t_sent_ns for sample in samples), default=self.t_ns)
        self.t_ns = now
        # Time may also jump back.
        if self._heard[CLOCK] and (now >= self._next_clock or now < self._next_clock - 2 * self._clock_ns):
            self._next_clock = now + self._clock_ns
            clock = self.catalogue.clock(now)
            self._deliver(CLOCK, self.outgoing(self.topics[CLOCK], clock))
        for sample in samples:
            for sensor_topic in by_port.get(sample.port, ()):
                outgoing = OutgoingMessage(self.types, sensor_topic.type, self._failed, sample, sensor_topic)
                # A message that combines two ports must see every sample of them, once: so it is made now, heard or not.
                if len(sensor_topic.ports) > 1 and outgoing.message is None:
                    continue
                if sensor_topic.latched:
                    self._latched[sensor_topic.name] = outgoing
                self._deliver(sensor_topic.name, outgoing)

    def put_event(self, event: Event) -> None:
        """Follow a change of ports or of time."""
        if event.event == "ports_changed":
            if self._renewing is not None:
                self._renewing.cancel()
            self._renewing = asyncio.get_running_loop().create_task(self.renew())
        elif event.event == "watchdog":
            self._forget(lambda port: f'"{port}"' in event.text)
        elif event.event == "reset":
            self._forget(lambda _: True)
            self._next_clock = 0
            self._latched = {TF_STATIC: self._latched[TF_STATIC]}

    def _forget(self, is_neutral: Callable[[str], bool]) -> None:
        for command_topic in self.catalogue.command_topics.values():
            if command_topic.held is not None and is_neutral(command_topic.port):
                command_topic.held.forget()

    async def close(self) -> None:
        """End the search for mounts."""
        if self._renewing is not None:
            self._renewing.cancel()
            await asyncio.gather(self._renewing, return_exceptions=True)


def command(
    conversation: Conversation,
    command_topic: CommandTopic,
    value: Value,
    answered: Callable[[Reply], None],
    source: str = "",
) -> None:
    """Send a command that a command topic made of a message, and note in `CommandTopic.held` what thrusters were told.

    Args:
        conversation: conversation of the peer.
        command_topic: the topic.
        value: the command.
        answered: gets the world's answer.
        source: who sent the message; default: the conversation's.

    Raises:
        Refused: see `Conversation.command`.
    """
    held, told = command_topic.held, value.get(command_topic.field)
    if held is None or not isinstance(told, list):
        conversation.command(command_topic.port, value, answered, source=source)
        return

    def judged(reply: Reply) -> None:
        held.judge(told, reply.fault is None)
        answered(reply)

    held.ask(told)
    try:
        conversation.command(command_topic.port, value, judged, source=source)
    except Refused:
        held.judge(told, False)
        raise


Answered = Callable[[object | None, str], None]
"""Gets the response, or None and the reason why there is none."""


def call(conversation: Conversation, offer: Offer, request: Any, answered: Answered) -> None:
    """Carry out a service request.

    Args:
        conversation: conversation of the client.
        offer: the service.
        request: the request message.
        answered: called once, now or later. A fault of the world stands in the response, in the way of its type.
    """
    try:
        asked = offer.ask(request)
        if isinstance(asked, Errand):
            asked.begin(conversation, answered)
            return
    except (BadMessage, Refused) as wrong:
        answered(None, str(wrong))
        return
    if not isinstance(asked, Ask):
        answered(asked, getattr(getattr(asked, "result", None), "error_message", ""))
        return

    def reply(outcome: Reply) -> None:
        answered(offer.answer(outcome.result, outcome.fault), outcome.fault.text if outcome.fault is not None else "")

    try:
        conversation.call(asked.service, asked.args, reply)
    except Refused as refused:
        answered(offer.answer(None, refused.fault), refused.fault.text)
