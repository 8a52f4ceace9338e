"""What the actuators of an external body give: pulses, angles and parts of full, how long they hold, and what nobody knows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.world.external.motion import LiveMotion, Motion, NewestOutputs, RecordedMotion, ShownActuator

S = 1_000_000_000
SHOWN = (ShownActuator("fore"), ShownActuator("aft"), ShownActuator("rudder", math.radians(30.0)))


def motion(names: tuple[str, ...], kinds: tuple[str, ...], *rows: tuple[float, ...]) -> Motion:
    return Motion(np.arange(len(rows), dtype=np.int64) * S, names, kinds, np.array(rows))  # type: ignore[arg-type]


def test_pulses_angles_and_parts_are_told_by_name_or_number() -> None:
    told = motion(
        ("2", "fore", "rudder", "16"), ("pulse", "part", "angle", "pulse"), (1900e-6, -0.5, math.radians(-15.0), 1.1e-3)
    )
    assert RecordedMotion(SHOWN, told).achieved(0).tolist() == [-64, 127, -64]


def test_an_output_that_is_off_or_unknown_stands_still_and_none_goes_beyond_full() -> None:
    told = motion(("1", "2", "3"), ("pulse", "pulse", "angle"), (0.0, math.nan, 9.0))
    assert RecordedMotion(SHOWN, told).achieved(0).tolist() == [0, 0, 127]


def test_a_value_holds_for_two_seconds() -> None:
    source = RecordedMotion(SHOWN, motion(("fore",), ("part",), (1.0,), (0.5,)))
    assert not source.achieved(-1).any()
    assert [int(source.achieved(t)[0]) for t in (0, S - 1, S, 3 * S, 3 * S + 1)] == [127, 127, 64, 64, 0]


def test_a_log_that_says_nothing_leaves_them_still() -> None:
    assert RecordedMotion(SHOWN, None).achieved(S).tolist() == [0, 0, 0]


def test_a_peer_says_it_by_a_command_that_is_remembered() -> None:
    now = [5 * S]
    live = LiveMotion(SHOWN, lambda: now[0])
    assert live.fields[0].shape == (3,)
    assert "fore, aft, rudder" in live.fields[0].doc
    assert not live.achieved(now[0]).any()
    live.apply(((1.0, -1.0, 0.25),))
    live.apply((None,))
    assert live.memory == NewestOutputs(5 * S, (1.0, -1.0, 0.25))
    assert live.achieved(7 * S).tolist() == [127, -127, 32]
    assert not live.achieved(7 * S + 1).any()


@pytest.mark.parametrize("newest", [NewestOutputs(0, (1.0,)), NewestOutputs()])
def test_what_does_not_fit_the_vehicle_shows_nothing(newest: NewestOutputs) -> None:
    live = LiveMotion(SHOWN, lambda: 0)
    live.memory = newest
    assert not live.achieved(1).any()
