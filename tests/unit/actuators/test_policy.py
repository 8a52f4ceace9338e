"""What holds for every actuator in a world: the watchdog, and two who command one."""

from __future__ import annotations

import pytest

from uwserver.ports import Command

RATE = 240
AHEAD = (-0.5, -0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0)


def run(world, ticks):
    """Events and replies of this many ticks, as (tick, event) and replies."""
    events, replies = [], []
    for _ in range(ticks):
        output = world.advance()
        events += output.events
        replies += [reply for _, reply in output.replies]
    return events, replies


def send(world, source="me", u=AHEAD, port="rov/thrusters"):
    world.submit(Command(port, (u,), source), lambda _: None)


def commanded(world):
    return world.hydro.thrusters["command"][8:].tolist()


# -- watchdog ---------------------------------------------------------------------------------------------------------------------------


def test_without_a_command_the_watchdog_is_silent(make_world):
    assert run(make_world(), 3 * RATE)[0] == []


def test_after_its_time_it_goes_to_neutral_and_says_so_once(make_world):
    world = make_world()
    send(world)
    events, _ = run(world, RATE)  # commanded in tick 0, so ticks 0 to 239 are covered
    assert events == []
    assert commanded(world) == list(AHEAD)
    events, _ = run(world, 3 * RATE)
    (event,) = events
    assert (event.event, event.tick, event.t_ns) == ("watchdog", RATE, 1_000_000_000)
    assert event.text == 'no command for "rov/thrusters" in 1 s: it went to neutral'
    assert commanded(world) == [0.0] * 8
    assert world.actuators["rov/thrusters"].timeouts == 1
    assert world.actuators["first/thrusters"].timeouts == 0


def test_every_command_feeds_it(make_world):
    world = make_world()
    for _ in range(5):
        send(world)
        assert run(world, RATE - 1)[0] == []
    assert commanded(world) == list(AHEAD)


def test_a_command_in_the_tick_of_its_end_still_counts(make_world):
    world = make_world()
    send(world)
    run(world, RATE)
    send(world)
    assert run(world, RATE)[0] == []


def test_it_obeys_the_next_command_and_watches_again(make_world):
    world = make_world()
    send(world)
    run(world, 2 * RATE)
    send(world)
    events, _ = run(world, 10)
    assert events == []
    assert commanded(world) == list(AHEAD)
    events, _ = run(world, RATE)
    assert [(event.event, event.tick) for event in events] == [("watchdog", 3 * RATE)]
    assert world.actuators["rov/thrusters"].timeouts == 2


def test_each_actuator_has_its_own_time(make_world):
    tow = {"kind": "force_torque", "timeout_s": 0.25}
    world = make_world(tow=tow, for_ever={"kind": "thruster", "member": "t8", "timeout_s": 0})
    world.command("rov/tow", force_B=[10, 0, 0])
    world.command("rov/for_ever", u=0.5)
    send(world, u=AHEAD)
    events, _ = run(world, 2 * RATE)
    assert [(event.tick, event.text.split('"')[1]) for event in events] == [(60, "rov/tow"), (RATE, "rov/thrusters")]
    assert not world.hydro.wrenches["bias"].any()
    assert world.actuators["rov/for_ever"].timeouts == 0
    assert world.ports["rov/for_ever"].timeout_s is None


def test_the_vehicle_coasts_after_the_watchdog(make_world):
    world = make_world()
    send(world)
    run(world, RATE)
    fast = world.vehicles["rov"].nu[0]
    run(world, 3 * RATE)
    assert 0.0 <= world.vehicles["rov"].nu[0] < 0.5 * fast
    # 2 s after the watchdog the thrusters' lag of 0.14 s leaves a millionth.
    assert not any(abs(force) > 1e-4 for force in world.read("rov/truth/wrench").value[0])


# -- two who command one ----------------------------------------------------------------------------------------------------------------


def test_the_last_command_wins_within_a_tick_and_all_are_answered(make_world):
    world = make_world()
    for source, u in (("a", 0.1), ("b", 0.2), ("a", 0.3)):
        send(world, source, (u,) * 8)
    _, replies = run(world, 1)
    assert [reply.fault for reply in replies] == [None] * 3
    assert [reply.conflict for reply in replies] == [False, True, True]
    assert commanded(world) == [0.3] * 8


def test_a_conflict_is_counted_each_time_and_told_once(make_world):
    world = make_world()
    events = []
    for k in range(10):
        send(world, "ab"[k % 2], (0.1 * (k % 2 + 1),) * 8)
        events += run(world, 24)[0]
    (event,) = events
    assert event.event == "conflict"
    assert event.tick == 24
    assert event.text == '"rov/thrusters" is commanded by a and b: the last command wins'
    assert world.actuators["rov/thrusters"].conflicts == 9
    assert commanded(world) == [0.2] * 8


def test_one_source_alone_is_no_conflict(make_world):
    world = make_world()
    for _ in range(5):
        send(world, "a")
        events, replies = run(world, 10)
        assert events == []
        assert not replies[0].conflict
    assert world.actuators["rov/thrusters"].conflicts == 0


def test_two_vehicles_or_two_actuators_are_no_conflict(make_world):
    world = make_world(one={"kind": "thruster", "member": "t1"})
    send(world, "a")
    send(world, "b", port="first/thrusters")
    send(world, "b", (0.5,), "rov/one")
    events, replies = run(world, 5)
    assert events == []
    assert not any(reply.conflict for reply in replies)


@pytest.mark.parametrize(("pause", "conflict"), [(RATE, True), (RATE + 1, False)])
def test_to_take_over_after_a_second_is_no_conflict(make_world, pause, conflict):
    world = make_world()
    send(world, "a")
    run(world, pause)
    send(world, "b")
    _, replies = run(world, 1)
    assert replies[0].conflict is conflict


def test_a_new_conflict_after_quiet_is_told_again(make_world):
    world = make_world()
    told = []
    for _ in range(2):
        for source in "ab":
            send(world, source)
            told += [event for event in run(world, 10)[0] if event.event == "conflict"]
        run(world, 2 * RATE)
    assert len(told) == 2
