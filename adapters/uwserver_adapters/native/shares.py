"""How much of a port its subscriptions take: each takes samples at its rate, and the world only makes samples that one of them takes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from uwserver.adapter import NOT_BEGUN, Decimation
from uwserver_adapters.native.outbox import Delivery

MOST_DECIMATIONS = 8
"""Different decimations of a port. With more of them all samples are made, because the world would try each decimation with each sample."""


class Subscription:
    """The arguments of one `subscribe`.

    Attributes:
        serial: number by which the client names it.
        pattern, rate_hz, delivery: as the client gave them.
        fields: names of the fields to send; None for all.
        is_jpeg: whether pictures are sent as JPEG.
        paths: paths of the ports that it covers now.
    """

    def __init__(
        self, serial: int, pattern: str, rate_hz: float | None, fields: tuple[str, ...] | None, delivery: Delivery,
        is_jpeg: bool = False,
    ) -> None:  # fmt: skip
        self.serial = serial
        self.pattern = pattern
        self.rate_hz = rate_hz
        self.fields = fields
        self.delivery = delivery
        self.is_jpeg = is_jpeg
        self.paths: tuple[str, ...] = ()


class Taken:
    """What all subscriptions of a port take together. Each takes the samples of a decimation, or all samples (None).

    Args:
        on_less: called when a subscription begins to take less than all samples.
    """

    def __init__(self, on_less: Callable[[], None]) -> None:
        self._on_less = on_less
        self._counts: Counter[Decimation | None] = Counter()

    def add(self, decimation: Decimation | None) -> None:
        """Count a subscription."""
        self._counts[decimation] += 1
        if decimation is not None:
            self._on_less()

    def remove(self, decimation: Decimation | None) -> None:
        """Forget a subscription."""
        self._counts[decimation] -= 1
        if not self._counts[decimation]:
            del self._counts[decimation]

    @property
    def decimations(self) -> tuple[Decimation, ...]:
        """Decimations of which one takes each sample that any subscription takes; none if the world must make all samples."""
        decimations = tuple(decimation for decimation in self._counts if decimation is not None)
        return () if None in self._counts or len(decimations) > MOST_DECIMATIONS else decimations


class Share:
    """What one subscription takes of one port. A sample passes if it is the first one in its interval of 1/rate_hz.

    Intervals count from the first sample.

    Attributes:
        subscription: the subscription.
        rate_hz: intervals in a second; 0 if it takes all samples.
        start_ns: when the first interval begins; NOT_BEGUN before the first sample, and 0 if it takes all samples.
        newest: number of the newest interval of which a sample has passed. Code that selects samples without `passes` sets it.
    """

    def __init__(self, subscription: Subscription, taken: Taken) -> None:
        self.subscription = subscription
        self._taken = taken
        # Times are whole nanoseconds, so a higher rate means the same, and no product can overflow.
        self.rate_hz = 0.0 if subscription.rate_hz is None else min(subscription.rate_hz, 1e9)
        self._decimation: Decimation | None = None
        self._told: Decimation | None = None
        self.start_ns, self.newest = NOT_BEGUN if self.rate_hz else 0, 0
        taken.add(None)

    def passes(self, t_ns: int) -> bool:
        """Return whether the sample that was true at `t_ns` is sent."""
        if not self.rate_hz:
            return True
        decimation = self._decimation
        if decimation is None:
            self.begin(t_ns)
            self.newest = 0
            return True
        interval = decimation.interval(t_ns)
        if interval > self.newest:
            self.newest = interval
            return True
        if self.newest - self.rate_hz - 1 <= interval:
            return False
        # Time was set back by more than a second. If samples come in such an order, it will be set back again. No sample may be missing then, so
        # the world is not told of the new intervals.
        self._begin(Decimation(self.rate_hz, t_ns), None)
        return True

    def begin(self, t_ns: int) -> None:
        """Begin the intervals with the first sample, true at `t_ns`, which comes next."""
        first = Decimation(self.rate_hz, t_ns)
        self._begin(first, first)
        self.newest = -1

    def _begin(self, decimation: Decimation | None, told: Decimation | None) -> None:
        """Begin new intervals, and tell the world that this subscription takes `told`."""
        self._taken.remove(self._told)
        self._taken.add(told)
        self._decimation, self._told, self.newest = decimation, told, 0
        if self.rate_hz:
            self.start_ns = NOT_BEGUN if decimation is None else decimation.start_ns

    def restart(self) -> None:
        """Begin new intervals with the next sample."""
        self._begin(None, None)

    def end(self) -> None:
        """End the share: the subscription does not take this port any more."""
        self._taken.remove(self._told)
