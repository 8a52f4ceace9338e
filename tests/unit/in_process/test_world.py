"""The world that `uwserver.load` gives to a program: its surface, its time, its seeds, its copies, and what it says when something is wrong."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import uwserver
from uwserver.in_process.world import _HOW_ELSE, _OTHER_WORDS, World
from uwserver.ports import Call, Refused
from uwserver.scenario.builder import ScenarioBuilder

AHEAD = [-0.5, -0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def loaded():
    with uwserver.load("bluerov2_pool") as loaded:
        yield loaded


@pytest.fixture
def world(loaded):
    loaded.reset(seed=1)
    loaded.events()
    return loaded


def state_hash(world: World) -> object:
    return world.call("world/state_hash")["hash"]


def test_its_surface_is_small_and_all_of_it_is_documented(world):
    names = [name for name in dir(world) if not name.startswith("_")]
    assert len(names) <= 40
    assert {
        "t_s",
        "tick",
        "step",
        "read",
        "command",
        "call",
        "record",
        "reset",
        "copy",
        "save",
        "load",
        "describe",
        "vehicles",
    } <= set(names)
    assert not [name for name in names if not getattr(World, name).__doc__]


def test_what_the_package_exports_is_there_and_listed():
    for name in uwserver.__all__:
        assert getattr(uwserver, name) is not None
    assert set(uwserver.__all__) <= set(dir(uwserver))
    assert uwserver.World is World
    assert uwserver.Refused is Refused
    with pytest.raises(AttributeError, match="has no attribute 'Word'"):
        uwserver.Word  # noqa: B018


def test_time_is_in_ticks_and_in_seconds(world):
    assert (world.tick, world.t_s, world.t_ns, world.rate_hz, world.dt_s) == (0, 0.0, 0, 240.0, 1 / 240)
    world.step()
    world.step(np.int64(5))
    world.step(seconds=0.05)
    world.step(seconds=1 / 240)
    world.step(seconds=np.float32(0.5))
    assert world.tick == 1 + 5 + 12 + 1 + 120
    assert world.t_s == world.tick / 240
    assert world.t_ns == round(world.tick / 240 * 1e9)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"n": 0}, "a whole number of ticks, 1 or more, not 0"),
        ({"n": -1}, "1 or more, not -1"),
        ({"n": 1.5}, "1 or more, not 1.5"),
        ({"n": 2.0}, "1 or more, not 2.0"),
        ({"n": True}, "1 or more, not True"),
        ({"n": "3"}, "1 or more, not '3'"),
        ({"n": None}, "1 or more, not None"),
        ({"seconds": 0.01}, "0.01 s is no whole number of ticks of 0.00416667 s: near it are 0.00833333 and 0.0125 s"),
        ({"seconds": 0.0}, "no whole number of ticks"),
        ({"seconds": -1.0}, "no whole number of ticks"),
        ({"seconds": float("nan")}, "a number above 0, not nan"),
        ({"seconds": float("inf")}, "a number above 0, not inf"),
        ({"seconds": "a while"}, "a number above 0, not 'a while'"),
        ({"seconds": "0.5"}, "a number above 0, not '0.5'"),
        ({"seconds": True}, "a number above 0, not True"),
        ({"seconds": [1]}, "a number above 0"),
        ({"n": 3, "seconds": 1.0}, "ticks or seconds, not both"),
    ],
)
def test_what_is_no_number_of_ticks_is_refused_and_changes_nothing(world, given, said):
    with pytest.raises(Refused, match=said):
        world.step(**given)
    assert world.tick == 0


@pytest.mark.parametrize("seed", [1.5, -1, "7", True, 2**63])
def test_a_seed_is_a_whole_number_wherever_it_is_taken(world, seed):
    world.step(3)
    for take in (
        lambda: uwserver.load("bluerov2_pool", seed=seed),
        lambda: world.reset(seed=seed),
        lambda: uwserver.batch("bluerov2_pool", 1, sensors=(), seeds=[seed]),
    ):
        with pytest.raises(Refused, match='"seed" must be a whole number, 0 or more, not'):
            take()
    assert (world.tick, world.seed) == (3, 1)


@pytest.mark.parametrize("source", [None, 3, True, {}, ["bluerov2_pool"], b"bluerov2_pool"])
def test_what_cannot_be_loaded_says_what_can(source):
    with pytest.raises(TypeError, match=r"load takes the name of a shipped scenario .* path .* or a Scenario .*, not "):
        uwserver.load(source)


def test_the_class_itself_names_what_makes_a_world():
    with pytest.raises(TypeError, match=r"uwserver.load\('bluerov2_pool'\) makes a world"):
        World("bluerov2_pool")


def test_a_reset_goes_back_to_the_start_and_another_seed_is_that_world(world):
    def dive() -> list[object]:
        world.command("bluerov2/thrusters", u=AHEAD)
        return list(world.step(120))

    rov = world.vehicles["bluerov2"]
    first = dive()
    world.command("bluerov2/thrusters", u=AHEAD)
    world.reset()
    assert (world.tick, world.seed) == (0, 1)
    world.step(1)
    assert rov.v_NB_B[0] == 0.0, "the command before the reset is dropped"
    world.reset()
    assert dive() == first
    world.reset(seed=5)
    assert (world.tick, world.seed) == (0, 5)
    other = dive()
    assert other != first
    with uwserver.load("bluerov2_pool", seed=5) as five:
        five.command("bluerov2/thrusters", u=AHEAD)
        assert list(five.step(120)) == other
    assert rov.v_NB_B[0] > 0.0
    assert [event.event for event in world.events()].count("reset") >= 1


def test_a_world_that_diverged_can_be_reset(world):
    imu = world.record("bluerov2/imu")["bluerov2/imu"]
    world.core.hydro.state[0, 7] = np.nan
    with pytest.raises(uwserver.Diverged):
        world.step(10)
    world.reset()
    world.step(24)
    assert np.isfinite(world.vehicles["bluerov2"].nu).all()
    assert (np.diff(imu.t) > 0).all()


def test_errors_reach_other_processes(world):
    """As a pool of worker processes sends them, which pickles them."""
    world.core.hydro.state[0, 7] = np.nan
    for provoke in (lambda: world.step(0), lambda: uwserver.load("nowhere"), lambda: world.step(10)):
        with pytest.raises((Refused, uwserver.ScenarioError, uwserver.Diverged)) as caught:
            provoke()
        other = pickle.loads(pickle.dumps(caught.value))
        assert (type(other), str(other)) == (caught.type, str(caught.value))
        assert getattr(other, "fault", None) == getattr(caught.value, "fault", None)


def test_a_sensor_is_read_and_an_actuator_says_what_it_is(world):
    assert world.read("bluerov2/imu") is None
    world.step(24)
    assert world.read("bluerov2/imu").f_S.shape == (3,)
    with pytest.raises(
        Refused, match=r'is an actuator.* command\("bluerov2/thrusters", u=...\).* call\("bluerov2/thrusters/get"\)'
    ):
        world.read("bluerov2/thrusters")
    with pytest.raises(Refused, match='did you mean "bluerov2/imu"'):
        world.read("bluerov2/imuu")


def test_events_are_told_once(world):
    world.call("bluerov2/imu/set", rate_hz=60)
    world.command("bluerov2/thrusters", u=AHEAD)
    world.step(300)
    told = [event.event for event in world.events()]
    assert "ports_changed" in told
    assert "watchdog" in told
    assert world.events() == []


def test_a_closed_world_is_read_but_not_stepped():
    with uwserver.load("bluerov2_pool") as world:
        world.step(24)
    world.close()
    assert world.read("bluerov2/imu").valid
    for act in (world.step, world.reset):
        with pytest.raises(Refused, match="the world is closed"):
            act()


@pytest.mark.parametrize("how", [World.copy, copy.copy, copy.deepcopy, lambda world: pickle.loads(pickle.dumps(world))])
def test_a_copy_goes_on_bit_for_bit_and_alone(world, how):
    world.command("bluerov2/thrusters", u=AHEAD)
    world.step(50)
    world.command("bluerov2/thrusters", u=[0.2] * 8)
    recorded = world.record("bluerov2/imu")["bluerov2/imu"]
    other = how(world)
    with other:
        assert (other.seed, other.tick, other.name, list(other.ports)) == (1, 50, world.name, list(world.ports))
        assert other.events() == []
        assert list(other.step(240)) == list(world.step(240))
        assert state_hash(other) == state_hash(world)
        count, position = len(recorded), world.vehicles["bluerov2"].p_NB
        other.step(24)
        assert len(recorded) == count
        np.testing.assert_array_equal(world.vehicles["bluerov2"].p_NB, position)
        other.reset()
        assert world.tick == 290


def test_a_copy_of_a_world_with_one_of_each_kind_goes_on_bit_for_bit():
    """With pictures under computation, modems, autopilots, another seed, and a body that was added."""
    with uwserver.load("one_of_everything", seed=3) as world:
        world.call("world/spawn", name="guest", like="small", p_NB=[5.0, 5.0, 3.0])
        world.command("heavy/thrusters", u=[0.1] * 8)
        world.step(100)
        with pickle.loads(pickle.dumps(world)) as other:
            assert list(other.vehicles) == list(world.vehicles)
            assert list(other.step(150)) == list(world.step(150))
            assert state_hash(other) == state_hash(world)
            assert other.describe() == world.describe()


def test_a_saved_state_is_that_of_the_command_line_and_of_no_other_world(world):
    world.step(24)
    state, then = world.save(), state_hash(world)
    world.step(24)
    world.load(state)
    assert (world.tick, state_hash(world)) == (24, then)
    with pytest.raises(Refused, match="check sum"):
        world.load(state[:-1])
    with uwserver.load("bluerov2_pool", seed=2) as other, pytest.raises(Refused, match="seed 1, here 2"):
        other.load(state)


def test_what_cannot_be_copied_says_why(world, monkeypatch):
    world.core.submit(Call("world/state_hash", {}), print)
    with pytest.raises(Refused, match=r"a call waits for the next tick.*step once, then copy"):
        world.copy()
    world.reset()
    monkeypatch.setattr("uwserver.world.state.snapshot.MAX_BYTES", 1000)
    with pytest.raises(Refused, match="at most 1000 can be saved and loaded"):
        copy.deepcopy(world)


@pytest.mark.parametrize("name", [*_HOW_ELSE, "name", "anything"])
def test_nothing_can_be_assigned(world, name):
    with pytest.raises(AttributeError, match=f'"{name}" cannot be assigned'):
        setattr(world, name, 3)


@pytest.mark.parametrize("word", _OTHER_WORDS)
def test_other_words_name_the_one_that_is_right(world, word):
    here = _OTHER_WORDS[word].partition("(")[0].partition(",")[0]
    assert hasattr(World, here)
    with pytest.raises(AttributeError, match=f'a world has no "{word}": use {here}'):
        getattr(world, word)


def test_an_unknown_name_is_answered_with_what_there_is(world):
    with pytest.raises(AttributeError, match=r'no "recrod".*did you mean "record".*there are: call, close'):
        world.recrod  # noqa: B018
    with pytest.raises(AttributeError, match=r"use core\.hydro, which may change"):
        world.hydro  # noqa: B018
    assert not hasattr(world, "_nothing")


def test_it_says_what_it_is(world):
    world.step(240)
    assert repr(world) == "<World bluerov2_pool at 1.000 s (tick 240): bluerov2; 10 sensors, 4 actuators>"


EXTENSION = """
from uwserver.actuators.base import ActuatorTable
from uwserver.ports import Field


