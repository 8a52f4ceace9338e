"""Samples to clients: who gets what, encoded once an encoding and selection of fields, whatever the number of clients."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence

import msgspec

from uwserver.adapter import AdapterContext, Thinned, Told
from uwserver.ports import Event, Json, Port, Sample, matching
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.jpegs import Jpegs
from uwserver_adapters.native.outbox import Outgoing
from uwserver_adapters.native.routes import Route, Selection, Subscriber, distribute
from uwserver_adapters.native.shares import Share, Subscription, Taken
from uwserver_adapters.native.together import Together

log = logging.getLogger(__name__)

CACHED_PATTERNS = 64
"""Patterns whose ports or description are remembered; they are the clients' choice, so they are bounded."""
COVERED = 2048
"""Ports that all subscriptions of a client may cover together, each counted for each subscription, but where there are many ports twice as
many: each sample is compared with all subscriptions that cover its port."""
TOGETHER = 512
"""Samples that are encoded in one go. Those that compiled code writes keep nobody waiting, others the simulation, for less than a millisecond."""
SETTLING = 16
"""Ticks with samples after which the world is told what is enough, so that it is told of many subscriptions at once."""


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
        self._ports: dict[str, dict[_Key, Selection]] = {}
        self._taken: dict[str, Taken] = {}
        self._touched: set[Outgoing] = set()
        self._settling = 0
        self._covered: dict[str, tuple[str, ...]] = {}
        self._described: dict[tuple[str, str], msgspec.Raw] = {}
        self._together = Together(lambda path: self._ports.get(path, {}), context.stats)
        self._jpegs = Jpegs(context)

    async def close(self) -> None:
        """End the thread that encodes pictures."""
        await self._jpegs.close()

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
        self._together.forget()
        subscription.paths = self._served(subscription)
        key = (session.codec.encoding.name, subscription.fields, subscription.is_jpeg)
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
                taken = self._taken[path] = Taken(self._settle)
            route.add(subscription, Share(subscription, taken))

    def remove(self, session: Subscriber, subscription: Subscription) -> None:
        """End what `add` began."""
        self._remove(session, subscription)
        self.context.follow_wants()

    def _remove(self, session: Subscriber, subscription: Subscription) -> None:
        self._together.forget()
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
        self._put(samples)
        self._follow_settling(1)

    def _put(self, samples: Sequence[Sample]) -> None:
        touched: set[Outgoing] = set()
        for sample in samples:
            selections = self._ports.get(sample.port)
            if selections is None:
                continue
            pictures: list[Selection] = []
            for selection in selections.values():
                if selection.is_jpeg:
                    pictures.append(selection)
                    continue
                try:
                    self.context.stats.encoded += distribute(sample, selection, touched)
                except Exception:  # a fault of ours must not end the adapter
                    self.context.stats.errors += 1
                    log.exception("a sample of %s could not be sent", sample.port)
            if pictures:
                self.context.stats.encoded += self._jpegs.distribute(sample, pictures, touched)
        for outbox in touched:
            outbox.gather()
        self._touched |= touched

    def put_told(self, told: Told) -> None:
        """The same of those of some ticks that follow each other; `send_samples` follows."""
        for part in told.parts(TOGETHER):
            outboxes = self._together.send(part)
            if outboxes is None:
                self._put(part)
            else:
                self._touched.update(outboxes)
        self._follow_settling(told.ticks)

    def _follow_settling(self, ticks: int) -> None:
        if self._settling:
            self._settling = max(0, self._settling - ticks)
            if not self._settling:
                self.context.follow_wants()

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


def has_any(port: Port, fields: Sequence[str]) -> bool:
    """Whether a port has one of the fields."""
    return any(field.name in fields for field in port.fields)
