"""Readers and drivers of adapters that may not serve ground truth."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Protocol

from uwserver.adapter import Driver, Order, Subscriber
from uwserver.ports import Event, Fault, Port, Sample
from uwserver.ports.thinning import WHOLE, Thinned
from uwserver.ports.told import Origin, Told


class Ports(Protocol):
    """What an adapter may see."""

    @property
    def ports(self) -> Mapping[str, Port]:
        """Those that it may serve, by path."""


class WithoutTruth:
    """Keeps ground truth from an adapter that may not serve it.

    Attributes:
        put_told: as that of the subscriber; None where it has none.
    """

    def __init__(self, subscriber: Subscriber, context: Ports) -> None:
        """subscriber: of the adapter; context: what it may see."""
        self._subscriber, self._context = subscriber, context
        self._put_told: Callable[[Told], None] | None = getattr(subscriber, "put_told", None)
        self.put_told = None if self._put_told is None else self._put_visible
        self._origins: Mapping[int, Origin] = {}
        self._true: frozenset[int] = frozenset()

    @property
    def wanted(self) -> Collection[str]:
        """What it wants, of what it may see."""
        return _visible_of(self._subscriber, self._context)

    @property
    def thinned(self) -> Thinned:
        """What is enough for it."""
        return getattr(self._subscriber, "thinned", WHOLE)

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Pass on those that it may see."""
        visible = _without_truth(samples)
        if visible:
            self._subscriber.put_samples(visible)

    def _put_visible(self, told: Told) -> None:
        if told.origins is not self._origins:
            self._origins = told.origins
            self._true = frozenset(k for k, origin in told.origins.items() if "/truth/" in origin.path)
        if self._put_told is not None and self._true.isdisjoint(told.streams):
            self._put_told(told)
        else:
            self.put_samples(told)

    def send_samples(self) -> None:
        """No more wait."""
        send: Callable[[], None] | None = getattr(self._subscriber, "send_samples", None)
        if send is not None:
            send()

    def put_event(self, event: Event) -> None:
        """Pass on an event."""
        self._subscriber.put_event(event)


class DriverWithoutTruth:
    """The same for a driver."""

    def __init__(self, driver: Driver, context: Ports) -> None:
        """driver: of the adapter; context: what it may see."""
        self._driver, self._context = driver, context

    @property
    def wanted(self) -> Collection[str]:
        """What it wants, of what it may see."""
        return _visible_of(self._driver, self._context)

    def order(self, wait_s: float) -> Order | None:
        """As that of the driver; here and below."""
        return self._driver.order(wait_s)

    def see(self, t_ns: int, samples: Sequence[Sample]) -> None:
        """Pass on those that it may see."""
        self._driver.see(t_ns, _without_truth(samples))

    def answer(self, t_ns: int) -> None:
        """See `Driver`."""
        self._driver.answer(t_ns)

    def refuse(self, fault: Fault) -> None:
        """See `Driver`."""
        self._driver.refuse(fault)


def _visible_of(reader: Subscriber | Driver, context: Ports) -> Collection[str]:
    """What it wants; of who wants all, all that it may see."""
    wanted: Collection[str] | None = getattr(reader, "wanted", None)
    return context.ports.keys() if wanted is None else [path for path in wanted if "/truth/" not in path]


def _without_truth(samples: Sequence[Sample]) -> list[Sample]:
    return [sample for sample in samples if "/truth/" not in sample.port]
