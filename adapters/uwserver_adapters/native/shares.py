"""How much of a port its subscriptions take: each thins the samples out to its rate, and all together need no more than one of them takes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from uwserver.adapter import NOT_BEGUN, Thinning
from uwserver_adapters.native.outbox import Delivery

MOST_THINNINGS = 8
"""Different ones of a port; where there are more, all its samples are made: the world tries each with each sample."""


class Subscription:
    """What one `subscribe` asked for.

    Attributes:
        serial: the client's name for it.
        fields: those to send; None for all.
        is_jpeg: pictures are sent as JPEG.
        paths: ports that it covers now.
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
    """What all subscriptions of a port take together.

    Args:
        on_less: said when it has become less than all.
    """

    def __init__(self, on_less: Callable[[], None]) -> None:
        self._on_less = on_less
        self._whole = 0
        self._thinnings: Counter[Thinning] = Counter()

    def enter(self) -> None:
        """One more, which takes all."""
        self._whole += 1

    def leave(self, thinning: Thinning | None) -> None:
        """One less, which took so much; None: all."""
        self.change(thinning, None)
        self._whole -= 1

    def change(self, before: Thinning | None, after: Thinning | None) -> None:
        """One takes more or less than before."""
        if before is None:
            self._whole -= 1
        else:
            self._thinnings[before] -= 1
            if not self._thinnings[before]:
                del self._thinnings[before]
        if after is None:
            self._whole += 1
        else:
            self._thinnings[after] += 1
            self._on_less()

    @property
    def thinnings(self) -> tuple[Thinning, ...]:
        """Of these one takes each sample that somebody takes; none where that may be any."""
        return () if self._whole or len(self._thinnings) > MOST_THINNINGS else tuple(self._thinnings)


class Share:
    """One subscription at one port: thins the samples out to its rate.

    A sample passes when it is the first one in its interval of 1/rate_hz, counted from the first sample seen.

    Attributes:
        subscription: whose it is.
        rate_hz: intervals a second; 0 where it takes all.
        start_ns: when the first begins; NOT_BEGUN before a sample has come; 0 where it takes all.
        newest: the last of which a sample passed. Whoever lets samples pass instead of `passes` sets it.
    """

    def __init__(self, subscription: Subscription, taken: Taken) -> None:
        self.subscription = subscription
        self._taken = taken
        # Times are whole nanoseconds: no rate above means more, and no product can overflow.
        self.rate_hz = 0.0 if subscription.rate_hz is None else min(subscription.rate_hz, 1e9)
        self._thinning: Thinning | None = None
        self._told: Thinning | None = None
        self.start_ns, self.newest = NOT_BEGUN if self.rate_hz else 0, 0
        taken.enter()

    def passes(self, t_ns: int) -> bool:
        """Whether the sample that was true at `t_ns` is sent."""
        if not self.rate_hz:
            return True
        thinning = self._thinning
        if thinning is not None:
            interval = thinning.interval(t_ns)
            if interval > self.newest:
                self.newest = interval
                return True
            if self.newest - self.rate_hz - 1 <= interval:
                return False
            # Time was set back by more than a second. Where samples come in such an order it will be again, and none may be missing.
            self._begin(Thinning(self.rate_hz, t_ns), None)
            return True
        self.begin(t_ns)
        self.newest = 0
        return True

    def begin(self, t_ns: int) -> None:
        """The first sample, true at `t_ns`, comes next."""
        first = Thinning(self.rate_hz, t_ns)
        self._begin(first, first)
        self.newest = -1

    def _begin(self, thinning: Thinning | None, told: Thinning | None) -> None:
        self._taken.change(self._told, told)
        self._thinning, self._told, self.newest = thinning, told, 0
        if self.rate_hz:
            self.start_ns = NOT_BEGUN if thinning is None else thinning.start_ns

    def restart(self) -> None:
        """Begin a new series of intervals with the next sample."""
        self._begin(None, None)

    def end(self) -> None:
        """The subscription takes this port no more."""
        self._taken.leave(self._told)
