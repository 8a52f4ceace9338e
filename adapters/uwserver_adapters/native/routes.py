"""The way of a sample to the clients that take it. It is encoded once for each encoding and selection of fields, however many clients there are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from uwserver.adapter import SampleForm
from uwserver.adapter.pictures import picture_place
from uwserver.ports import Port, Sample
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.messages import Encoding, encoded_sample
from uwserver_adapters.native.outbox import Delivery, Outgoing
from uwserver_adapters.native.shares import Share, Subscription

_STRENGTH: Mapping[Delivery, int] = {"latest": 0, "ring": 1, "reliable": 2}


class Subscriber(Protocol):
    """A client, as far as its routes know it.

    Attributes:
        codec: encodes and frames its messages.
        outbox: where its samples wait.
        subscriptions: its subscriptions, by serial number.
    """

    codec: Codec
    outbox: Outgoing
    subscriptions: dict[int, Subscription]


class Route:
    """All subscriptions of one client to the same fields of one port. The client gets a sample at most once.

    Attributes:
        outbox, codec: those of the client.
        frame: the frame of the codec.
        shares: a share for each subscription.
        only: the only share; None if there are several.
    """

    __slots__ = ("codec", "frame", "only", "outbox", "shares")

    def __init__(self, outbox: Outgoing, codec: Codec) -> None:
        self.outbox, self.codec, self.frame = outbox, codec, codec.frame
        self.shares: dict[Subscription, Share] = {}
        self.only: Share | None = None

    def add(self, subscription: Subscription, share: Share) -> None:
        """Add a subscription."""
        self.shares[subscription] = share
        self.only = share if len(self.shares) == 1 else None

    def remove(self, subscription: Subscription) -> None:
        """Remove a subscription."""
        self.shares.pop(subscription).end()
        self.only = next(iter(self.shares.values())) if len(self.shares) == 1 else None

    def delivery(self, t_ns: int) -> Delivery | None:
        """Return the strongest delivery of the subscriptions that take this sample; None if none takes it."""
        share = self.only
        if share is not None:
            return share.subscription.delivery if share.passes(t_ns) else None
        # Each share is asked, because it counts its intervals.
        due = [share.subscription.delivery for share in self.shares.values() if share.passes(t_ns)]
        return max(due, key=_STRENGTH.__getitem__, default=None)


class Selection:
    """All clients with one encoding that take the same fields of one port, and its pictures in the same form.

    Attributes:
        encoding: the encoding.
        port: the port.
        fields: names of the fields; None for all.
        routes: a route for each client.
        is_jpeg: whether pictures are among the fields, and are sent as JPEG.
    """

    __slots__ = ("_form", "encoding", "fields", "is_jpeg", "port", "routes")

    def __init__(self, encoding: Encoding, port: Port, fields: tuple[str, ...] | None, is_jpeg: bool) -> None:
        self.encoding = encoding
        self.routes: dict[Subscriber, Route] = {}
        self.port = port
        self.fields = fields
        place = picture_place(port) if is_jpeg else None
        self.is_jpeg = place is not None and (fields is None or port.fields[place].name in fields)
        self._form: SampleForm | None = None

    @property
    def form(self) -> SampleForm:
        """Turns a sample into a map. It is made with the first sample: a client that subscribes to all ports would wait for hundreds of them."""
        if self._form is None:
            self._form = SampleForm(self.port, self.fields)
        return self._form

    def encoded(self, sample: Sample) -> bytes:
        """Return the message of a sample, without its frame."""
        return encoded_sample(self.encoding, self.form, sample)


def distribute(sample: Sample, selection: Selection, touched: set[Outgoing]) -> bool:
    """Queue a sample for all clients that take it now, and add their outboxes to `touched`.

    Returns:
        Whether any client takes it, so that it was encoded.
    """
    body: bytes | None = None
    messages: dict[Callable[[bytes], bytes], bytes] = {}  # by frame
    # No route goes away during the loop: a connection that overflows here is dismissed later, when its transport has gone.
    for route in selection.routes.values():
        delivery = route.delivery(sample.t_ns)
        if delivery is None:
            continue
        framed = messages.get(route.frame)
        if framed is None:
            body = body or selection.encoded(sample)
            framed = messages[route.frame] = route.frame(body)
        route.outbox.put_sample(selection, framed, delivery)
        touched.add(route.outbox)
    return body is not None
