"""Commands as arrays: checked before any copy gets one, and for those that are meant alone."""

import numpy as np
import pytest

import uwserver
from uwserver.ports import Refused


@pytest.fixture
def batch():
    return uwserver.batch("bluerov2_pool", 3, sensors=())


@pytest.mark.parametrize(
    ("port", "value", "text"),
    [
        ("bluerov2/thruster", {"u": np.zeros(8)}, 'did you mean "bluerov2/thrusters"'),
        ("bluerov2/thrusters", {"v": np.zeros(8)}, 'no field "v"'),
        ("bluerov2/thrusters", {}, "no field given"),
        ("bluerov2/thrusters", {"u": np.zeros((2, 8))}, r"\(3, 8\) is needed"),
        ("bluerov2/thrusters", {"u": np.full((3, 8), [[0.0], [np.nan], [0.0]])}, "of copy 1 is not finite"),
        ("bluerov2/thrusters", {"u": np.full((3, 8), [[0.0], [0.0], [1.5]])}, "of copy 2 is above 1"),
        ("bluerov2/thrusters", {"u": "full"}, "must be numbers"),
    ],
)
def test_what_does_not_fit_is_refused_and_no_copy_gets_anything(batch, port, value, text):
    with pytest.raises(Refused, match=text):
        batch.command(port, **value)
    batch.step(10)
    assert np.array_equal(*batch.states()[:2])


def test_some_copies_are_commanded_and_the_others_are_not(batch):
    batch.command("bluerov2/wrench", [2, 0], force_B=[[20.0, 0, 0], [10.0, 0, 0]])
    batch.step(100)
    u = batch.states()[:, 7]
    assert u[2] > 1.5 * u[0] > 0.0
    assert abs(u[1]) < 1e-9


def test_a_command_acts_after_its_copys_latency_and_a_reset_drops_what_has_not(batch):
    """240 ticks a second: 10 ticks later, copy 1 does what copy 0 has done."""
    batch.reset(command_latency=[0.0, 10 / 240, 10 / 240])
    batch.command("bluerov2/thrusters", u=np.full(8, 0.5))
    batch.reset([2])
    batch.step(10)
    assert batch.states()[0, 7:].any()
    still, prompt = batch.states()[[1, 2]], batch.states()[0]
    assert np.array_equal(*still)
    batch.step(10)
    late = batch.states()
    assert not np.array_equal(late[1], late[2])
    assert np.allclose(late[1, 7:], prompt[7:], atol=0.02)
    world = uwserver.load("bluerov2_pool")
    world.step(10)
    world.command("bluerov2/thrusters", u=[0.5] * 8)
    world.step(10)
    assert np.array_equal(late[1], world.hydro.state[0])
