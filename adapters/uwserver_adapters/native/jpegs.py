"""Pictures as JPEG: each is encoded once, whatever the number of clients and of their selections of fields.

It is done on a thread, as it takes as long as hundreds of other samples; a datagram does not wait for it.
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
    """The JPEG of a `Fanout`.

    Args:
        context: of the adapter.
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
        """Queue a sample of one port for those who take its picture, which adds to those that were `touched`. Returns for how many selections
        it is encoded."""
        later = [s for s in selections if all(route.outbox.has_places for route in s.routes.values())]
        try:
            count = self._distribute_later(sample, later, touched)
            at_once: Sample | None = None
            for selection in selections:
                if selection not in later:
                    at_once = at_once or with_jpeg(selection.port, sample)
                    count += distribute(at_once, selection, touched)
        except Exception:  # a fault of ours must not end the adapter
            self._stats.errors += 1
            log.exception("a picture of %s could not be sent", sample.port)
            return 0
        return count

    def _distribute_later(self, sample: Sample, selections: Sequence[Selection], touched: set[Outgoing]) -> int:
        """As `routes.distribute`, but each client's place is kept until the picture is encoded."""
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
        for selection, kept in places:
            body = None
            try:
                body = None if sample is None else selection.encoded(sample)
            except Exception:  # a fault of ours must not end the adapter, nor leave a place empty
                self._stats.errors += 1
                log.exception("a sample of %s could not be sent", selection.port.path)
            messages: dict[_Frame, bytes] = {}
            for frame, fill in kept:
                if body is not None and frame not in messages:
                    messages[frame] = frame(body)
                fill(messages.get(frame))