class PushTable(ActuatorTable, tag="push", kw_only=True, frozen=True):
    def build(self, body):
        return Push(body)


class Push:
    doc = "Pushes ahead."
    fields = (Field("force", "N", "ahead"),)

    def __init__(self, body):
        self._body = body

    def apply(self, value):
        self._body.push((value[0][0], 0.0, 0.0))

    def neutral(self):
        self._body.push((0.0, 0.0, 0.0))


ACTUATORS = (PushTable,)
"""
PUSHED = """
schema = 1
extensions = ["push.py"]
vehicles.rov = { model = "bluerov2_heavy", position_ned_m = [0.0, 0.0, 5.0], override.actuators.push = { kind = "push" } }
"""


def test_a_world_with_extensions_is_loaded_anew_in_another_process(tmp_path, monkeypatch):
    """Which knows nothing of their classes."""
    (tmp_path / "push.py").write_text(EXTENSION)
    (tmp_path / "pushed.toml").write_text(PUSHED)
    monkeypatch.chdir(tmp_path)
    with uwserver.load("pushed.toml") as world:
        world.command("rov/push", force=50.0)
        data = pickle.dumps(world)
        assert b"uwserver_extension" not in data
        with pickle.loads(data) as other:
            assert list(other.step(48)) == list(world.step(48))
            assert other.vehicles["rov"].v_NB_B[0] == world.vehicles["rov"].v_NB_B[0] > 0.0


def test_a_scenario_from_python_is_copied_too():
    scenario = ScenarioBuilder("tank", seed=4).vehicle("rov", "bluerov2_heavy", position_ned_m=(0, 0, 2)).build()
    with uwserver.load(scenario) as world, pickle.loads(pickle.dumps(world)) as other:
        assert list(other.step(48)) == list(world.step(48))
        assert state_hash(other) == state_hash(world)
