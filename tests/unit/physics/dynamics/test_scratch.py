"""The rows of the work space: apart from each other, and within it."""

from __future__ import annotations

from uwserver.physics.dynamics import scratch
from uwserver.physics.kernel.layout import SCRATCH


def rows_of(*names: str) -> list[int]:
    return [getattr(scratch, name) for name in names]


def test_rows_of_states_fill_their_array() -> None:
    assert rows_of("K1", "K2", "K3", "K4", "STAGE", "STATE") == list(range(SCRATCH["s"].shape[0]))


def test_rows_of_work_are_apart_and_the_two_of_up_are_free() -> None:
    names = (
        "NU",
        "NU_R",
        "TAU",
        "MOMENTUM",
        "EXTRA",
        "APPLIED",
        "CENTER",
        "UP",
        "WATER",
        "DU_DT",
        "ACTUATED",
        "PASSIVE",
        "EXTERNAL",
        "STREAM",
        "STREAM_RATE",
        "PULL",
    )
    rows = rows_of(*names)
    assert len({*rows, scratch.UP + 1}) == len(names) + 1 == SCRATCH["work"].shape[0]
    assert max(rows) < SCRATCH["work"].shape[0]
