"""What every reader of logs promises."""

import numpy as np
import pytest

from uwserver.logfiles import member

NESTED = {"pose": {"position": {"x": 1.5}, "covariance": np.arange(4.0)}, "names": ["a", "b"]}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pose.position.x", 1.5),
        ("pose.covariance.3", 3.0),
        ("names.1", "b"),
        ("pose.position.w", None),
        ("pose.covariance.4", None),
        ("names.b", None),
        ("names.1.0", None),
        ("pose.position.x.y", None),
        ("names." + "9" * 5000, None),
        ("", None),
    ],
)
def test_dotted_names_reach_into_messages(name, value):
    assert member(NESTED, name) == value
