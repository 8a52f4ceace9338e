"""The world as a ROS graph sees it, while it runs: topics that somebody hears get their messages, each made once. Loop thread."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, TypeVar

from uwserver.adapter import AdapterContext, Conversation, Refusals
from uwserver.ports import Buffer, Cast, Event, Present, Refused, Reply, Sample, SceneState
from uwserver_adapters.ros.messages.catalogue import CLOCK, TF_STATIC, Catalogue
from uwserver_adapters.ros.messages.commands import Inlet, Value
from uwserver_adapters.ros.messages.plain import plain
from uwserver_adapters.ros.messages.services import Ask, Errand, Offer
from uwserver_adapters.ros.messages.source import Facts, Outlet, mounts_of
from uwserver_adapters.ros.messages.types import BadMessage, Types

log = logging.getLogger(__name__)

_Form = TypeVar("_Form")

SCENE_S = 5.0
"""Wall time to wait for where sensors sit; without it their frames are those of the vehicle."""


def _size(value: object) -> int:
    """About, bytes of a sample's value."""
    if isinstance(value, tuple):
        return 64 + sum(map(_size, value))
    if isinstance(value, Buffer):
        return len(value.data)
    return len(value) if isinstance(value, str | bytes) else 16


Failed = Callable[[str, Exception], None]
"""Told which type could not be made or encoded, and why."""


class Told:
    """One message on its way out: what each dialect needs of it is made when the first asks.

    A fault of what makes or encodes it costs this message in that form, and nothing else: it is told once, to `failed`.

    Args:
        types: of the distribution.
        type_name: ``package/msg/Name``.
        failed: see there.
        sample: of which it is made; None where `made` is given.
        outlet: that makes it.
        made: the message.
    """

    def __init__(
        self, types: Types, type_name: str, failed: Failed, sample: Sample | None = None, outlet: Outlet | None = None,
        made: object = None,
    ) -> None:  # fmt: skip
        self.type = type_name
        self._types, self._failed, self._sample, self._outlet, self._made = types, failed, sample, outlet, made
        self._encoded: dict[object, bytes | None] = {}

    def encoded(self, form: object, make: Callable[[], bytes | None]) -> bytes | None:
        """A form that a dialect keeps, by a key of its own; None where `make` gives none, or fails."""
        if form not in self._encoded:
            self._encoded[form] = self._attempt(make)
        return self._encoded[form]

    @cached_property
    def message(self) -> object | None:
        """The message; None where the sample gives none."""
        outlet, sample = self._outlet, self._sample
        if outlet is None or sample is None:
            return self._made
        return self._attempt(lambda: outlet.make(sample))

    @property
    def size(self) -> int:
        """About, bytes that it holds."""
        return 64 if self._sample is None else _size(self._sample.value)

    @cached_property
    def raw(self) -> bytes | None:
        """CDR with its encapsulation, or ROS 1 bytes. None where the sample gives no message, or one with numbers that its type cannot hold."""
        return self._attempt(self._raw)

    def _raw(self) -> bytes | None:
        types, outlet, sample = self._types, self._outlet, self._sample
        if outlet is not None and outlet.cdr is not None and sample is not None:
            return outlet.cdr(sample)
        if self.message is None:
            return None
        return types.ros1(self.message) if types.is_ros1 else types.cdr(self.message)

    @cached_property
    def plain(self) -> dict[str, Any] | None:
        """A map, as `uwserver_adapters.ros.messages.plain` makes it."""
        return self._attempt(lambda: None if self.message is None else plain(self._types, self.message))

    def _attempt(self, make: Callable[[], _Form | None]) -> _Form | None:
        try:
            return make()
        except Exception as error:  # noqa: BLE001  # one message of one sensor: all others go on
            self._failed(self.type, error)
            return None


_BEFORE = -1
"""Revision of a scene that no world has."""
Deliver = Callable[[str, Told], None]
"""Gets a topic and a message of it, for which somebody asked."""


