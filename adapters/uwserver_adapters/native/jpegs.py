"""Pictures as JPEG. Each is encoded once, however many clients and selections of fields there are.

A thread encodes them, because it takes as long as hundreds of other samples. For a datagram, which cannot wait, a picture is encoded at once.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import partial

from uwserver.adapter import AdapterContext, InOrder
from uwserver.adapter.pictures import with_jpeg
from uwserver.ports import Sample
from uwserver_adapters.native.outbox import Outgoing
from uwserver_adapters.native.routes import Selection, distribute

log = logging.getLogger(__name__)
_Frame = Callable[[bytes], bytes]
_Fill = Callable[[bytes | None], None]


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
