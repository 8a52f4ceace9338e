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
        ("bluerov2/thrusters", {}, "no field is given"),
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
    world = uwserver.load("bluerov2_pool").core
    world.step(10)
    world.command("bluerov2/thrusters", u=[0.5] * 8)
    world.step(10)
    assert np.array_equal(late[1], world.hydro.state[0])


NEVER = 2**62
"""Ticks that no run has."""
ALL = np.arange(3)


def quiet(batch, which=ALL):
    """For how many ticks no command acts on these copies, and no watchdog bites."""
    return min(NEVER, batch._commands.quiet(batch.ticks, np.array(which), np.isin(ALL, which)))


def test_it_is_quiet_for_ever_where_nobody_commands(batch):
    assert quiet(batch) == NEVER
    batch.step(5)
    assert quiet(batch) == NEVER


def test_it_is_quiet_until_the_next_command_acts_or_watchdog_bites(batch):
    """Watchdogs bite 240 ticks after a command has acted: of copy 0 at 245, of copy 1 at 255, of copy 2 at 325."""
    batch.reset(command_latency=[0.0, 10 / 240, 80 / 240])
    batch.step(5)
    batch.command("bluerov2/thrusters", u=np.full(8, 0.5))
    assert quiet(batch) == 0
    batch.step(1)
    assert (quiet(batch), quiet(batch, [1]), quiet(batch, [2]), quiet(batch, [0, 2])) == (9, 9, 79, 79)
    assert quiet(batch, [0]) == 239
    batch.step(14)  # tick 20
    assert (quiet(batch), quiet(batch, [0, 1]), quiet(batch, [1])) == (65, 225, 235)
    batch.step(70)
    assert (quiet(batch), quiet(batch, [2])) == (155, 235)
    batch.step(156)  # the first has bitten
    assert (quiet(batch, [0]), quiet(batch)) == (NEVER, 9)
    batch.step(300)
    assert quiet(batch) == NEVER


def test_each_port_has_a_watchdog_of_its_own(batch):
    batch.command("bluerov2/thrusters", u=np.zeros(8))
    batch.step(100)
    batch.command("bluerov2/wrench", [1], force_B=np.zeros(3))
    batch.step(100)
    assert (quiet(batch), quiet(batch, [1])) == (40, 40)
    batch.step(41)
    assert (quiet(batch, [1]), quiet(batch, [0, 2])) == (99, NEVER)


def test_what_was_commanded_to_copies_that_stand_still_disturbs_nobody(batch):
    """A copy that fell apart keeps what was posted until it is reset; a reset forgets it, and the watchdog with it."""
    batch.reset(command_latency=20 / 240)
    batch.command("bluerov2/thrusters", [1, 2], u=np.zeros(8))
    batch._copies[1].world.hydro.state[0, 7] = np.nan
    batch.step(1)
    assert quiet(batch, [0, 2]) == 19
    batch.step(29)
    assert batch.ticks.tolist() == [30, 1, 30]
    assert (quiet(batch, [0]), quiet(batch, [0, 2])) == (NEVER, 230)
    batch.reset([1, 2])
    assert quiet(batch) == NEVER


def test_commands_that_python_carries_out_are_awaited_too(batch):
    batch.reset(command_latency=[0.0, 12 / 240, 0.0])
    batch.command("bluerov2/camera_tilt", tilt=0.1)
    batch.step(1)
    assert quiet(batch) == 11
    batch.step(12)
    assert quiet(batch) == NEVER
