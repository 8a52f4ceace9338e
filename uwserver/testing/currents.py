"""The conformance suite for currents: a steady table, or a velocity that can be repeated and depends only on its arguments."""

from __future__ import annotations

import numpy as np

from uwserver.environment.currents import CurrentTable, Drift, ProfileConfig, UniformConfig, flow_of

_RATE_HZ = 100.0
_DRAWS = 20


def check_current(config: CurrentTable) -> None:
    """Build a current from its configuration, and check its contract.

    Raises:
        AssertionError: the text names the current and says what the contract requires.
    """
    kind = f'current "{config.__struct_config__.tag}"'
    try:
        flow = flow_of(config)
    except ValueError as error:
        raise AssertionError(f"{kind}: {error}") from None
    if isinstance(flow, UniformConfig | ProfileConfig):
        assert flow_of(config) == flow, f"{kind}: build() gives something else the second time"
        return

    def built(seed: int) -> Drift:
        again = flow_of(config)
        assert not isinstance(again, UniformConfig | ProfileConfig), f"{kind}: build() gives something else each time"
        return Drift(again, _RATE_HZ, np.random.default_rng(seed))

    first, other = built(1), built(2)
    ends = _run(first, 0)
    assert np.isfinite(ends).all(), f"{kind}: a velocity is not finite: {ends[~np.isfinite(ends)]}"
    assert (_run(built(1), 0) == ends).all(), f"{kind}: with the same random numbers it does something else"
    other.ends[...], other.rng.bit_generator.state = first.ends, first.rng.bit_generator.state
    assert (_run(other, _DRAWS) == _run(first, _DRAWS)).all(), (
        f"{kind}: from the last velocity and random stream of another run it does not go on as that"
    )


def _run(drift: Drift, start: int) -> np.ndarray:
    """Return the velocities (_DRAWS, 3) from a draw on, m/s."""
    ends = []
    for k in range(start, start + _DRAWS):
        drift.move((k + 1) * drift.ticks)
        ends.append(drift.ends[1].copy())
    return np.array(ends)
