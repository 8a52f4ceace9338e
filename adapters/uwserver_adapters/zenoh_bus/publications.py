"""Samples, events and liveliness tokens on the network. Each sample is encoded once for all subscribers, and not at all without one."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from zenoh import (
    CongestionControl,
    LivelinessToken,
    Locality,
    MatchingStatus,
    Priority,
    Publisher,
    Session,
    SourceInfo,
)

from uwserver.adapter import AdapterContext, SampleForm, Worker
from uwserver.adapter.pictures import can_encode_jpeg, picture_place
from uwserver.ports import Event, Port, Sample
from uwserver_adapters.zenoh_bus.codec import Codec
from uwserver_adapters.zenoh_bus.keys import KeyScheme
from uwserver_adapters.zenoh_session.session import Lane, direct

log = logging.getLogger(__name__)

JPEG = "image/jpeg"


class _Outlet:
    """Publishes the samples of one sensor; for an actuator it only holds the token.

    Args:
        port: the port.
        publisher: None for an actuator.
        token: announces the port; None where another outlet does.
        lane: sends the payloads.
        changed: called on a zenoh thread when the first subscriber comes or the last one goes.
    """

    __slots__ = ("changed", "form", "is_heard", "lane", "listener", "number", "port", "publisher", "token")

    def __init__(
        self, port: Port, publisher: Publisher | None, token: LivelinessToken | None, lane: Lane, changed: Callable[[], None]
    ) -> None:  # fmt: skip
        self.port, self.publisher, self.token, self.lane, self.changed = port, publisher, token, lane, changed
        self.form = SampleForm(port)
        self.number = 0
        self.is_heard = False
        if publisher is not None:
            self.listener = publisher.declare_matching_listener(direct(self._matches))
            self.refresh_matching()

    def close(self) -> None:
        if self.token is not None:
            self.token.undeclare()
        if self.publisher is not None:
            self.publisher.undeclare()

    def _matches(self, status: MatchingStatus) -> None:
        """Note whether somebody subscribes now. Called on a zenoh thread."""
        self.is_heard = status.matching
        self.changed()

    def refresh_matching(self) -> None:
        """Ask whether somebody subscribes. A "no" is ignored: the listener may have said "yes" meanwhile."""
        if self.publisher is not None:
            status: Any = self.publisher.matching_status  # zenoh's stub says bool, but it is a MatchingStatus
            if status.matching:
                self.is_heard = True

    def next_number(self) -> None:
        """Count a message that goes out: subscribers notice missing numbers."""
        self.number = (self.number + 1) & 0xFFFFFFFF


class Publications:
    """The adapter's `Subscriber`. Loop thread.

    Args:
        context: the world.
        session: the session, which is open.
        keys: keys of this server.
        codec: codec of samples and events.
        sender: a thread for what may block.

    Attributes:
        subscriptions: ports to which somebody subscribes.
    """

    def __init__(
        self, context: AdapterContext, session: Session, keys: KeyScheme, codec: Codec, sender: Worker
    ) -> None:
        self._context, self._session, self._keys, self._codec, self._sender = context, session, keys, codec, sender
        self._outlets: dict[str, _Outlet] = {}
        self._jpegs: dict[str, _Outlet] = {}
        self._vehicles: dict[str, LivelinessToken] = {}
        self._loop = asyncio.get_running_loop()
        self._is_following = False
        self.subscriptions: frozenset[str] = frozenset()

    def open(self) -> None:
        """Declare publishers and tokens of all ports that exist now, and take back those of ports that have gone."""
        liveliness = self._session.liveliness()
        ports = self._context.ports
        for outlets in (self._outlets, self._jpegs):
            for path, outlet in list(outlets.items()):
                if ports.get(path) != outlet.port:
                    outlet.close()
                    del outlets[path]
        for path, port in ports.items():
            if path not in self._outlets:
                token = liveliness.declare_token(self._keys.alive(path))
                self._outlets[path] = self._outlet(port, self._keys.of(path), self._codec.media, token)
            if path not in self._jpegs and picture_place(port) is not None and can_encode_jpeg():
                self._jpegs[path] = self._outlet(port, self._keys.jpeg(path), JPEG, None)
        vehicles = {path.split("/")[0] for path in ports}
        for name in self._vehicles.keys() - vehicles:
            self._vehicles.pop(name).undeclare()
        for name in vehicles - self._vehicles.keys():
            self._vehicles[name] = liveliness.declare_token(self._keys.alive(name))
        self._follow()

    def refresh_matching(self) -> None:
        """Find subscribers of which zenoh has not told yet: it tells its listeners a little after it knows."""
        for outlet in (*self._outlets.values(), *self._jpegs.values()):
            if not outlet.is_heard:
                outlet.refresh_matching()
        self._follow()

    def _changed(self) -> None:
        """Let the loop follow, once for many changes. Called on a zenoh thread."""
        if not self._is_following:
            self._is_following = True
            with contextlib.suppress(RuntimeError):  # the server has ended
                self._loop.call_soon_threadsafe(self._follow)

    def _follow(self) -> None:
        self._is_following = False  # before it asks, so that a change during it is followed again
        outlets = (*self._outlets.items(), *self._jpegs.items())
        subscriptions = frozenset(path for path, outlet in outlets if outlet.is_heard)
        if subscriptions != self.subscriptions:
            self.subscriptions = subscriptions
            self._context.subscriptions_changed()

    def _outlet(self, port: Port, key: str, media: str, token: LivelinessToken | None) -> _Outlet:
        publisher = None
        if port.direction == "sensor":
            publisher = self._session.declare_publisher(
                key,
                encoding=media,
                congestion_control=CongestionControl.DROP,
                priority=Priority.DATA,
                allowed_destination=Locality.REMOTE,  # else our own subscriber for commands would count as one
            )
        return _Outlet(port, publisher, token, Lane(self._sender, self._context.stats), self._changed)

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Publish the samples to which somebody subscribes. zenoh drops them for a peer that is too slow."""
        stats = self._context.stats
        for sample in samples:
            picture = self._jpegs.get(sample.port) if self._jpegs else None
            if picture is not None and picture.is_heard and sample.valid:
                self._put_picture(picture, sample)
            outlet = self._outlets.get(sample.port)
            if outlet is None or outlet.publisher is None or not outlet.is_heard:
                continue
            try:
                payload, media, attachment = self._codec.sample(outlet.form, sample)
                stats.encoded += 1
                if not self._put(outlet, outlet.publisher, payload, media, attachment):
                    continue
            except Exception as error:  # a fault of ours, or of a closing session, must not end the adapter
                stats.count_error(f"a sample of {sample.port} could not be sent: {error}")
                log.debug("%s", stats.last_error, exc_info=True)
                continue
            stats.samples_sent += 1
            stats.bytes_sent += len(payload)

    def _put(self, outlet: _Outlet, publisher: Publisher, payload: bytes, media: str, attachment: bytes) -> bool:
        """Number a sample and send it; return whether it is not dropped here."""
        numbered = SourceInfo(publisher.id, outlet.number)
        encoding = None if media == self._codec.media else media  # None: that of the publisher
        put = partial(publisher.put, payload, encoding=encoding, attachment=attachment, source_info=numbered)
        is_put = outlet.lane.put(len(payload), put)
        if is_put:
            outlet.next_number()
        return is_put

    def _put_picture(self, outlet: _Outlet, sample: Sample) -> None:
        """Encode and send a picture on the sender's thread, one at a time."""
        publisher, stats, number = outlet.publisher, self._context.stats, outlet.number
        assert publisher is not None

        def work() -> None:
            found = self._codec.picture(outlet.port, sample)
            if found is not None:
                publisher.put(found[0], attachment=found[1], source_info=SourceInfo(publisher.id, number))
                stats.encoded += 1
                stats.samples_sent += 1
                stats.bytes_sent += len(found[0])

        if outlet.lane.put_aside(work):
            outlet.next_number()

    def put_event(self, event: Event) -> None:
        """Tell everybody; follow a change of ports."""
        if event.event == "ports_changed":
            self.open()
        self.tell(self._keys.event, event)

    def tell(self, key: str, message: object) -> None:
        """Publish a message that must not be lost, ahead of samples."""
        payload = self._codec.encode(message)
        self._sender.send(
            lambda: self._session.put(
                key,
                payload,
                encoding=self._codec.media,
                congestion_control=CongestionControl.BLOCK,
                priority=Priority.INTERACTIVE_HIGH,
                express=True,
            )
        )
