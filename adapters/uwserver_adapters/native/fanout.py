"""Sends samples and events to clients. A message is encoded once for each encoding and selection of fields, however many clients there are.

A thread encodes pictures as JPEG, because it takes as long as hundreds of other samples. For a datagram, which cannot wait, a picture is encoded at
once.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from functools import lru_cache, partial

import msgspec

from uwserver.adapter import AdapterContext, Decimations, InOrder, SampleBatch
from uwserver.adapter.pictures import with_jpeg
from uwserver.ports import Event, Port, Sample, matching
from uwserver_adapters.native.messages import Encoding, Notice
from uwserver_adapters.native.outbox import Outgoing
from uwserver_adapters.native.routes import Route, Selection, Subscriber, distribute
from uwserver_adapters.native.shares import Share, Subscription, Taken
from uwserver_adapters.native.together import Together

log = logging.getLogger(__name__)
_Frame = Callable[[bytes], bytes]
_Fill = Callable[[bytes | None], None]


CACHED_PATTERNS = 64
"""Patterns whose ports or description are remembered. They are bounded because clients choose them."""
COVERED = 2048
"""Ports that all subscriptions of a client may cover together, each counted for each subscription. If there are many ports, it is twice their
number. There is a limit because each sample is compared with all subscriptions that cover its port."""
TOGETHER = 512
"""Samples that are encoded in one go, which takes less than a millisecond."""
UPDATE_TICKS = 16
"""Ticks with samples before the world is told what is enough, so that it is told of many new subscriptions at once."""
_Key = tuple[str, tuple[str, ...] | None, bool]


class Jpegs:
    """Sends the pictures of a `Fanout` as JPEG.

    Args:
        context: the context of the adapter.
    """

    def __init__(self, context: AdapterContext) -> None:
        self._context, self._stats = context, context.stats
        self._thread: InOrder[Sample] | None = None

    async def close(self) -> None:
        """End the thread."""
        thread, self._thread = self._thread, None
        if thread is not None:
            await thread.close()

    def distribute(self, sample: Sample, selections: Sequence[Selection], touched: set[Outgoing]) -> int:
        """Queue a sample for the clients that take its picture, and add their outboxes to `touched`.

        Args:
            sample: a sample of one port.
            selections: selections of this port with the picture.
            touched: outboxes that have to be flushed.

        Returns:
            For how many selections it is encoded.
        """
        later = [s for s in selections if all(route.outbox.can_put_later for route in s.routes.values())]
        try:
            count = self._distribute_later(sample, later, touched)
            at_once: Sample | None = None
            for selection in selections:
                if selection not in later:
                    at_once = at_once or with_jpeg(selection.port, sample)
                    count += distribute(at_once, selection, touched)
        except Exception:
            # A fault of ours must not end the adapter.
            self._stats.errors += 1
            log.exception("a picture of %s could not be sent", sample.port)
            return 0
        return count

    def _distribute_later(self, sample: Sample, selections: Sequence[Selection], touched: set[Outgoing]) -> int:
        """Do the same as `routes.distribute`, but only keep a place in each outbox until the picture is encoded."""
        places: list[tuple[Selection, list[tuple[_Frame, _Fill]]]] = []
        for selection in selections:
            due = [(r, d) for r in selection.routes.values() if (d := r.delivery(sample.t_ns)) is not None]
            if due:
                thread = self._thread = self._thread or InOrder(f"{self._context.name} pictures", self._stats)
                kept = [(route.frame, route.outbox.put_later(selection, how, thread.hurry)) for route, how in due]
                places.append((selection, kept))
                touched.update(route.outbox for route, _ in due)
        if places and self._thread is not None:
            self._thread.put(partial(with_jpeg, selections[0].port, sample), partial(self._fill, places))
        return len(places)

    def _fill(self, places: Sequence[tuple[Selection, Sequence[tuple[_Frame, _Fill]]]], sample: Sample | None) -> None:
        """Fill all places of a picture; without a sample, which could not be encoded, they stay empty."""
        for selection, kept in places:
            body = None
            try:
                body = None if sample is None else selection.encoded(sample)
            except Exception:
                # A fault of ours must not end the adapter, and every place must be filled or given up.
                self._stats.errors += 1
                log.exception("a sample of %s could not be sent", selection.port.path)
            messages: dict[_Frame, bytes] = {}
            for frame, fill in kept:
                if body is not None and frame not in messages:
                    messages[frame] = frame(body)
                fill(messages.get(frame))


class Fanout:
    """The adapter's `Subscriber`: it holds the routes of all admitted clients.

    Attributes:
        context: the context of the adapter.
        sessions: the admitted clients.
        covered: returns the paths of the sensors that fit a pattern.
        described: returns the encoded result of `describe` for a pattern in an encoding; it is large, and the same until ports change.
    """

    def __init__(self, context: AdapterContext) -> None:
        self.context = context
        self.sessions: dict[Subscriber, None] = {}
        self.covered = lru_cache(CACHED_PATTERNS)(self._find_covered)
        self.described = lru_cache(CACHED_PATTERNS)(self._describe)
        self._ports: dict[str, dict[_Key, Selection]] = {}
        self._taken: dict[str, Taken] = {}
        self._touched: set[Outgoing] = set()
        self._ticks_to_update = 0
        self._together = Together(lambda path: self._ports.get(path, {}), context.stats)
        self._jpegs = Jpegs(context)

    async def close(self) -> None:
        """End the thread that encodes pictures."""
        await self._jpegs.close()

    # -- clients --------------------------------------------------------------------------------------------------------------------

    def admit(self, session: Subscriber) -> None:
        """Add a client, which gets events from now on."""
        self.sessions[session] = None

    def dismiss(self, session: Subscriber) -> None:
        """Remove a client that has gone."""
        self.sessions.pop(session, None)
        for subscription in session.subscriptions.values():
            self._remove(session, subscription)
        self.context.subscriptions_changed()

    @property
    def subscriptions(self) -> Collection[str]:
        """Paths of the ports to which any client subscribes."""
        return self._ports.keys()

    @property
    def decimations(self) -> Decimations:
        """For each port of which no client takes all samples the decimations that are enough."""
        self._ticks_to_update = 0
        decimations = {path: taken.decimations for path, taken in self._taken.items()}
        return {path: some for path, some in decimations.items() if some}

    def _update_soon(self) -> None:
        """Tell the world soon that less is enough."""
        self._ticks_to_update = self._ticks_to_update or UPDATE_TICKS

    def add(self, session: Subscriber, subscription: Subscription) -> None:
        """Route the samples of a subscription to a client, and set the paths of the subscription."""
        self._add(session, subscription)
        self.context.subscriptions_changed()

    def _add(self, session: Subscriber, subscription: Subscription) -> None:
        self._together.forget()
        subscription.paths = self._served(subscription)
        key = _key(session, subscription)
        for path in subscription.paths:
            selections = self._ports.setdefault(path, {})
            selection = selections.get(key)
            if selection is None:
                port = self.context.ports[path]
                selection = selections[key] = Selection(session.codec.encoding, port, *key[1:])
            route = selection.routes.get(session)
            if route is None:
                route = selection.routes[session] = Route(session.outbox, session.codec)
            taken = self._taken.get(path)
            if taken is None:
                taken = self._taken[path] = Taken(self._update_soon)
            route.add(subscription, Share(subscription, taken))

    def remove(self, session: Subscriber, subscription: Subscription) -> None:
        """End a subscription."""
        self._remove(session, subscription)
        self.context.subscriptions_changed()

    def _remove(self, session: Subscriber, subscription: Subscription) -> None:
        self._together.forget()
        key = _key(session, subscription)
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

    def _find_covered(self, pattern: str) -> tuple[str, ...]:
        ports = self.context.ports
        return tuple(path for path in matching(pattern, ports) if ports[path].direction == "sensor")

    def _served(self, subscription: Subscription) -> tuple[str, ...]:
        paths = self.covered(subscription.pattern)
        if subscription.fields is None:
            return paths
        return tuple(path for path in paths if has_any(self.context.ports[path], subscription.fields))

    def most_covered(self) -> int:
        """Return how many ports all subscriptions of a client may cover; see `COVERED`."""
        return max(COVERED, 2 * len(self.context.ports))

    def _describe(self, pattern: str, encoding: Encoding) -> msgspec.Raw:
        return msgspec.Raw(encoding.encode(self.context.describe(pattern)))

    def _ports_changed(self) -> None:
        self.covered.cache_clear()
        self.described.cache_clear()
        held = [(session, subscription) for session in self.sessions for subscription in session.subscriptions.values()]
        # All are removed before the first one is added again, because a port may have come back with other fields.
        for session, subscription in held:
            self._remove(session, subscription)
        for session, subscription in held:
            self._add(session, subscription)

    # -- samples and events -----------------------------------------------------------------------------------------------------------

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Queue the samples of one tick; `send_samples` follows."""
        self._put(samples)
        self._count_down(1)

    def _put(self, samples: Sequence[Sample]) -> None:
        touched: set[Outgoing] = set()
        for sample in samples:
            pictures: list[Selection] = []
            for selection in self._ports.get(sample.port, {}).values():
                if selection.is_jpeg:
                    pictures.append(selection)
                    continue
                try:
                    self.context.stats.encoded += distribute(sample, selection, touched)
                except Exception:
                    # A fault of ours must not end the adapter.
                    self.context.stats.errors += 1
                    log.exception("a sample of %s could not be sent", sample.port)
            if pictures:
                self.context.stats.encoded += self._jpegs.distribute(sample, pictures, touched)
        for outbox in touched:
            outbox.gather()
        self._touched |= touched

    def put_batch(self, batch: SampleBatch) -> None:
        """Queue the samples of some successive ticks; `send_samples` follows."""
        for part in batch.parts(TOGETHER):
            outboxes = self._together.send(part)
            if outboxes is None:
                self._put(part)
            else:
                self._touched.update(outboxes)
        self._count_down(batch.ticks)

    def _count_down(self, ticks: int) -> None:
        if self._ticks_to_update:
            self._ticks_to_update = max(0, self._ticks_to_update - ticks)
            if not self._ticks_to_update:
                self.context.subscriptions_changed()

    def send_samples(self) -> None:
        """Write the samples of some ticks, once for each client."""
        touched, self._touched = self._touched, set()
        for outbox in touched:
            outbox.flush()

    def put_event(self, event: Event) -> None:
        """Send an event to every admitted client."""
        if event.event == "ports_changed":
            self._ports_changed()
        if event.event == "reset":
            self._restart_rates()
        messages: dict[tuple[Encoding, Callable[[bytes], bytes]], bytes] = {}
        for session in self.sessions:
            codec = session.codec
            key = (codec.encoding, codec.frame)
            if key not in messages:
                messages[key] = codec.message(Notice("event", event))
            session.outbox.put_reply(messages[key])
            session.outbox.flush()

    def _restart_rates(self) -> None:
        for selections in self._ports.values():
            for selection in selections.values():
                for route in selection.routes.values():
                    for share in route.shares.values():
                        share.restart()


def _key(session: Subscriber, subscription: Subscription) -> _Key:
    return session.codec.encoding.name, subscription.fields, subscription.is_jpeg


def has_any(port: Port, fields: Sequence[str]) -> bool:
    """Return whether a port has one of the fields."""
    return any(field.name in fields for field in port.fields)
