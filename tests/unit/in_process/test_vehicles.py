"""The bodies of a world for Python: states as arrays, and one way to set them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import uwserver
from uwserver.frames import rotate
from uwserver.in_process.vehicles import _OTHER_WORDS, Vehicle
from uwserver.ports import Refused


@pytest.fixture(scope="module")
def world():
    with uwserver.load("push_the_crate") as world:
        yield world


@pytest.fixture
def rov(world):
    world.reset()
    return world.vehicles["rov"]


def test_states_are_arrays_of_ones_own(world, rov):
    world.command("rov/thrusters", u=[-0.5, -0.5, 0.5, 0.5, 0.2, 0.2, 0.2, 0.2])
    world.step(48)
    row = world.core.vehicles["rov"]
    assert tuple(rov.p_NB) == row.p_NB
    assert tuple(rov.q_NB) == row.q_NB
    assert tuple(rov.nu) == (*rov.v_NB_B, *rov.w_NB_B) == row.nu
    assert tuple(rov.wrench) == row.wrench
    p, q = rov.pose
    v, w = rov.velocity
    assert [each.shape for each in (p, q, v, w, rov.rpy, rov.wrench)] == [(3,), (4,), (3,), (3,), (3,), (6,)]
    np.testing.assert_allclose(rov.pose.R_NB @ v, rotate(row.q_NB, row.nu[:3]), atol=1e-15)
    p[:] = 99.0
    assert rov.p_NB[0] < 10.0
    assert (rov.name, rov.model) == ("rov", "bluerov2_heavy")
    assert repr(rov).startswith("<rov (bluerov2_heavy): p_NB = (")


def test_a_state_is_set_at_once_and_the_rest_stays(world, rov):
    before = rov.p_NB
    rov.set_state(rpy=(0.1, -0.2, 0.5), v_NB_B=np.array([0.3, 0.0, 0.1]))
    np.testing.assert_allclose(rov.rpy, (0.1, -0.2, 0.5), atol=1e-12)
    np.testing.assert_array_equal(rov.p_NB, before)
    np.testing.assert_array_equal(rov.nu, (0.3, 0.0, 0.1, 0.0, 0.0, 0.0))
    rov.set_state(p_NB=[1, 2, 3], q_NB=[2, 0, 0, 0], w_NB_B=(0.0, 0.0, 0.2))
    np.testing.assert_array_equal(rov.p_NB, (1, 2, 3))
    np.testing.assert_array_equal(rov.q_NB, (1, 0, 0, 0))
    world.step(24)
    assert world.read("rov/truth/pose").p_NB[2] == pytest.approx(3.0, abs=0.1)


def test_a_state_that_was_set_is_in_the_hash(world, rov):
    before = world.call("world/state_hash")
    rov.set_state(p_NB=[1, 2, 3])
    assert world.call("world/state_hash") != before


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "nothing is given"),
        ({"p_NB": [1, 2]}, '"p_NB" must be a list of 3'),
        ({"p_NB": [1, 2, math.nan]}, "not a finite number"),
        ({"v_NB_B": [1e5, 0, 0]}, "at most 100 m/s"),
        ({"q_NB": [0, 0, 0, 0]}, "zero length"),
        ({"q_NB": [1, 0, 0, 0], "rpy": [0, 0, 0]}, "give q_NB or rpy"),
        ({"rpy": [0, math.inf, 0]}, "three finite angles"),
        ({"rpy": 1.0, "p_NB": [0, 0, 0]}, "three finite angles"),
        ({"rpy": "north"}, "three finite angles"),
    ],
)
def test_a_wrong_state_is_refused_and_changes_nothing(rov, given, said):
    before = *rov.p_NB, *rov.q_NB, *rov.nu
    with pytest.raises(Refused, match=said):
        rov.set_state(**given)
    assert (*rov.p_NB, *rov.q_NB, *rov.nu) == before


@pytest.mark.parametrize("name", ["position", "p_NB", "pose", "nu", "anything"])
def test_what_cannot_be_assigned_says_what_does_it(rov, name):
    with pytest.raises(AttributeError, match=rf'"{name}" cannot be assigned: world.vehicles\["rov"\].set_state\(p_NB='):
        setattr(rov, name, (0, 0, 0))


@pytest.mark.parametrize("word", _OTHER_WORDS)
def test_words_of_other_simulators_name_what_is_here(rov, word):
    here = _OTHER_WORDS[word].partition("[")[0]
    assert isinstance(getattr(Vehicle, here), property)
    with pytest.raises(AttributeError, match=f'no "{word}": it is {here}'):
        getattr(rov, word)


def test_who_is_not_there_is_named(world, rov):
    with pytest.raises(KeyError, match=r"no vehicle .*rovv.*did you mean .*rov.*there are: rov, crate"):
        world.vehicles["rovv"]
    with pytest.raises(AttributeError, match=r'no "p_NBB".*did you mean "p_NB"'):
        rov.p_NBB  # noqa: B018
    assert list(world.vehicles) == ["rov", "crate"]
    assert len(world.vehicles) == 2
    assert rov == world.vehicles["rov"] != world.vehicles["crate"]
    assert len({rov, world.vehicles["rov"]}) == 1
    assert repr(world.vehicles).count("\n") == 1


def test_a_view_follows_its_world(world, rov):
    """Also to another seed; and it says so if its body is gone."""
    world.reset(seed=77)
    rov.set_state(p_NB=[0.5, 0.0, 2.0])
    assert world.vehicles["rov"].p_NB[0] == 0.5
    world.call("world/spawn", name="guest", like="crate", p_NB=[-3.0, -3.0, 2.0])
    guest = world.vehicles["guest"]
    world.call("world/remove", name="guest")
    with pytest.raises(Refused, match='"guest" is no longer in the world'):
        guest.p_NB  # noqa: B018
