"""Who takes the samples of a port: each is encoded once an encoding and selection of fields, whatever the number of clients."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from uwserver.adapter import SampleForm
from uwserver.adapter.pictures import picture_place
from uwserver.ports import Port, Sample
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.encoding import Encoding
from uwserver_adapters.native.outbox import Delivery, Outgoing
from uwserver_adapters.native.shares import Share, Subscription

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


class Route:
    """All of one client's subscriptions to the same fields of one port: it gets a sample at most once.

    Attributes:
        outbox, codec: of the client.
        frame: of the codec.
        shares: by subscription.
        only: the one that there is; None where there are more.
    """

    __slots__ = ("codec", "frame", "only", "outbox", "shares")

    def __init__(self, outbox: Outgoing, codec: Codec) -> None:
        self.outbox, self.codec, self.frame = outbox, codec, codec.frame
        self.shares: dict[Subscription, Share] = {}
        self.only: Share | None = None

    def add(self, subscription: Subscription, share: Share) -> None:
        """One subscription more."""
        self.shares[subscription] = share
        self.only = share if len(self.shares) == 1 else None

    def remove(self, subscription: Subscription) -> None:
        """One less."""
        self.shares.pop(subscription).end()
        self.only = next(iter(self.shares.values())) if len(self.shares) == 1 else None

    def delivery(self, t_ns: int) -> Delivery | None:
        """The strongest delivery that is due; None when none is."""
        share = self.only
        if share is not None:
            return share.subscription.delivery if share.passes(t_ns) else None
        due = [share.subscription.delivery for share in self.shares.values() if share.passes(t_ns)]
        return max(due, key=_STRENGTH.__getitem__, default=None)


class Selection:
    """All clients of one encoding that take the same fields of one port, its pictures in the same form.

    Attributes:
        encoding: of them.
        port: of the samples.
        fields: that they take; None for all.
        routes: by client.
        is_jpeg: they take its pictures, as JPEG.
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
        """How its samples become a map; made with the first, as who subscribes to everything would wait for hundreds of them."""
        if self._form is None:
            self._form = SampleForm(self.port, self.fields)
        return self._form

    def encoded(self, sample: Sample) -> bytes:
        """The message of a sample, without its frame."""
        return self.encoding.sample(self.form, sample)


def distribute(sample: Sample, selection: Selection, touched: set[Outgoing]) -> bool:
    """Queue a sample for all who take it now, which adds to those that were `touched`. Returns whether anybody did: then it was encoded."""
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
