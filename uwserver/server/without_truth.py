"""Subscribers and drivers of adapters that may not serve ground truth."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

from uwserver.adapter import AdapterContext, Driver, Subscriber
from uwserver.ports import Sample
from uwserver.ports.decimation import EVERY_SAMPLE, Decimations
from uwserver.ports.sample_batch import Origin, SampleBatch


class WithoutTruth:
    """Keeps ground truth from a subscriber of an adapter that may not serve it.

    Attributes:
        put_batch, send_samples: as those of the subscriber; None if it has none.
        put_event: that of the subscriber.
    """

    def __init__(self, subscriber: Subscriber, context: AdapterContext) -> None:
        """Take a subscriber of an adapter, and the context that says what the adapter may see."""
        self._subscriber, self._context = subscriber, context
        self._put_batch: Callable[[SampleBatch], None] | None = getattr(subscriber, "put_batch", None)
        self.put_batch = None if self._put_batch is None else self._put_visible
        self.send_samples: Callable[[], None] | None = getattr(subscriber, "send_samples", None)
        self.put_event = subscriber.put_event
        self._origins: Mapping[int, Origin] = {}
        self._truth_streams: frozenset[int] = frozenset()

    @property
    def subscriptions(self) -> Collection[str]:
        """The subscriptions, without truth."""
        return _visible_of(self._subscriber, self._context)

    @property
    def decimations(self) -> Decimations:
        """The decimations of the subscriber."""
        return getattr(self._subscriber, "decimations", EVERY_SAMPLE)

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Pass on the samples that are no truth."""
        visible = _without_truth(samples)
        if visible:
            self._subscriber.put_samples(visible)

    def _put_visible(self, batch: SampleBatch) -> None:
        if batch.origins is not self._origins:
            self._origins = batch.origins
            self._truth_streams = frozenset(k for k, origin in batch.origins.items() if "/truth/" in origin.path)
        if self._put_batch is not None and self._truth_streams.isdisjoint(batch.streams):
            self._put_batch(batch)
        else:
            self.put_samples(batch)


class DriverWithoutTruth:
    """Keeps ground truth from a driver of an adapter that may not serve it."""

    def __init__(self, driver: Driver, context: AdapterContext) -> None:
        """Take a driver of an adapter, and the context that says what the adapter may see."""
        self._driver, self._context = driver, context
        self.order, self.answer, self.refuse = driver.order, driver.answer, driver.refuse

    @property
    def subscriptions(self) -> Collection[str]:
        """The subscriptions, without truth."""
        return _visible_of(self._driver, self._context)

    def see(self, t_ns: int, samples: Sequence[Sample]) -> None:
        """Pass on the samples that are no truth."""
        self._driver.see(t_ns, _without_truth(samples))


def _visible_of(reader: Subscriber | Driver, context: AdapterContext) -> Collection[str]:
    """Return the subscriptions of a reader without truth. A reader that subscribes to everything gets everything that it may see."""
    subscriptions: Collection[str] | None = getattr(reader, "subscriptions", None)
    return context.ports.keys() if subscriptions is None else [path for path in subscriptions if "/truth/" not in path]


def _without_truth(samples: Sequence[Sample]) -> list[Sample]:
    return [sample for sample in samples if "/truth/" not in sample.port]
