"""Currents of a scenario: uniform, by depth, or changing with time. All currents of a scenario add up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal, Protocol

import msgspec
import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import PROFILE_SIZE
from uwserver.table import NonNegative, Positive, Table, Vector3


class CurrentTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """Base of all currents, with the key `kind`.

    A kind other than `uniform` and `profile` has a method ``build()``. It returns a table of one of these two if the current is steady, or a
    `Drifting` if it changes with time. It raises ValueError for keys that do not fit each other.
    """


class Drifting(Protocol):
    """A current that is the same everywhere and changes with time. Its state is its last velocity and its random stream."""

    @property
    def interval_s(self) -> float:
        """Time between two calls of `velocity`, rounded to ticks; between them the velocity is linear, as jumps would shake every body."""

    def velocity(
        self, t: float, dt: float, last: FloatArray | None, rng: np.random.Generator
    ) -> Sequence[float] | FloatArray:
        """Return the velocity (3) of the water in N, m/s. It must depend on the arguments only.

        Args:
            t: simulation time, s.
            dt: the rounded interval, s.
            last: (3) velocity at t - dt; None at the start.
            rng: random stream of this current.
        """


class UniformConfig(CurrentTable, tag="uniform", kw_only=True, frozen=True):
    """The same velocity everywhere and always. ``world/set_current`` replaces the sum of all uniform currents."""

    velocity_ned_mps: Vector3


class ProfileConfig(CurrentTable, tag="profile", kw_only=True, frozen=True):
    """Steady velocity by depth, constant above the first depth and below the last.

    Attributes:
        depth_m: rising depths below the still water level.
        velocity_ned_mps: one for each depth.
        interpolation: "linear", or "pchip", which is smooth and does not overshoot (Fritsch and Carlson 1980).
    """

    depth_m: Annotated[tuple[float, ...], msgspec.Meta(min_length=2)]
    velocity_ned_mps: Annotated[tuple[Vector3, ...], msgspec.Meta(min_length=2)]
    interpolation: Literal["linear", "pchip"] = "linear"


class GaussMarkovConfig(CurrentTable, tag="gauss_markov", kw_only=True, frozen=True):
    """A first-order Gauss-Markov process about zero, the same everywhere.

    Attributes:
        sigma_ned_mps: standard deviation of each component in N.
        tau_s: correlation time.
        interval_s: time between two random values, between which the velocity is linear; default: tau_s / 100. Water that changed direction in
            each tick would shake every body in it.
    """

    sigma_ned_mps: tuple[NonNegative, NonNegative, NonNegative]
    tau_s: Positive
    interval_s: Positive | msgspec.UnsetType = msgspec.UNSET

    def build(self) -> Drifting:
        """Return the process."""
        return _GaussMarkov(self)


CurrentConfig = UniformConfig | ProfileConfig | GaussMarkovConfig


def flow_of(current: CurrentTable) -> UniformConfig | ProfileConfig | Drifting:
    """Return a current as one of the two steady kinds or as a `Drifting`.

    Raises:
        ValueError: `build` returned something else. Other exceptions of an extension's `build` pass through.
    """
    flow: object = current if isinstance(current, UniformConfig | ProfileConfig) else current.build()  # type: ignore[attr-defined]  # any other kind has it
    if isinstance(flow, UniformConfig | ProfileConfig):
        return flow
    if not callable(getattr(flow, "velocity", None)) or not getattr(flow, "interval_s", 0.0) > 0.0:
        drifting = "something with velocity() and an interval_s above 0"
        text = f"build() must return a UniformConfig, a ProfileConfig, or {drifting}, not {type(flow).__name__}"
        raise ValueError(text)
    return flow  # type: ignore[return-value]  # as just checked


def profile_rows(config: ProfileConfig) -> FloatArray:
    """Return the pieces (m, PROFILE_SIZE) of a profile for `SeaRows`: cubics between the depths, constants outside."""
    z, u = np.array(config.depth_m), np.array(config.velocity_ned_mps)
    n, h = len(z), np.diff(z)[:, None]
    slope = np.diff(u, axis=0) / h
    low = high = slope
    if config.interpolation == "pchip":
        knots = np.stack([_pchip_slopes(h[:, 0], slope[:, i]) for i in range(3)], axis=1)
        low, high = knots[:-1], knots[1:]
    rows = np.zeros((n + 1, PROFILE_SIZE))
    rows[:, 0], rows[:, 1] = np.concatenate([[-np.inf], z]), np.concatenate([z, [np.inf]])
    rows[0, 2], rows[1:, 2] = z[0], z
    rows[0, 3::4], rows[1:, 3::4] = u[0], u
    # A cubic Hermite polynomial from the values and slopes at both ends.
    rows[1:-1, 4::4] = low
    rows[1:-1, 5::4] = (3.0 * slope - 2.0 * low - high) / h
    rows[1:-1, 6::4] = (low + high - 2.0 * slope) / h**2
    return rows


def _pchip_slopes(h: FloatArray, slope: FloatArray) -> FloatArray:
    """Return slopes at the knots that keep each piece monotone: weighted harmonic means inside, limited three-point slopes at the ends."""
    n = len(slope)
    d = np.zeros(n + 1)
    for k in range(1, n):
        if slope[k - 1] * slope[k] > 0.0:
            w1, w2 = 2.0 * h[k] + h[k - 1], h[k] + 2.0 * h[k - 1]
            d[k] = (w1 + w2) / (w1 / slope[k - 1] + w2 / slope[k])
    if n == 1:
        d[:] = slope[0]
    else:
        d[0] = _end_slope(h[0], h[1], slope[0], slope[1])
        d[n] = _end_slope(h[-1], h[-2], slope[-1], slope[-2])
    return d


def _end_slope(h0: float, h1: float, s0: float, s1: float) -> float:
    d = ((2.0 * h0 + h1) * s0 - h0 * s1) / (h0 + h1)
    if d * s0 <= 0.0:
        return 0.0
    if s0 * s1 <= 0.0 and abs(d) > 3.0 * abs(s0):
        return float(3.0 * s0)
    return float(d)


class _GaussMarkov:
    def __init__(self, config: GaussMarkovConfig) -> None:
        given = config.interval_s
        self.interval_s = config.tau_s / 100.0 if isinstance(given, msgspec.UnsetType) else given
        self._tau, self._sigma = config.tau_s, np.array(config.sigma_ned_mps)

    def velocity(self, t: float, dt: float, last: FloatArray | None, rng: np.random.Generator) -> FloatArray:
        draw: FloatArray = rng.standard_normal(3)
        if last is None:  # start from the stationary distribution
            return self._sigma * draw
        keep = math.exp(-dt / self._tau)
        return keep * last + math.sqrt(1.0 - keep**2) * self._sigma * draw


class Drift:
    """One current that changes with time, with its own random stream.

    Attributes:
        ticks: ticks from draw to draw.
        rng: its stream.
        ends: (2, 3) velocity in N at the last and at the next draw, m/s.
    """

    def __init__(self, current: Drifting, rate_hz: float, rng: np.random.Generator) -> None:
        """Start at t = 0; `rate_hz`: ticks per second."""
        self.ticks = max(1, round(current.interval_s * rate_hz))
        self.rng = rng
        self._current, self._rate = current, rate_hz
        self.ends: FloatArray = np.zeros((2, 3))
        self.ends[0] = current.velocity(0.0, self.ticks / rate_hz, None, rng)
        self.ends[1] = self._following(0)

    def move(self, tick: int) -> None:
        """Advance it to a tick, which must follow the last one."""
        if tick % self.ticks == 0:
            self.ends[0] = self.ends[1]
            self.ends[1] = self._following(tick)

    def at(self, tick: int) -> tuple[FloatArray, FloatArray]:
        """Return the velocity (3, m/s) at a tick, and its change (3) until the next tick."""
        step = (self.ends[1] - self.ends[0]) / self.ticks
        return self.ends[0] + (tick % self.ticks) * step, step

    def _following(self, tick: int) -> FloatArray:
        t = (tick + self.ticks) / self._rate
        return np.asarray(self._current.velocity(t, self.ticks / self._rate, self.ends[0].copy(), self.rng))
