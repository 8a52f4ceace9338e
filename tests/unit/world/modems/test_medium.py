"""Packets between modems: travel time, collisions, half duplex, answers and ranges, motion, and what a state keeps of all that.

Also of uwserver.scenario.build.modems, uwserver.world.modems.medium, uwserver.world.modems.packets and uwserver.world.modems.hearing.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from modem_rig import counts, heard, listen, modem, world_of, world_with
from msgspec import structs

from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.world.state import snapshot

FAR = {"a": (0.0, 0.0, 20.0), "b": (1500.0, 0.0, 20.0)}
TRIO = {"a": (0.0, 0.0, 20.0), "b": (1000.0, 0.0, 20.0), "c": (500.0, 600.0, 20.0)}


def speed(world):
    return world.water.sound_speed(20.0)


def test_two_vehicles_1500_m_apart_hear_each_other_one_second_later():
    world = world_of(FAR)
    world.step(12)
    begin = world.t_ns / 1e9
    world.command("a/modem/send", destination=2, data=b"hello")
    (message,) = listen(world, 2.0)
    assert (message.by, message.event, message.source, message.destination) == ("b", "data", 1, 2)
    assert message.data == b"hello"
    # The vehicles are not held: they drift by some millimetres in a second.
    assert message.t - begin == pytest.approx(1500.0 / speed(world), abs=1e-4)
    assert message.t - begin == pytest.approx(1.0, abs=0.02)
    # Told when its end has come, at the first tick after.
    assert 0.0 <= message.told - message.t - 5 * 8 / 1e4 <= 1.0 / 240 + 1e-9
    lost = 20.0 * math.log10(1500.0) + 1500.0 * world.water.absorption(26e3, 20.0)
    assert message.snr == pytest.approx(185.0 - lost - 40.0 - 10.0 * math.log10(4e3), abs=0.05)
    assert message.range is None


def test_a_tick_needs_the_water_only_when_something_begins_or_ends():
    """All others are made by compiled code alone; the message is heard in the very same tick."""
    found = []
    for at_once in (480, 1):
        world = world_of(FAR)
        world.command("a/modem/send", destination=2, data=b"hello")
        samples = []
        for _ in range(480 // at_once):
            samples += world.step(at_once)
        found.append(heard(samples))
        assert found[-1]
        assert 0 < world.stops["led bodies and modems"] < 20
    assert found[0] == found[1]


def test_an_answer_tells_the_range():
    world = world_of(FAR, ideal=True)
    world.command("a/modem/send", destination=2, data=b"x", acknowledge=1)
    told = listen(world, 3.0)
    assert [(m.by, m.event) for m in told] == [("b", "data"), ("a", "delivered")]
    away = math.dist(world.vehicles["a"].p_NB, world.vehicles["b"].p_NB)
    assert told[1].range == pytest.approx(away, abs=1e-2)
    # There and back, with both packets and the turn-around between.
    assert told[1].t == pytest.approx(2.0 * 1500.0 / speed(world) + 8 / 1e4 + 0.1, abs=1e-4)
    assert (told[1].source, told[1].destination, told[1].data) == (1, 2, b"")


def test_ranging_alone_needs_no_data_and_has_the_error_of_a_travel_time():
    world = world_of(FAR, source_level_db=170.0)
    ranges = []
    for _ in range(40):
        world.command("a/modem/send", destination=2, acknowledge=1)
        told = listen(world, 2.5)
        ranges.append(told[-1].range - math.dist(world.vehicles["a"].p_NB, world.vehicles["b"].p_NB))
    sigma = 0.5 * math.sqrt(2.0) * speed(world) / (4e3 * math.sqrt(10.0 ** (0.1 * told[-1].snr)))
    assert np.std(ranges) == pytest.approx(sigma, rel=0.4)


def test_a_moving_receiver_is_met_where_it_is_by_then():
    world = world_of(FAR, ideal=True)
    world.vehicles["b"].hydro.state[world.vehicles["b"].row, 7] = 5.0  # m/s away, and slowed by the water
    track = []
    world.command("a/modem/send", destination=2, data=b"x")
    told = []
    while not told:
        told = listen(world, 1.0 / 240)
        track.append((world.t_ns / 1e9, world.vehicles["b"].p_NB[0]))
    times, places = np.array(track).T
    there = np.interp(told[0].t, times, places)
    assert there > 1500.5
    assert told[0].t == pytest.approx(there / speed(world), abs=2e-6)


def test_nobody_at_an_address_is_told_to_who_asked_for_an_answer():
    world = world_of(FAR, retries=1)
    world.command("a/modem/send", destination=9, data=b"nobody")
    assert listen(world, 3.0) == []
    world.command("a/modem/send", destination=9, data=b"anybody", acknowledge=1)
    told = listen(world, 15.0)
    assert [(m.event, m.source, m.destination, m.data) for m in told] == [("failed", 1, 9, b"anybody")]
    assert counts(world, "a") == {"sent": 3, "unanswered": 1}
    assert counts(world, "b") == {}


def test_a_broadcast_reaches_all():
    world = world_of(TRIO)
    world.command("a/modem/send", data=b"all")
    assert sorted(m.by for m in listen(world, 2.0)) == ["b", "c"]


def test_packets_that_overlap_at_a_receiver_are_lost_unless_one_is_louder():
    alike = {"a": (0.0, -700.0, 20.0), "b": (0.0, 0.0, 20.0), "c": (0.0, 700.0, 20.0)}
    long = bytes(60)
    world = world_of(alike, overhead_s=0.5)
    world.command("a/modem/send", destination=2, data=long)
    world.command("c/modem/send", destination=2, data=long)
    assert listen(world, 3.0) == []
    assert counts(world, "b") == {"collided": 2}
    near = alike | {"c": (0.0, 70.0, 20.0)}
    world = world_of(near, overhead_s=0.5)
    world.command("a/modem/send", destination=2, data=long)
    world.command("c/modem/send", destination=2, data=long)
    assert [(m.by, m.source) for m in listen(world, 3.0)] == [("b", 3)]
    assert counts(world, "b") == {"heard": 1, "collided": 1}


def test_packets_that_follow_each_other_do_not_collide():
    alike = {"a": (0.0, -700.0, 20.0), "b": (0.0, 0.0, 20.0), "c": (0.0, 700.0, 20.0)}
    world = world_of(alike, overhead_s=0.1)
    world.command("a/modem/send", destination=2, data=b"1")
    told = listen(world, 0.125)
    world.command("c/modem/send", destination=2, data=b"2")
    told += listen(world, 3.0)
    assert [m.data for m in told] == [b"1", b"2"]


def test_other_bands_and_protocols_are_not_heard():
    modems = {"a": modem(1), "b": modem(2, frequency_hz=40e3), "c": modem(3, protocol="other")}
    world = world_with(TRIO, modems)
    world.command("a/modem/send", data=b"x")
    assert listen(world, 3.0) == []
    assert counts(world, "b") == counts(world, "c") == {}


def test_sound_of_another_make_in_the_band_disturbs():
    alike = {"a": (0.0, -700.0, 20.0), "b": (0.0, 0.0, 20.0), "c": (0.0, 700.0, 20.0)}
    world = world_with(
        alike,
        {"a": modem(1, overhead_s=0.5), "b": modem(2, overhead_s=0.5), "c": modem(3, protocol="other", overhead_s=0.5)},
    )
    world.command("a/modem/send", destination=2, data=bytes(60))
    world.command("c/modem/send", data=bytes(60))
    assert listen(world, 3.0) == []
    assert counts(world, "b") == {"collided": 1}


def test_who_sends_is_deaf():
    world = world_of(FAR, overhead_s=2.0)
    world.command("a/modem/send", destination=2, data=b"1")
    world.command("b/modem/send", destination=1, data=b"2")
    assert listen(world, 5.0) == []
    assert counts(world, "a") == counts(world, "b") == {"sent": 1, "deaf": 1}


def test_messages_wait_while_it_sends_and_then_it_is_busy():
    world = world_of(FAR, queue=2, overhead_s=0.2)
    refused = []
    for k in range(4):
        world.command("a/modem/send", destination=2, data=bytes([k]))
    replies = []
    for posted in world.requests.posted:
        posted.on_reply = replies.append
    told = listen(world, 4.0)
    refused = [reply.fault for reply in replies if reply.fault is not None]
    assert [m.data for m in told] == [b"\0", b"\1", b"\2"]
    assert len(refused) == 1
    assert "is busy: it sends until" in refused[0].text
    assert "2 messages wait already" in refused[0].text


def test_an_answer_that_was_lost_lets_no_message_come_twice():
    # B answers while A sends again, so that A does not hear it.
    world = world_of(FAR, retries=2)
    world.command("a/modem/send", destination=2, data=b"once", acknowledge=1)
    listen(world, 1.05)
    state, row, told = world.vehicles["a"].hydro.state, world.vehicles["a"].row, []
    for _ in range(24):  # in the air the answer is lost
        state[row, :3], state[row, 7:] = (0.0, 0.0, -3.0), 0.0
        told += listen(world, 0.1)
    state[row, :3], state[row, 7:] = (0.0, 0.0, 20.0), 0.0
    told += listen(world, 12.0)
    assert [m.event for m in told if m.by == "b"] == []
    assert [m.event for m in told if m.by == "a"] == ["delivered"]
    assert counts(world, "b")["heard"] == 1
    assert counts(world, "b")["sent"] == 2


def test_in_air_nothing_is_sent_or_heard():
    world = world_of(FAR | {"a": (0.0, 0.0, -3.0)})
    world.command("a/modem/send", destination=2, data=b"x")
    world.command("b/modem/send", destination=1, data=b"x")
    for _ in range(24):
        world.vehicles["a"].hydro.state[world.vehicles["a"].row, 2] = -3.0
        assert listen(world, 0.1) == []


def test_a_wall_hides_and_a_hull_does_not(tmp_path):
    file = tmp_path / "wall.toml"
    text = """
