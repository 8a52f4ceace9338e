"""Samples to clients: who gets what, encoded once an encoding and selection of fields, whatever the number of clients."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Protocol

import msgspec

from uwserver.adapter import AdapterContext, InOrder, SampleForm, Thinned
from uwserver.adapter.pictures import picture_place, with_jpeg
from uwserver.ports import Event, Json, Port, Sample, matching
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.encoding import Encoding
from uwserver_adapters.native.outbox import Delivery, Outgoing
from uwserver_adapters.native.shares import Share, Subscription, Taken

log = logging.getLogger(__name__)

CACHED_PATTERNS = 64
"""Patterns whose ports or description are remembered; they are the clients' choice, so they are bounded."""
COVERED = 2048
"""Ports that all subscriptions of a client may cover together, each counted for each subscription, but where there are many ports twice as
many: each sample is compared with all subscriptions that cover its port."""
SETTLING = 16
"""Ticks with samples after which the world is told what is enough, so that it is told of many subscriptions at once."""
_STRENGTH: Mapping[Delivery, int] = {"latest": 0, "ring": 1, "reliable": 2}


class Subscriber(Protocol):
    """A client, as its routes know it.

    Attributes:
        codec: what it speaks.
        outbox: where its samples wait.
        subscriptions: by serial.
    """

    codec: Codec
    outbox: Outgoing
    subscriptions: dict[int, Subscription]


class _Route:
    """All of one client's subscriptions to the same fields of one port: it gets a sample at most once."""

    __slots__ = ("_only", "frame", "outbox", "shares")

    def __init__(self, outbox: Outgoing, frame: Callable[[bytes], bytes]) -> None:
        self.outbox = outbox
        self.frame = frame
        self.shares: dict[Subscription, Share] = {}
        self._only: Share | None = None

    def add(self, subscription: Subscription, share: Share) -> None:
        """One subscription more."""
        self.shares[subscription] = share
        self._only = share if len(self.shares) == 1 else None

    def remove(self, subscription: Subscription) -> None:
        """One less."""
        self.shares.pop(subscription).end()
        self._only = next(iter(self.shares.values())) if len(self.shares) == 1 else None

    def delivery(self, t_ns: int) -> Delivery | None:
        """The strongest delivery that is due; None when none is."""
        share = self._only
        if share is not None:
            return share.subscription.delivery if share.passes(t_ns) else None
        due = [share.subscription.delivery for share in self.shares.values() if share.passes(t_ns)]
        return max(due, key=_STRENGTH.__getitem__, default=None)


class _Selection:
    """All clients of one encoding that take the same fields of one port, its pictures in the same form."""

    __slots__ = ("_fields", "_form", "_is_jpeg", "_port", "encoding", "has_picture", "routes")

    def __init__(self, encoding: Encoding, port: Port, fields: tuple[str, ...] | None, is_jpeg: bool) -> None:
        self.encoding = encoding
        self.routes: dict[Subscriber, _Route] = {}
        self._port = port
        self._fields = fields
        self._is_jpeg = is_jpeg
        self.has_picture = picture_place(port) is not None
        self._form: SampleForm | None = None

    @property
    def form(self) -> SampleForm:
        """How its samples become a map; made with the first, as who subscribes to everything would wait for hundreds of them."""
        if self._form is None:
            self._form = SampleForm(self._port, self._fields)
        return self._form

    def encoded(self, sample: Sample) -> bytes:
        """The message of a sample, without its frame."""
        return self.encoding.sample(self.form, self.with_jpeg(sample) if self._is_jpeg else sample)

    @property
    def takes_long(self) -> bool:
        """Whether its samples are encoded beside the loop: JPEG takes as long as hundreds of other samples."""
        return self._is_jpeg and self.has_picture and all(route.outbox.has_places for route in self.routes.values())

    def with_jpeg(self, sample: Sample) -> Sample:
        """With a JPEG for its picture. Any thread."""
        return with_jpeg(self._port, sample)


_Key = tuple[str, tuple[str, ...] | None, bool]


