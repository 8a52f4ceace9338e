"""Tasks that are met at one place, and the camera through which a pilot looks."""

from __future__ import annotations

import pytest

from uwserver.sensors.onboard.tasks import Eye, Gate, HoldDepth, Moment, Reach, Task

AHEAD = Eye((0.0, 0.0, 5.0), (1.0, 0.0, 0.0), 0.8660254)
"""Looks north and sees 30 degrees to each side."""


@pytest.mark.parametrize(
    ("p", "is_in_view"),
    [
        ((3.0, 0.0, 5.0), True),
        ((3.0, 1.7, 5.0), True),  # 29.5 degrees
        ((3.0, 1.8, 5.0), False),  # 31 degrees
        ((3.0, 0.0, 6.8), False),
        ((-3.0, 0.0, 5.0), False),  # behind
        ((0.0, 0.0, 5.0), True),  # at the lens
    ],
)
def test_a_camera_sees_a_cone(p, is_in_view):
    assert AHEAD.has_in_view(p) is is_in_view


def test_a_box_is_reached_inside_its_edges():
    task = Reach(position_ned_m=(5.0, 2.0, 3.0), size_m=(2.0, 1.0, 4.0), points=30.0)
    assert task.worth() == (30.0,)
    for p, piece in (((5.9, 2.4, 4.9), 0), ((6.1, 2.0, 3.0), -1), ((5.0, 2.6, 3.0), -1), ((5.0, 2.0, 5.1), -1)):
        assert task.judge(Moment(p, p), (False,), -1) == (piece, (5.0, 2.0, 3.0), "")


def test_a_depth_lies_below_the_vehicle():
    task = HoldDepth(depth_m=4.0, tolerance_m=0.5, for_s=1.0)
    assert task.judge(Moment((7.0, 8.0, 1.0), (7.0, 8.0, 1.0)), (False,), -1) == (-1, (7.0, 8.0, 4.0), "")
    assert task.judge(Moment((7.0, 8.0, 3.6), (7.0, 8.0, 3.6)), (False,), -1).piece == 0


def test_a_task_of_one_piece_is_over_when_it_is_done():
    task: Task = Reach()
    assert (task.is_over((False,)), task.is_over((True,))) == (False, True)
    assert (task.part((False,)), task.part((True,))) == (0.0, 1.0)
    assert (task.names(), task.has_marks(), task.marked(Moment((0.0,) * 3, (0.0,) * 3), (False,))) == (("",), False, -1)


def test_a_gate_cannot_be_held():
    with pytest.raises(ValueError, match="a gate is passed at once: remove for_s"):
        Gate(for_s=2.0)