schema = 1
[structures.thing]
kind = "box"
size_m = [1.0, {width}, {width}]
position_ned_m = [750.0, 0.0, 20.0]
"""
    for k, place in ((1, 0.0), (2, 1500.0)):
        text += f"""
[vehicles.v{k}]
model = "bluerov2_heavy"
position_ned_m = [{place}, 0.0, 20.0]
[vehicles.v{k}.sensors.modem]
kind = "acoustic_modem"
rate_hz = 1
address = {k}
bits_per_s = 1e4
max_range_m = 4000
noise_level_db = 40
"""
    found = []
    for width in (1.0, 30.0):
        file.write_text(text.replace("{width}", str(width)))
        world = build(load(file, adapters={}))
        world.command("v1/modem/send", destination=2, data=b"x")
        found.append(len(listen(world, 2.0)))
    assert found == [1, 0]


def test_losses_follow_the_packet_error_rate():
    world = world_of(FAR, source_level_db=143.5, threshold_db=-30.0, bits_per_s=500.0)
    sensor = world.sensors["b/modem/received"].sensor
    told = []
    for _ in range(300):
        world.command("a/modem/send", destination=2, data=bytes(8))
        told += listen(world, 0.2)
        world.vehicles["a"].hydro.state[:, :3] = ((0.0, 0.0, 20.0), (1500.0, 0.0, 20.0))
    told += listen(world, 2.0)
    rate = sensor.error_rate(10.0 ** (0.1 * told[0].snr), 8)
    assert 0.15 < rate < 0.85
    assert len(told) / 300 == pytest.approx(1.0 - rate, abs=0.09)
    assert counts(world, "b") == {"heard": len(told), "faint": 300 - len(told)}


def test_fading_is_the_same_both_ways_and_comes_in_bursts():
    world = world_of(FAR, fading_sigma_db=6.0, fading_time_s=20.0)
    there, back = [], []
    for _ in range(60):
        world.command("a/modem/send", destination=2, data=b"x")
        world.command("b/modem/send", destination=1, data=b"x")
        for m in listen(world, 2.0):
            (there if m.by == "b" else back).append(m.level)
    assert there == pytest.approx(back, abs=0.1)
    assert np.std(there) == pytest.approx(6.0, rel=0.5)
    steps = np.diff(there)
    assert np.std(steps) < 0.5 * np.std(there)


# -- runs that are the same ------------------------------------------------------------------------------------------------------------


def story(world, seconds=6.0):
    """A conversation with losses."""
    told = []
    for k in range(round(seconds / 0.5)):
        world.command("a/modem/send", destination=2, data=bytes([k]), acknowledge=1)
        if k % 3 == 0:
            world.command("c/modem/send", data=bytes(40))
        told += listen(world, 0.5)
    return told


NOISY = {"source_level_db": 135.0, "threshold_db": -5.0, "fading_sigma_db": 4.0, "bits_per_s": 1000.0}


def test_runs_are_bit_equal_and_others_for_another_seed():
    one, two, other = (world_of(TRIO, seed, **NOISY) for seed in (1, 1, 2))
    told = story(one)
    assert told
    assert told == story(two)
    assert snapshot.take(one).hash() == snapshot.take(two).hash()
    assert story(other) != told


def test_a_snapshot_keeps_what_is_in_the_water():
    world = world_of(TRIO, **NOISY)
    story(world, 2.25)
    kept = snapshot.take(world)
    assert kept.parts["world/modems"].packets
    data = snapshot.to_bytes(world, kept)
    went_on = story(world, 4.0)
    end = snapshot.take(world).hash()
    snapshot.restore(world, kept)
    assert snapshot.take(world) == kept
    assert story(world, 4.0) == went_on
    fresh = world_of(TRIO, **NOISY)
    snapshot.from_bytes(fresh, data)
    assert story(fresh, 4.0) == went_on
    assert snapshot.take(fresh).hash() == end


def test_a_reset_empties_the_water():
    world = world_of(FAR)
    world.command("a/modem/send", destination=2, data=b"x", acknowledge=1)
    listen(world, 0.5)
    world.call("world/reset")
    assert world.parts["world/modems"].save().packets == ()
    assert listen(world, 3.0) == []
    assert counts(world, "a") == {}


def test_states_that_cannot_be_are_refused():
    world = world_of(FAR)
    world.command("a/modem/send", destination=2, data=b"x")
    listen(world, 0.5)
    part = world.parts["world/modems"]
    state = part.save()
    for wrong in (structs.replace(state, packets=()), structs.replace(state, packets=state.packets * 2)):
        with pytest.raises(ValueError, match="packet"):
            part.check(wrong)


# -- who comes and goes ------------------------------------------------------------------------------------------------------------------


def test_a_removed_receiver_hears_nothing_and_a_removed_sender_is_heard():
    world = world_of(TRIO)
    world.command("a/modem/send", data=b"x")
    listen(world, 0.2)
    world.call("world/remove", name="b")
    world.call("world/remove", name="a")
    assert [m.by for m in listen(world, 2.0)] == ["c"]
    assert world.parts["world/modems"].save().legs == ()


def test_who_comes_under_the_name_of_one_that_went_hears_only_what_is_sent_then():
    world = world_of({**TRIO, "d": (0.0, 400.0, 20.0)})
    world.call("world/spawn", name="e", like="b", p_NB=[900.0, 100.0, 20.0])
    world.command("a/modem/send", data=b"x")
    listen(world, 0.1)
    world.call("world/remove", name="e")
    world.call("world/spawn", name="e", like="b", p_NB=[900.0, 100.0, 20.0])
    assert sorted(m.by for m in listen(world, 1.5)) == ["b", "c", "d"]


def test_a_spawned_copy_has_a_modem_that_can_be_given_an_address():
    world = world_of(FAR)
    world.command("a/modem/send", data=b"early")
    listen(world, 0.5)
    world.call("world/spawn", name="d", like="a", p_NB=[700.0, 300.0, 20.0])
    world.call("d/modem/received/set", address=7)
    assert [m.by for m in listen(world, 1.0)] == ["b"]
    world.command("b/modem/send", destination=7, data=b"late")
    assert [(m.by, m.data) for m in listen(world, 2.0)] == [("d", b"late")]
    world.command("d/modem/send", destination=1, data=b"back")
    assert [(m.by, m.source) for m in listen(world, 2.0)] == [("a", 7)]


def test_a_modem_that_is_switched_off_is_deaf_and_dumb():
    world = world_of(FAR)
    world.call("b/modem/received/deactivate")
    world.command("a/modem/send", destination=2, data=b"x")
    world.command("b/modem/send", destination=1, data=b"x")
    assert listen(world, 2.0) == []
    world.call("b/modem/received/activate")
    world.command("a/modem/send", destination=2, data=b"y")
    assert [m.data for m in listen(world, 2.0)] == [b"y"]


def test_nodes_on_what_only_follows_poses():
    """A mooring, or a ship with a known track: an external vehicle, without dynamics."""
    gateway = VehicleEntry(
        kind="external",
        model="otter",
        outside="hold",
        position_ned_m=(1500.0, 0.0, 3.0),
        sensors={"modem": modem(9, ideal=True)},
    )
    auv = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 3.0), sensors={"modem": modem(1, ideal=True)})
    world = build(load(Scenario(schema=1, vehicles={"auv": auv, "gateway": gateway}), adapters={}))
    world.command("auv/modem/send", destination=9, data=b"x", acknowledge=1)
    told = listen(world, 3.0)
    assert [(m.by, m.event) for m in told] == [("gateway", "data"), ("auv", "delivered")]
    assert told[1].range == pytest.approx(1500.0, abs=0.05)


def test_the_medium_is_there_only_where_a_modem_is():
    entry = VehicleEntry(model="bluerov2_heavy")
    world = build(load(Scenario(schema=1, vehicles={"rov": entry}), adapters={}))
    assert "world/modems" not in world.parts


def test_an_idle_modem_costs_no_work(monkeypatch):
    world = world_of(TRIO)
    world.step(2)
    part = world.parts["world/modems"]
    monkeypatch.setattr(type(part), "_schedule", None)  # would fail if anything was looked after
    world.step(480)


def test_directions_of_a_modem_with_an_array():
    modems = {"a": modem(1, direction_sigma_deg=0.0, ideal=True), "b": modem(2, ideal=True)}
    places = {"a": (0.0, 0.0, 20.0), "b": (300.0, 400.0, 120.0)}
    world = world_with(places, modems)
    world.command("b/modem/send", destination=1, data=b"x")
    (told,) = listen(world, 1.0)
    # The vehicle hardly turns in a third of a second.
    assert told.bearing == pytest.approx(math.atan2(400.0, 300.0), abs=2e-3)
    assert told.elevation == pytest.approx(math.atan2(100.0, 500.0), abs=2e-3)


def test_a_ghost_of_the_sound_that_comes_too_late_smears_the_packet():
    """By the surface the sound comes 50 ms later: more than a guard of 10 ms bears, if it is as strong."""
    near = {"a": (0.0, 0.0, 60.0), "b": (100.0, 0.0, 60.0)}
    for guard, expected in ((0.2, ["b"]), (0.01, [])):
        world = world_of(near, propagation="layered", guard_s=guard, bits_per_s=4000.0, coding_gain_db=-10.0)
        world.command("a/modem/send", destination=2, data=bytes(60))
        assert [m.by for m in listen(world, 1.0)] == expected
        assert counts(world, "b") == ({"heard": 1} if expected else {"smeared": 1})


def test_messages_that_wait_to_be_told_are_told_after_a_restore():
    """Two came in one tick: one is told in it, the other in the next."""
    world = world_of(FAR)
    for data in (b"1", b"2"):
        world.command("a/modem/send", destination=2, data=data)
    while len(world.sensors["b/modem/received"].sensor.memory.inbox) != 1:
        told = listen(world, 1.0 / 240)
    assert [m.data for m in told] == [b"1"]
    data = snapshot.to_bytes(world, snapshot.take(world))
    fresh = world_of(FAR)
    snapshot.from_bytes(fresh, data)
    assert [m.data for m in listen(fresh, 2.0 / 240)] == [m.data for m in listen(world, 2.0 / 240)] == [b"2"]
