"""`range`: a call that tells how far another modem is, or that it did not answer; whoever waits is always answered once."""

from __future__ import annotations

import math

import numpy as np
import pytest
from modem_rig import asked, counts, listen, modem, world_of, world_with

from uwserver.ports import Refused, Reply
from uwserver.ports.crossing import Later
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import ModemTable
from uwserver.sensors.modem import ModemReport
from uwserver.world.modems.send import Ranging
from uwserver.world.state import snapshot

FAR = {"a": (0.0, 0.0, 20.0), "b": (1200.0, 900.0, 20.0)}


def fault(replies: list[Reply]) -> tuple[str, str]:
    (reply,) = replies
    assert reply.fault is not None
    return reply.fault.code, reply.fault.text


def test_the_range_is_that_of_geometry_by_half_of_the_travel_time():
    world = world_of(FAR, ideal=True)
    replies = asked(world, "a/modem/range", destination=2)
    told = listen(world, 2.0)
    assert replies == []  # the answer needs 2.1 s
    told += listen(world, 1.0)
    ((reply,), away) = replies, math.dist(world.vehicles["a"].p_NB, world.vehicles["b"].p_NB)
    sound = world.water.sound_speed(20.0)
    found = reply.result
    assert found["range"] == pytest.approx(away, abs=0.01)
    assert found["travel_time"] == pytest.approx(2.0 * away / sound, abs=1e-4)
    # There, the turn-around, and back.
    assert found["t_s"] == pytest.approx(0.1 + 2.0 * away / sound, abs=1e-4)
    assert (found["destination"], found["bearing"], found["relative_speed"]) == (2, None, None)
    assert [(m.by, m.event, m.range) for m in told if m.by == "a"] == [("a", "delivered", found["range"])]
    assert 0 <= reply.t_ns / 1e9 - found["t_s"] < 0.01


def test_the_turn_around_is_not_taken_for_distance():
    found = []
    for turn in (0.05, 1.5):
        world = world_of(FAR, ideal=True, turn_around_s=turn)
        replies = asked(world, "a/modem/range", destination=2)
        listen(world, 4.5)
        found.append(replies[0].result["range"])
    assert found[0] == pytest.approx(1500.0, abs=0.05)
    assert found[0] == pytest.approx(found[1], abs=0.05)


def test_a_believed_sound_speed_scales_it():
    world = world_of(FAR, ideal=True, assumed_sound_speed_mps=1600.0)
    replies = asked(world, "a/modem/range", destination=2)
    listen(world, 3.0)
    assert replies[0].result["range"] == pytest.approx(1500.0 * 1600.0 / world.water.sound_speed(20.0), rel=1e-4)


def test_nobody_answers_in_time():
    world = world_of(FAR)
    nobody = asked(world, "a/modem/range", destination=9, timeout_s=1.25)
    told = listen(world, 1.2)
    assert nobody == told == []
    told = listen(world, 0.1)
    assert fault(nobody) == ("timeout", "no answer from 9 came within 1.25 s")
    assert nobody[0].fault.where == "a/modem/range"
    assert [(m.event, m.destination) for m in told] == [("failed", 9)]
    # One that is there but too far for the patience: its answer, of 2.1 s, finds nobody who waits.
    late = asked(world, "a/modem/range", destination=2, timeout_s=1.5)
    listen(world, 4.0)
    assert fault(late)[0] == "timeout"
    assert counts(world, "a") == {"sent": 2, "unanswered": 2}


def test_without_a_time_out_it_waits_as_long_as_the_longest_range_takes():
    world = world_of(FAR, max_range_m=1600.0)
    replies = asked(world, "a/modem/range", destination=9)
    listen(world, 2.5)
    assert replies == []
    listen(world, 1.0)
    assert fault(replies)[0] == "timeout"


def test_one_at_a_time_and_then_the_next():
    world = world_of(FAR)
    first = asked(world, "a/modem/range", destination=2)
    second = asked(world, "a/modem/range", destination=2)
    listen(world, 0.1)
    code, text = fault(second)
    assert (code, first) == ("busy", [])
    assert "waits for another range" in text
    listen(world, 3.0)
    third = asked(world, "a/modem/range", destination=2)
    listen(world, 3.0)
    assert first[0].fault is third[0].fault is None


def test_cancelled():
    world = world_of(FAR)
    replies = asked(world, "a/modem/range", destination=2)
    listen(world, 0.5)
    world.call("a/modem/cancel_range")
    told = listen(world, 5.0)
    assert fault(replies)[0] == "preempted"
    assert [m for m in told if m.by == "a"] == []
    assert counts(world, "a") == {"sent": 1}
    again = asked(world, "a/modem/range", destination=2)
    listen(world, 3.0)
    assert again[0].fault is None


@pytest.mark.parametrize(
    ("how", "text"),
    [
        (snapshot.restore, "put to another time"),
        (lambda world, kept: world.call("world/reset"), "put to another time"),
        (lambda world, kept: world.call("world/remove", name="a"), "taken out"),
        (lambda world, kept: world.call("a/modem/received/deactivate"), "switched off"),
        (lambda world, kept: [on(answer) for on, answer in world.end("the end")], "the end"),
    ],
)
def test_who_waits_is_answered_whatever_happens(how, text):
    world = world_of(FAR)
    kept = snapshot.take(world)
    replies = asked(world, "a/modem/range", destination=2)
    listen(world, 0.5)
    how(world, kept)
    listen(world, 4.0)
    code, said = fault(replies)
    assert code == "preempted"
    assert text in said


