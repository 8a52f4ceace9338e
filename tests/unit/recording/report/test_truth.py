"""Rotations of a report, and the truth it compares with."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import matrix, quat_from_rpy, rpy_from_quat
from uwserver.recording.report.reading import Recorded
from uwserver.recording.report.truth import Truth, euler, mount_of, rotations, small_angles, truth_of

ANGLES = [(0.1, -0.2, 0.3), (3.0, 1.2, -2.9), (-1.0, -1.5, 0.0)]


@pytest.mark.parametrize("angles", ANGLES)
def test_many_at_once_are_as_one_alone(angles: tuple[float, float, float]) -> None:
    q = quat_from_rpy(*angles)
    R = rotations(np.array([q, q]))
    np.testing.assert_allclose(R[1], matrix(q), atol=1e-12)
    np.testing.assert_allclose(euler(R)[0], rpy_from_quat(q), atol=1e-9)


def test_small_angles_are_the_rotation_vector() -> None:
    vector = np.array([0.01, -0.02, 0.005])
    angle = float(np.linalg.norm(vector))
    q = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * vector / angle)])
    np.testing.assert_allclose(small_angles(rotations(q[None]))[0], vector, atol=1e-12)
    np.testing.assert_allclose(small_angles(np.eye(3)[None])[0], 0.0)


def test_attitudes_between_two_keep_to_the_short_way() -> None:
    q = np.array([quat_from_rpy(0.0, 0.0, 0.0), quat_from_rpy(0.0, 0.0, 0.2)])
    truth = Truth(np.array([0.0, 1.0]), np.zeros((2, 3)), q)
    np.testing.assert_allclose(euler(rotations(truth.at(np.array([0.5]), "q_NB")))[0], (0.0, 0.0, 0.1), atol=1e-9)


def test_a_flipped_sign_of_a_quaternion_is_no_jump(recorded: Recorded) -> None:
    flipped = {**recorded.series}
    pose = flipped["rov/truth/pose"]
    q = pose.columns["q_NB"] * np.where(np.arange(len(pose.t)) % 3 == 0, -1.0, 1.0)[:, None]
    flipped["rov/truth/pose"] = type(pose)(**{**vars(pose), "columns": {**pose.columns, "q_NB": q}})
    found = truth_of(type(recorded)(**{**vars(recorded), "series": flipped}), "rov")
    assert found is not None
    assert float(np.abs(np.diff(found.q_NB, axis=0)).max()) < 0.05


def test_without_truth_the_states_tell_the_poses(recorded: Recorded) -> None:
    found = truth_of(recorded, "other")
    assert found is not None
    assert found.v_NB_B is None
    np.testing.assert_allclose(found.p_NB[0], (5.0, 5.0, 3.0), atol=1e-3)
    assert truth_of(recorded, "nobody") is None


def test_a_named_mount_stands_for_its_place() -> None:
    mount = mount_of(
        {"mount": "top", "position_frd_m": [0, 0, 0]}, {"top": {"position_frd_m": [1, 2, 3], "rpy_deg": [0, 0, 90]}}
    )
    np.testing.assert_allclose(mount.p, (1, 2, 3))
    np.testing.assert_allclose(mount.R @ (1, 0, 0), (0, 1, 0), atol=1e-12)
