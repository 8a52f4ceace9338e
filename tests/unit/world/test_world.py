"""The tick: its order, its time, what a command does and when. Also of uwserver.world.driving."""

from __future__ import annotations

import numpy as np
import pytest

import uwserver
from uwserver.ports import Call, Command, Refused, Reply
from uwserver.ports.crossing import TickOutput
from uwserver.units import NANOSECONDS
from uwserver.world import Diverged
from uwserver.world.world import _report

AHEAD = (-0.5, -0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0)


def test_a_command_acts_in_the_tick_that_its_reply_names(world):
    world.step(3)
    replies: list[Reply] = []
    world.submit(Command("rov/thrusters", (AHEAD,), "me"), replies.append)
    assert world.vehicles["rov"].nu[0] == 0.0
    world.step(1)
    assert replies[0].tick == 3
    assert replies[0].t_ns == world.ticks.time_of(3)
    assert world.vehicles["rov"].nu[0] > 0.0


def test_of_several_commands_in_a_tick_the_last_acts_and_all_are_answered(world, make_world):
    other = make_world()
    replies: list[Reply] = []
    for u in (-1.0, 1.0, 0.2):
        world.submit(Command("rov/thrusters", ((u,) * 8,), "me"), replies.append)
    other.submit(Command("rov/thrusters", ((0.2,) * 8,), "me"))
    world.step(10)
    other.step(10)
    assert len(replies) == 3
    assert np.array_equal(world.hydro.state, other.hydro.state)


def test_a_call_sees_the_commands_before_it(world):
    world.submit(Command("rov/thrusters", (AHEAD,), "me"))
    world.submit(Call("world/reset", {}))
    world.step(50)
    assert world.vehicles["rov"].nu[0] == pytest.approx(0.0, abs=1e-12)


def test_commands_are_refused_with_the_reason_and_change_nothing(world):
    before = world.hydro.thrusters.tobytes()
    for value in ({"u": [2.0] * 8}, {"u": [0.0] * 7}, {"u": [float("nan")] * 8}, {"v": 1}, {}):
        with pytest.raises(Refused):
            world.command("rov/thrusters", **value)
    with pytest.raises(Refused, match="did you mean"):
        world.command("rov/thruster", u=[0.0] * 8)
    with pytest.raises(Refused, match="sensor"):
        world.command("rov/imu", f_S=[0, 0, 0])
    world.step(1)
    assert world.hydro.thrusters.tobytes() == before


def test_rates_are_kept_and_latency_delays_but_keeps_the_time_of_truth(world):
    samples = world.step(240)
    by_port: dict[str, list] = {}
    for sample in samples:
        by_port.setdefault(sample.port, []).append(sample)
    assert len(by_port["rov/truth/pose"]) == 24
    assert [s.t_ns for s in by_port["rov/truth/pose"]] == [world.ticks.time_of(10 * k) for k in range(1, 25)]
    late = by_port["rov/late_imu"]
    assert 57 <= len(late) <= 59
    assert sorted(s.seq for s in late) == list(range(len(late)))
    assert [s.t_sent_ns for s in late] == sorted(s.t_sent_ns for s in late)
    assert all(0 <= s.t_sent_ns - s.t_ns < 0.06 * NANOSECONDS for s in late)
    assert all(s.t_ns == world.ticks.time_of(4 * (s.seq + 1)) for s in late)


def test_read_gives_the_newest_sample(world):
    assert world.read("rov/truth/pose") is None
    samples = [s for s in world.step(40) if s.port == "rov/truth/pose"]
    assert world.read("rov/truth/pose") == samples[-1]
    with pytest.raises(Refused, match="no port"):
        world.read("rov/truth/position")


def test_truth_is_the_state(world):
    world.command("rov/thrusters", u=AHEAD)
    sample = [s for s in world.step(10) if s.port == "rov/truth/velocity"][-1]
    assert (*sample.value[0], *sample.value[1]) == world.vehicles["rov"].nu


def test_a_body_that_diverges_stops_the_world_with_a_report(world):
    world.command("rov/thrusters", u=AHEAD)
    world.step(5)
    world.hydro.state[0, 7] = np.nan
    with pytest.raises(Diverged) as caught:
        world.step(1)
    text = str(caught.value)
    assert '"rov"' in text
    assert "tick 6" in text
    assert "rov/thrusters in tick 0" in text
    assert "0.5" in text


def test_a_call_that_fails_is_answered_and_the_world_goes_on(world):
    replies: list[Reply] = []
    world.submit(Call("world/restore", {"name": "nothing"}), replies.append)
    world.step(2)
    assert replies[0].fault is not None
    assert 'no snapshot "nothing"' in replies[0].fault.text
    assert world.tick == 2


def test_many_vehicles_do_not_disturb_each_other(make_world):
    alone, crowd = make_world(), make_world(vehicles=5)
    for w in (alone, crowd):
        w.command("rov/thrusters", u=AHEAD)
    a, c = alone.step(100), crowd.step(100)
    assert np.array_equal(alone.hydro.state[0], crowd.hydro.state[0])
    assert a == [s for s in c if s.port.startswith("rov/")]


def test_a_command_in_the_same_process_is_checked_once(world, monkeypatch):
    """The world asks for the very fields that the actuator has; also those of a watchdog that was set anew."""
    again = []
    monkeypatch.setattr("uwserver.world.stepping.commands.check_given", lambda *args: again.append(args))
    for port in [path for path, port in world.ports.items() if port.direction == "actuator"]:
        world.call(f"{port}/set", timeout_s=7 / 240)
    world.command("rov/thrusters", u=[0.0] * 8)
    world.step()
    assert not again
    world.submit(Command("rov/thrusters", ((0.0,) * 8,)))
    world.step()
    assert len(again) == 1, "nobody knows against what this was checked"


def test_what_rays_meet_is_made_before_a_run_that_the_clock_paces(monkeypatch):
    """For sensors in compiled code, and for those in Python; else it would make the tick late in which the first ray is cast."""
    world = uwserver.load("follow_the_pipe").core
    world.prepare()
    made = []
    for name in ("make_picker", "grow"):
        monkeypatch.setattr(f"uwserver.physics.rays.surfaces.{name}", lambda *_, name=name: made.append(name))
    world.step(120)
    hits = world.geometry.raycast(np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]]), 100.0)
    assert hits.body[0] >= 0
    assert made == []


def test_the_report_names_body_tick_and_commands():
    world = uwserver.load("bluerov2_pool").core
    world.command("bluerov2/wrench", force_B=[1, 2, 3])
    world.step()
    world.hydro.state[world.vehicles["bluerov2"].row, 0] = float("nan")
    with pytest.raises(Diverged) as caught:
        world.step()
    text = str(caught.value)
    assert text.startswith('body "bluerov2" diverged in tick ')
    assert "bluerov2/wrench" in text
    assert isinstance(caught.value.output, TickOutput)
    assert _report(7, 0, None, world._commands) == "a body that is no longer there diverged in tick 7"