def test_a_snapshot_keeps_that_a_range_is_under_way():
    world = world_of(FAR)
    asked(world, "a/modem/range", destination=2)
    listen(world, 0.5)
    data = snapshot.to_bytes(world, snapshot.take(world))
    fresh = world_of(FAR)
    snapshot.from_bytes(fresh, data)
    assert fault_of(fresh, destination=2)[0] == "busy"
    assert listen(fresh, 3.0) == listen(world, 3.0)
    assert snapshot.take(fresh).hash() == snapshot.take(world).hash()


def fault_of(world, **args):
    with pytest.raises(Refused) as refused:
        world.call("a/modem/range", **args)
    return refused.value.fault.code, refused.value.fault.text


@pytest.mark.parametrize(
    ("args", "code", "text"),
    [
        ({"destination": 1}, "bad_argument", "has address 1 itself"),
        ({"destination": 300}, "out_of_range", ""),
        ({"destination": 2, "timeout_s": 0.0}, "out_of_range", ""),
        ({"destination": 50}, "bad_argument", "cannot request an answer from all"),
        ({}, "bad_argument", "destination"),
    ],
)
def test_what_cannot_be_asked(args, code, text):
    world = world_of(FAR, broadcast_address=50)
    found = fault_of(world, **args)
    assert found[0] == code
    assert text in found[1]
    listen(world, 0.5)
    assert counts(world, "a") == {}


def test_a_modem_that_is_off_says_so():
    for port in ("received", "send"):
        world = world_of(FAR)
        world.call(f"a/modem/{port}/deactivate")
        assert fault_of(world, destination=2) == (
            "denied", f'"a/modem/{port}" is deactivated: call a/modem/{port}/activate first',
        )  # fmt: skip


def test_a_make_that_does_not_answer_has_no_such_service():
    world = world_of(FAR, acknowledges=False)
    assert "a/modem/range" not in world.services


def test_a_node_that_goes_has_its_services_only_while_it_is_there():
    world = world_of(FAR)
    world.call("world/spawn", name="c", like="a", p_NB=[100.0, 0.0, 20.0])
    assert "c/modem/range" in world.services
    world.call("world/remove", name="c")
    assert "c/modem/range" not in world.services


def test_moorings_and_ships_are_asked_and_ask_like_vehicles():
    """Nodes that no dynamics move: one that stands on the bottom, and one at the surface."""

    def fixed(place: tuple[float, float, float], address: int) -> VehicleEntry:
        return VehicleEntry(
            kind="external",
            model="otter",
            outside="hold",
            position_ned_m=place,
            sensors={"modem": modem(address, ideal=True)},
        )

    entries = {
        "auv": VehicleEntry(model="lauv", position_ned_m=(0.0, 0.0, 40.0), sensors={"modem": modem(1, ideal=True)}),
        "mooring": fixed((300.0, 400.0, 80.0), 2),
        "ship": fixed((-600.0, 0.0, 2.0), 3),
    }
    world = build(load(Scenario(schema=1, vehicles=entries), adapters={}))
    for who, destination, other in (("auv", 2, "mooring"), ("auv", 3, "ship"), ("ship", 2, "mooring")):
        replies = asked(world, f"{who}/modem/range", destination=destination)
        listen(world, 3.0)
        away = math.dist(world.vehicles[who].p_NB, world.vehicles[other].p_NB)
        # Straight lines through water whose sound speed grows by 0.016 m/s a metre.
        assert replies[0].result["range"] == pytest.approx(away, rel=1e-3)
    world.command("mooring/modem/send", data=b"here I stand")
    assert sorted(m.by for m in listen(world, 2.0)) == ["auv", "ship"]
    world.command("ship/pose", p_NB=[-900.0, 0.0, 2.0])
    listen(world, 0.5)
    replies = asked(world, "auv/modem/range", destination=3)
    listen(world, 3.0)
    assert replies[0].result["range"] == pytest.approx(900.0, abs=5.0)


def test_the_error_of_a_range_is_that_of_two_arrivals():
    modems: dict[str, ModemTable] = {name: modem(k, source_level_db=165.0) for k, name in enumerate(FAR, 1)}
    world, errors = world_with(FAR, modems), []
    for _ in range(40):
        replies = asked(world, "a/modem/range", destination=2)
        listen(world, 2.5)
        found = replies[0].result
        errors.append(found["range"] - math.dist(world.vehicles["a"].p_NB, world.vehicles["b"].p_NB))
    sound = world.water.sound_speed(20.0)
    assert np.std(errors) == pytest.approx(0.5 * math.sqrt(2.0) * sound / (4e3 * 10 ** (0.05 * found["snr"])), rel=0.4)


def test_answers_to_what_nobody_asked_are_nothing():
    answers: list[tuple[object, Reply]] = []
    ranging = Ranging(answers, lambda: (3, 30))
    told = ModemReport("delivered", 1, 2, b"", 1.0, 1.1, range=15.0)
    ranging.answered(7, told, 0.02)
    later = ranging.wait(8, "a/modem/received")
    assert isinstance(later, Later)
    later.on_reply = print
    ranging.end("no", "b/modem/received")
    assert answers == []
    ranging.answered(8, told, 0.02)
    ranging.lost(8, "late")
    ((_, reply),) = answers
    assert (reply.tick, reply.t_ns, reply.result["range"]) == (3, 30, 15.0)