class Feed:
    """The adapter's `Subscriber`.

    Args:
        context: the world.
        refusals: of the adapter: counts messages that could not be made or encoded.
        types: of the distribution.
        facts: what the adapter's table says of frames; mounts are found here.
        deliver: gets messages.
        clock_hz: of ``/clock``, in simulated time, at most.
        changed: told when topics have come or gone.

    Attributes:
        types: as given.
        catalogue: what there is now.
        topics: all topics that are told -> type.
        t_ns: newest simulation time that was heard of.
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
        self._latched: dict[str, Told] = {}
        self._by_port: Mapping[str, Sequence[Outlet]] = {}
        self._renewing: asyncio.Task[None] | None = None
        self.wanted: Collection[str] = ()
        self.catalogue = Catalogue.of(types, self._with_time(facts), context)

    def _with_time(self, facts: Facts) -> Facts:
        world = self._context.world
        return replace(facts, epoch_ns=world.epoch_ns, tick_s=1.0 / world.rate_hz)

    def begin(self) -> None:
        """Make the catalogue of the world before its first tick, when nobody says yet who is in it: those of the scenario, each like itself."""
        facts = self._with_time(self._facts)
        cast = Cast(_BEFORE, tuple(Present(v.name, v.name) for v in self._context.world.vehicles), ())
        try:
            facts = replace(facts, mounts=mounts_of(self._context.scene(cast)))
        except KeyError:  # the adapter starts again, and a copy was spawned meanwhile: the world says of what
            self._renewing = asyncio.get_running_loop().create_task(self.renew())
        self._take(Catalogue.of(self.types, facts, self._context))

    async def renew(self) -> None:
        """Look where sensors sit, and make the catalogue of the world as it is now."""
        found: asyncio.Future[SceneState] = asyncio.get_running_loop().create_future()

        def seen(state: SceneState) -> None:
            if not found.done():
                found.set_result(state)

        facts = self._with_time(self._facts)
        try:
            self._context.look(seen)
            # `wait_for` would lose a cancellation that comes together with the answer.
            await asyncio.wait({found}, timeout=SCENE_S)
        except Refused as refused:
            log.warning("%s asks in vain where sensors sit: %s", self._context.name, refused.fault.text)
        if found.done():
            facts = replace(facts, mounts=mounts_of(self._context.scene(found.result().cast)))
        else:
            found.cancel()
            log.warning(
                "%s does not know where sensors sit: their frames are those of their vehicle", self._context.name
            )
        self._take(Catalogue.of(self.types, facts, self._context))

    def _take(self, catalogue: Catalogue) -> None:
        self.catalogue = catalogue
        topics = {outlet.topic: outlet.type for outlet in catalogue.outlets}
        self.topics = {**topics, CLOCK: "rosgraph_msgs/msg/Clock", TF_STATIC: "tf2_msgs/msg/TFMessage"}
        self._latched = {topic: told for topic, told in self._latched.items() if topic in topics}
        static = self.telling(self.topics[TF_STATIC], catalogue.tf_static)
        self._latched[TF_STATIC] = static
        self._follow()
        if self._heard[TF_STATIC]:
            self._deliver(TF_STATIC, static)
        self._changed()

    def telling(self, type_name: str, made: object) -> Told:
        """A message that is no sample's."""
        return Told(self.types, type_name, self._failed, made=made)

    def _failed(self, type_name: str, error: Exception) -> None:
        """A message could not be made or encoded: it is lost, and no other."""
        stats = self._context.stats
        stats.errors += 1
        stats.last_error = f"a message of {type_name} could not be made: {type(error).__name__}: {error}"
        self._refusals.note("encoding", stats.last_error)
        log.debug("%s", stats.last_error, exc_info=error)

    def now_ns(self) -> int:
        """Simulation time since 1970, asked of the world: nobody may hear of a sensor now."""
        told: list[Reply] = []
        self._context.call("world/status", {}, self._context.name, told.append)  # type: ignore[arg-type]  # it only reads
        result = told[0].result if told else None
        t_ns = result.get("t_ns") if isinstance(result, dict) else None
        if not isinstance(t_ns, int):
            t_ns = told[0].t_ns if told else self.t_ns
        return self.catalogue.facts.epoch_ns + t_ns

    # -- who hears what ---------------------------------------------------------------------------------------------------------------------

    def is_latched(self, topic: str) -> bool:
        """Whether late comers get the newest message."""
        return topic == TF_STATIC or any(o.topic == topic and o.latched for o in self.catalogue.outlets)

    def hear(self, topic: str) -> Told | None:
        """One more listener of a topic. Gives what was said last, where that is for late comers too."""
        self._heard[topic] += 1
        if self._heard[topic] == 1:
            self._follow()
        return self._latched.get(topic)

    def leave(self, topic: str) -> None:
        """One fewer."""
        self._heard[topic] -= 1
        if self._heard[topic] <= 0:
            del self._heard[topic]
            self._follow()

    def _follow(self) -> None:
        """Ask for the samples of those ports, and of no others."""
        by_port: dict[str, list[Outlet]] = {}
        for outlet in self.catalogue.outlets:
            if self._heard[outlet.topic]:
                for path in outlet.ports:
                    by_port.setdefault(path, []).append(outlet)
        if self._heard[CLOCK]:
            sensors = [port for port in self._context.ports.values() if port.direction == "sensor"]
            if sensors:
                fastest = max(sensors, key=lambda port: port.rate_hz or 0.0)
                by_port.setdefault(fastest.path, [])
        self._by_port = by_port
        self.wanted = by_port.keys()
        self._context.follow_wants()

    # -- what the world says ----------------------------------------------------------------------------------------------------------------

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Samples of one tick."""
        by_port = self._by_port
        now = max((sample.t_sent_ns for sample in samples), default=self.t_ns)
        self.t_ns = now
        if self._heard[CLOCK] and (now >= self._next_clock or now < self._next_clock - 2 * self._clock_ns):
            self._next_clock = now + self._clock_ns
            clock = self.catalogue.clock(now)
            self._deliver(CLOCK, self.telling(self.topics[CLOCK], clock))
        for sample in samples:
            for outlet in by_port.get(sample.port, ()):
                told = Told(self.types, outlet.type, self._failed, sample, outlet)
                # A message of two ports must see each sample, and once.
                if len(outlet.ports) > 1 and told.message is None:
                    continue
                if outlet.latched:
                    self._latched[outlet.topic] = told
                self._deliver(outlet.topic, told)

    def put_event(self, event: Event) -> None:
        """Other ports, or another time."""
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
        for inlet in self.catalogue.inlets.values():
            if inlet.held is not None and is_neutral(inlet.port):
                inlet.held.forget()

    async def close(self) -> None:
        """Nothing is looked for any more."""
        if self._renewing is not None:
            self._renewing.cancel()
            await asyncio.gather(self._renewing, return_exceptions=True)


def command(
    conversation: Conversation, inlet: Inlet, value: Value, answered: Callable[[Reply], None], source: str = ""
) -> None:
    """Command an actuator with what an inlet made of a message; what thrusters hold is what the world accepts.

    Raises:
        Refused: see `Conversation.command`.
    """
    held, told = inlet.held, value.get(inlet.field)

    def judged(reply: Reply) -> None:
        if held is not None and isinstance(told, list):
            held.judge(told, reply.fault is None)
        answered(reply)

    if held is not None and isinstance(told, list):
        held.ask(told)
    try:
        conversation.command(inlet.port, value, judged, source=source)
    except Refused:
        if held is not None and isinstance(told, list):
            held.judge(told, False)
        raise


Answered = Callable[[object | None, str], None]
"""Gets the response, or None and why there is none."""


def call(conversation: Conversation, offer: Offer, request: Any, answered: Answered) -> None:
    """Carry out a service request; `answered` is called once, now or later. A fault of the world is in the response, as its type has it."""
    try:
        asked = offer.ask(request)
    except BadMessage as bad:
        answered(None, str(bad))
        return
    if isinstance(asked, Errand):
        try:
            asked.begin(conversation, answered)
        except (BadMessage, Refused) as wrong:
            answered(None, wrong.fault.text if isinstance(wrong, Refused) else str(wrong))
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
