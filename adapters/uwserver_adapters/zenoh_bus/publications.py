"""Samples, events and liveliness tokens: what the world says, each encoded once whatever the number of subscribers, never for none."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from uwserver.adapter import AdapterContext, SampleForm, Worker
from uwserver.adapter.pictures import can_encode_jpeg, picture_place
from uwserver.ports import Event, Port, Sample
from uwserver_adapters.zenoh_bus.codec import Codec
from uwserver_adapters.zenoh_bus.keys import KeyScheme
from uwserver_adapters.zenoh_session.session import LARGE_BYTES, direct

if TYPE_CHECKING:
    from zenoh import LivelinessToken, MatchingStatus, Publisher, Session

log = logging.getLogger(__name__)

JPEG = "image/jpeg"


class _Outlet:
    """One sensor's way out."""

    __slots__ = (
        "changed",
        "form",
        "is_busy",
        "is_heard",
        "is_large",
        "listener",
        "number",
        "port",
        "publisher",
        "token",
    )

    def __init__(
        self, port: Port, publisher: Publisher | None, token: LivelinessToken | None, changed: Callable[[], None]
    ) -> None:
        self.port = port
        self.form = SampleForm(port)
        self.publisher = publisher
        self.token = token
        self.changed = changed
        self.number = 0
        self.is_large = False
        self.is_busy = False
        self.is_heard = False
        if publisher is not None:
            self.listener = publisher.declare_matching_listener(direct(self._matches))
            self.look()

    def close(self) -> None:
        """Its port is gone."""
        if self.token is not None:
            self.token.undeclare()
        if self.publisher is not None:
            self.publisher.undeclare()

    def _matches(self, status: MatchingStatus) -> None:
        """Somebody subscribes, or nobody any more. A zenoh thread."""
        self.is_heard = status.matching
        self.changed()

    def look(self) -> None:
        """Ask whether somebody subscribes. Never unlearns what the listener says meanwhile."""
        if self.publisher is not None:
            status: Any = self.publisher.matching_status  # zenoh's stub says bool, it is a MatchingStatus
            if status.matching:
                self.is_heard = True


class Publications:
    """The adapter's `Subscriber`. Loop thread.

    Attributes:
        wanted: ports that anybody subscribes to.
    """

    def __init__(
        self, context: AdapterContext, session: Session, keys: KeyScheme, codec: Codec, sender: Worker
    ) -> None:
        self._context = context
        self._session = session
        self._keys = keys
        self._codec = codec
        self._sender = sender
        self._outlets: dict[str, _Outlet] = {}
        self._jpegs: dict[str, _Outlet] = {}
        self._vehicles: dict[str, LivelinessToken] = {}
        self._loop = asyncio.get_running_loop()
        self._is_following = False
        self.wanted: frozenset[str] = frozenset()

    def open(self) -> None:
        """Declare publishers and tokens of all ports; again after they changed."""
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
                self._outlets[path] = _Outlet(port, self._publisher(port), token, self._changed)
            if path not in self._jpegs and picture_place(port) is not None and can_encode_jpeg():
                self._jpegs[path] = _Outlet(port, self._publisher(port, JPEG), None, self._changed)
        vehicles = {path.split("/")[0] for path in ports}
        for name in self._vehicles.keys() - vehicles:
            self._vehicles.pop(name).undeclare()
        for name in vehicles - self._vehicles.keys():
            self._vehicles[name] = liveliness.declare_token(self._keys.alive(name))
        self._follow()

    def look(self) -> None:
        """Find subscribers of whom zenoh has not said anything yet: its listeners are told a little later than its tables."""
        for outlet in (*self._outlets.values(), *self._jpegs.values()):
            if not outlet.is_heard:
                outlet.look()
        self._follow()

    def _changed(self) -> None:
        """Let the loop follow, once for many. A zenoh thread."""
        if not self._is_following:
            self._is_following = True
            with contextlib.suppress(RuntimeError):  # the server has ended
                self._loop.call_soon_threadsafe(self._follow)

    def _follow(self) -> None:
        self._is_following = False  # before the look: what changes during it is followed again
        outlets = (*self._outlets.items(), *self._jpegs.items())
        wanted = frozenset(path for path, outlet in outlets if outlet.is_heard)
        if wanted != self.wanted:
            self.wanted = wanted
            self._context.follow_wants()

    def _publisher(self, port: Port, media: str = "") -> Publisher | None:
        from zenoh import CongestionControl, Locality, Priority

        if port.direction != "sensor":
            return None
        return self._session.declare_publisher(
            self._keys.jpeg(port.path) if media == JPEG else self._keys.of(port.path),
            encoding=media or self._codec.media,
            congestion_control=CongestionControl.DROP,
            priority=Priority.DATA,
            allowed_destination=Locality.REMOTE,  # else our own subscriber for commands would count as one
        )

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Give each sample that anybody subscribes to to zenoh, which drops it for a peer that is too slow."""
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
                stats.errors += 1
                stats.last_error = f"a sample of {sample.port} could not be sent: {error}"
                log.debug("%s", stats.last_error, exc_info=True)
                continue
            stats.samples_sent += 1
            stats.bytes_sent += len(payload)

    def _put(self, outlet: _Outlet, publisher: Publisher, payload: bytes, media: str, attachment: bytes) -> bool:
        """Number it, and put it; whether it went out."""
        from zenoh import SourceInfo

        numbered = SourceInfo(publisher.id, outlet.number)
        encoding = None if media == self._codec.media else media  # the publisher has that of all others
        put = partial(publisher.put, payload, encoding=encoding, attachment=attachment, source_info=numbered)
        if len(payload) > LARGE_BYTES or outlet.is_large:
            outlet.is_large = True  # from now on always, so that samples do not overtake each other
            if not self._put_large(outlet, put):
                return False
        else:
            put()
        outlet.number = (outlet.number + 1) & 0xFFFFFFFF
        return True

    def _put_picture(self, outlet: _Outlet, sample: Sample) -> None:
        """Encode and put it on the thread, one at a time."""
        from zenoh import SourceInfo

        publisher, stats = outlet.publisher, self._context.stats
        assert publisher is not None
        number = outlet.number

        def work() -> None:
            found = self._codec.picture(outlet.port, sample)
            if found is not None:
                publisher.put(found[0], attachment=found[1], source_info=SourceInfo(publisher.id, number))
                stats.encoded += 1
                stats.samples_sent += 1
                stats.bytes_sent += len(found[0])

        if self._put_large(outlet, work):
            outlet.number = (number + 1) & 0xFFFFFFFF

    def _put_large(self, outlet: _Outlet, put: Callable[[], object]) -> bool:
        if outlet.is_busy:
            self._context.stats.dropped += 1
            return False

        def work() -> None:
            try:
                put()
            finally:
                outlet.is_busy = False

        outlet.is_busy = True  # before it can be done
        if not self._sender.send(work):
            outlet.is_busy = False
            return False
        return True

    def put_event(self, event: Event) -> None:
        """Tell everybody; renew the ports if it says that they changed."""
        if event.event == "ports_changed":
            self.open()
        self.tell(self._keys.event, event)

    def tell(self, key: str, message: object) -> None:
        """Publish a message that is not lost, ahead of samples."""
        from zenoh import CongestionControl, Priority

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