class Fanout:
    """The adapter's `Subscriber`: holds the routes of all admitted clients.

    Attributes:
        context: the server.
        sessions: admitted clients.
    """

    def __init__(self, context: AdapterContext) -> None:
        self.context = context
        self.sessions: dict[Subscriber, None] = {}
        self._ports: dict[str, dict[_Key, _Selection]] = {}
        self._taken: dict[str, Taken] = {}
        self._touched: set[Outgoing] = set()
        self._settling = 0
        self._covered: dict[str, tuple[str, ...]] = {}
        self._described: dict[tuple[str, str], msgspec.Raw] = {}
        self._jpegs: InOrder[Sample] | None = None

    async def close(self) -> None:
        """End the thread that encodes pictures."""
        jpegs, self._jpegs = self._jpegs, None
        if jpegs is not None:
            await jpegs.close()

    # -- clients --------------------------------------------------------------------------------------------------------------------

    def admit(self, session: Subscriber) -> None:
        """A client may take part."""
        self.sessions[session] = None

    def dismiss(self, session: Subscriber) -> None:
        """A client is gone."""
        self.sessions.pop(session, None)
        for subscription in session.subscriptions.values():
            self._remove(session, subscription)
        self.context.follow_wants()

    @property
    def wanted(self) -> Collection[str]:
        """Ports that anybody subscribes to."""
        return self._ports.keys()

    @property
    def thinned(self) -> Thinned:
        """Those of which nobody takes all samples."""
        self._settling = 0
        thinned = {path: taken.thinnings for path, taken in self._taken.items()}
        return {path: thinnings for path, thinnings in thinned.items() if thinnings}

    def _settle(self) -> None:
        self._settling = self._settling or SETTLING

    def add(self, session: Subscriber, subscription: Subscription) -> None:
        """Route the samples of a subscription; sets its paths."""
        self._add(session, subscription)
        self.context.follow_wants()

    def _add(self, session: Subscriber, subscription: Subscription) -> None:
        subscription.paths = self._served(subscription)
        key = (session.codec.encoding.name, subscription.fields, subscription.is_jpeg)
        for path in subscription.paths:
            selections = self._ports.setdefault(path, {})
            selection = selections.get(key)
            if selection is None:
                port = self.context.ports[path]
                selection = selections[key] = _Selection(session.codec.encoding, port, *key[1:])
            route = selection.routes.get(session)
            if route is None:
                route = selection.routes[session] = _Route(session.outbox, session.codec.frame)
            taken = self._taken.get(path)
            if taken is None:
                taken = self._taken[path] = Taken(self._settle)
            route.add(subscription, Share(subscription, taken))

    def remove(self, session: Subscriber, subscription: Subscription) -> None:
        """End what `add` began."""
        self._remove(session, subscription)
        self.context.follow_wants()

    def _remove(self, session: Subscriber, subscription: Subscription) -> None:
        key = (session.codec.encoding.name, subscription.fields, subscription.is_jpeg)
        for path in subscription.paths:
            selections = self._ports[path]
            routes = selections[key].routes
            route = routes[session]
            route.remove(subscription)
            if not route.shares:
                del routes[session]
            if not routes:
                del selections[key]
            if not selections:
                del self._ports[path], self._taken[path]
        subscription.paths = ()

    # -- ports ----------------------------------------------------------------------------------------------------------------------

    def covered(self, pattern: str) -> tuple[str, ...]:
        """Sensors that fit a pattern."""
        paths = self._covered.get(pattern)
        if paths is None:
            ports = self.context.ports
            paths = tuple(path for path in matching(pattern, ports) if ports[path].direction == "sensor")
            if len(self._covered) >= CACHED_PATTERNS:
                self._covered.clear()
            self._covered[pattern] = paths
        return paths

    def _served(self, subscription: Subscription) -> tuple[str, ...]:
        paths = self.covered(subscription.pattern)
        if subscription.fields is None:
            return paths
        return tuple(path for path in paths if has_any(self.context.ports[path], subscription.fields))

    def most_covered(self) -> int:
        """See `COVERED`."""
        return max(COVERED, 2 * len(self.context.ports))

    def described(self, pattern: str, codec: Codec) -> msgspec.Raw:
        """The encoded result of `describe`; it is large, and the same until the ports change."""
        key = (pattern, codec.encoding.name)
        raw = self._described.get(key)
        if raw is None:
            result: dict[str, Json] = self.context.describe(pattern)
            raw = codec.raw(result)
            if len(self._described) >= CACHED_PATTERNS:
                self._described.clear()
            self._described[key] = raw
        return raw

    def _ports_changed(self) -> None:
        self._covered.clear()
        self._described.clear()
        held = [(session, subscription) for session in self.sessions for subscription in session.subscriptions.values()]
        # All are removed before the first is added: a port may have come back with other fields.
        for session, subscription in held:
            self._remove(session, subscription)
        for session, subscription in held:
            self._add(session, subscription)

    # -- what the world says --------------------------------------------------------------------------------------------------------

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Queue the samples of one tick; `send_samples` follows."""
        touched: set[Outgoing] = set()
        for sample in samples:
            selections = self._ports.get(sample.port)
            if selections is None:
                continue
            for selection in selections.values():
                try:
                    distribute = self._distribute_later if selection.takes_long else _distribute
                    self.context.stats.encoded += distribute(sample, selection, touched)
                except Exception:  # a fault of ours must not end the adapter
                    self.context.stats.errors += 1
                    log.exception("a sample of %s could not be sent", sample.port)
        for outbox in touched:
            outbox.gather()
        self._touched |= touched
        if self._settling:
            self._settling -= 1
            if not self._settling:
                self.context.follow_wants()

    def _distribute_later(self, sample: Sample, selection: _Selection, touched: set[Outgoing]) -> bool:
        """As `_distribute`, but each client's place is kept until the picture is encoded."""
        jpegs = self._jpegs = self._jpegs or InOrder(f"{self.context.name} pictures", self.context.stats)
        places: list[tuple[Callable[[bytes], bytes], Callable[[bytes | None], None]]] = []
        for route in selection.routes.values():
            delivery = route.delivery(sample.t_ns)
            if delivery is not None:
                places.append((route.frame, route.outbox.put_later(selection, delivery, jpegs.hurry)))
                touched.add(route.outbox)

        def done(encoded: Sample | None) -> None:
            body = None
            try:
                body = None if encoded is None else selection.encoding.sample(selection.form, encoded)
            except Exception:  # a fault of ours must not end the adapter, nor leave a place empty
                self.context.stats.errors += 1
                log.exception("a sample of %s could not be sent", sample.port)
            messages: dict[Callable[[bytes], bytes], bytes] = {}
            for frame, fill in places:
                if body is not None and frame not in messages:
                    messages[frame] = frame(body)
                fill(messages.get(frame))

        if places:
            jpegs.put(partial(selection.with_jpeg, sample), done)
        return bool(places)

    def send_samples(self) -> None:
        """Write the samples of some ticks, once a client."""
        touched, self._touched = self._touched, set()
        for outbox in touched:
            outbox.flush()

    def put_event(self, event: Event) -> None:
        """Tell every admitted client."""
        if event.event == "ports_changed":
            self._ports_changed()
        if event.event == "reset":
            self._restart_rates()
        messages: dict[tuple[str, Callable[[bytes], bytes]], bytes] = {}
        for session in self.sessions:
            codec = session.codec
            key = (codec.encoding.name, codec.frame)
            if key not in messages:
                messages[key] = codec.event(event)
            session.outbox.put_reply(messages[key])
            session.outbox.flush()

    def _restart_rates(self) -> None:
        for selections in self._ports.values():
            for selection in selections.values():
                for route in selection.routes.values():
                    for share in route.shares.values():
                        share.restart()


def _distribute(sample: Sample, selection: _Selection, touched: set[Outgoing]) -> bool:
    """Whether it was encoded: it was for anybody's turn."""
    if len(selection.routes) == 1:
        (route,) = selection.routes.values()
        delivery = route.delivery(sample.t_ns)
        if delivery is None:
            return False
        message = route.frame(selection.encoded(sample))
        route.outbox.put_sample(selection, message, delivery)
        touched.add(route.outbox)
        return True
    body: bytes | None = None
    messages: dict[Callable[[bytes], bytes], bytes] = {}  # by framing
    # No route goes away meanwhile: a connection that overflows here is dismissed later, when its transport is gone.
    for route in selection.routes.values():
        delivery = route.delivery(sample.t_ns)
        if delivery is None:
            continue
        framed = messages.get(route.frame)
        if framed is None:
            if body is None:
                body = selection.encoded(sample)
            framed = messages[route.frame] = route.frame(body)
        route.outbox.put_sample(selection, framed, delivery)
        touched.add(route.outbox)
    return body is not None


def has_any(port: Port, fields: Sequence[str]) -> bool:
    """Whether a port has one of the fields."""
    return any(field.name in fields for field in port.fields)
