"""Sticks, buttons, RC override, and the fail-safes of pilot, ground station, leak and battery."""

from __future__ import annotations

import asyncio

import pytest

from uwserver.ports import Event, Refused


def steer(station, x=0, y=0, z=500, r=0, buttons=0, **more):
    station.send("MANUAL_CONTROL", 1, x, y, z, r, buttons, **more)


@pytest.mark.parametrize(
    ("sticks", "u"),
    [
        ({}, (0, 0, 0, 0, 0, 0)),
        ({"x": 1000}, (0.5, 0, 0, 0, 0, 0)),
        ({"y": -1000}, (0, -0.5, 0, 0, 0, 0)),
        ({"z": 0}, (0, 0, 0.5, 0, 0, 0)),
        ({"z": 1000}, (0, 0, -0.5, 0, 0, 0)),
        ({"r": 400}, (0, 0, 0, 0, 0, 0.2)),
        ({"s": 1000, "t": -1000, "enabled_extensions": 3}, (0, 0, 0, -0.5, 0.5, 0)),
        ({"s": 1000, "t": -1000}, (0, 0, 0, 0, 0, 0)),
    ],
)
def test_sticks_at_the_default_gain(bench, sticks, u):
    steer(bench.station(), **sticks)
    assert bench.rov.commanded("pilot")[-1]["u"] == pytest.approx(u, abs=2e-3)


def test_full_gain_is_full_stick_and_no_more(make_bench):
    bench = make_bench(parameters={"JS_GAIN_DEFAULT": 1.0, "JS_THR_GAIN": 4.0})
    steer(bench.station(), x=1000, z=0)
    assert bench.rov.commanded("pilot")[-1]["u"] == pytest.approx((1, 0, 1, 0, 0, 0))


@pytest.mark.parametrize("sticks", [{"x": 32767}, {"r": -1001}, {"z": 30_000}])
def test_an_axis_out_of_range_is_ignored(bench, sticks):
    steer(bench.station(), **sticks)
    assert not bench.rov.commanded("pilot")


def test_only_the_station_in_charge_steers(bench):
    steer(bench.station(254), x=1000)
    bench.station().send("MANUAL_CONTROL", 0, 1000, 0, 500, 0, 0)
    bench.station(254).send("RC_CHANNELS_OVERRIDE", 1, 1, *(1900,) * 18)
    assert not bench.rov.commanded("pilot")
    assert bench.counters["not_in_charge"] == 3
    bench.vehicle.parameters.set("MAV_GCS_SYSID", 254)
    steer(bench.station(254), x=1000)
    assert bench.rov.commanded("pilot")


async def test_buttons_act_on_their_edge(bench):
    station = bench.station()
    for _ in range(3):
        steer(station, buttons=1 << 6)  # BTN6: arm
    await asyncio.sleep(0.01)
    assert [c.service for c in bench.rov.calls] == ["rov/autopilot/arm"]
    steer(station, buttons=1 << 3)  # BTN3: depth hold
    await asyncio.sleep(0.01)
    assert bench.rov.state["mode"] == "depth_hold"
    steer(station, buttons=1 << 4)  # BTN4: disarm
    await asyncio.sleep(0.01)
    assert not bench.rov.state["armed"]


def test_shift_gain_hold_lights_and_camera(bench):
    station, pilot, payload = bench.station(), bench.vehicle.pilot, bench.vehicle.payload
    steer(station, buttons=1 << 11)  # gain up
    assert pilot.gain == pytest.approx(0.75)
    assert "#Gain is at 75%" in station.texts()
    steer(station, buttons=1 << 14)  # lights brighter
    assert payload.lights[0] == pytest.approx(1 / 8)
    steer(station, buttons=1 << 5)  # shift
    steer(station, buttons=1 << 5 | 1 << 14)  # shifted: trim of the roll
    assert pilot.channels[1] == 1510
    assert payload.lights[0] == pytest.approx(1 / 8)
    steer(station, buttons=1 << 5 | 1 << 13)  # and back
    steer(station, buttons=1 << 10)
    assert payload.tilt == 5.0
    steer(station, x=1000)
    steer(station, x=1000, buttons=1 << 8)  # hold the input
    steer(station)
    assert pilot.deflections[0] == pytest.approx(0.75, abs=2e-3)
    steer(station, buttons=1 << 8)
    steer(station)
    assert pilot.deflections[0] == pytest.approx(0.0)
    bench.run(1.0)
    told = {m.name: m.value for m in station.of("NAMED_VALUE_FLOAT")}
    assert told == pytest.approx(
        {"CamTilt": 0.5 - 2.5 / 45.0, "CamPan": 0.5, "TetherTrn": 0.0, "Lights1": 0.125, "Lights2": 0.0, "PilotGain": 0.75,
         "InputHold": 0.0, "RollPitch": 0.0, "RFTarget": 0.0}
    )  # fmt: skip


def test_rc_override(bench):
    station = bench.station()
    station.send("RC_CHANNELS_OVERRIDE", 1, 1, 65535, 65535, 1400, 1600, 1900, 900, *(65535,) * 12)
    assert bench.rov.commanded("pilot")[-1]["u"] == pytest.approx((1.0, -1.0, 0.25, 0, 0, 0.25))
    station.send("RC_CHANNELS_OVERRIDE", 1, 1, 65535, 65535, 0, 65535, 65535, 0, *(0,) * 12)
    assert bench.rov.commanded("pilot")[-1]["u"] == pytest.approx((1.0, 0, 0, 0, 0, 0.25))
    bench.run(1.0)
    assert len(bench.rov.commanded("pilot")) >= 8  # said again, for the watchdog of the port
    rc = station.last("RC_CHANNELS")
    assert (rc.chan3_raw, rc.chan4_raw, rc.chan5_raw) == (1500, 1600, 1900)


def test_a_lost_pilot(make_bench):
    bench = make_bench()
    station = bench.station()
    bench.rov.state["armed"] = True
    bench.run(1.0)
    steer(station, x=1000)
    bench.run(2.5)
    assert "Lost manual control" not in station.texts()
    bench.run(1.5)
    assert station.texts().count("Lost manual control") == 1
    assert bench.rov.commanded("pilot")[-1]["u"] == pytest.approx((0,) * 6)
    assert bench.rov.calls[-1].service == "rov/autopilot/disarm"  # FS_PILOT_INPUT = 2
    bench.run(1.0)
    assert station.last("HEARTBEAT").system_status == 5
    steer(station)
    bench.run(1.1)
    assert station.last("HEARTBEAT").system_status in (3, 4)


def test_sticks_are_never_said_again_and_spring_back(make_bench):
    bench = make_bench(parameters={"FS_PILOT_INPUT": 0})
    station = bench.station()
    steer(station, x=1000)
    bench.run(2.5)
    assert len(bench.rov.commanded("pilot")) == 1  # the watchdog of the port must see that nobody steers
    bench.run(1.0)
    assert [value["u"][0] for value in bench.rov.commanded("pilot")] == pytest.approx([0.5, 0.0], abs=2e-3)
    assert station.last("RC_CHANNELS").chan5_raw == 1500


async def test_sticks_of_before_do_not_move_an_armed_vehicle(bench):
    station = bench.station()
    for arm in (1.0, 0.0):
        steer(station, z=0)
        assert bench.rov.commanded("pilot")[-1]["u"][2] == pytest.approx(0.5)
        assert await station.command(400, arm) == 0
        assert bench.rov.commanded("pilot")[-1]["u"] == pytest.approx((0,) * 6)


def test_an_override_that_is_not_renewed_ends(make_bench):
    bench = make_bench(parameters={"FS_PILOT_INPUT": 0})
    station = bench.station()
    station.send("RC_CHANNELS_OVERRIDE", 1, 1, *(65535,) * 4, 1900, *(65535,) * 13)
    bench.run(4.0)
    sent = [value["u"][0] for value in bench.rov.commanded("pilot")]
    assert sent[-1] == 0.0
    assert 25 < sent.count(1.0) < 35
    bench.run(1.0)
    assert len(bench.rov.commanded("pilot")) == len(sent)


async def test_a_pilot_who_went_before_the_vehicle_was_armed_is_no_loss(make_bench):
    bench = make_bench(parameters={"FS_GCS_ENABLE": 0})
    station = bench.station()
    steer(station, x=1000)
    bench.run(2.0)
    assert await station.command(400, 1.0) == 0
    bench.run(5.0)
    assert bench.rov.state["armed"]
    assert "Lost manual control" not in station.texts()


@pytest.mark.parametrize(("action", "service"), [(1, None), (2, "disarm"), (3, "set_mode"), (4, "set_mode")])
async def test_a_lost_ground_station(make_bench, action, service):
    bench = make_bench(parameters={"FS_GCS_ENABLE": action, "FS_PILOT_INPUT": 0})
    station = bench.station()
    bench.rov.state["armed"] = True
    station.send("HEARTBEAT", 6, 8, 0, 0, 4, 3)
    bench.run(4.5)
    assert not station.texts()
    bench.run(1.0)
    await asyncio.sleep(0.01)
    assert "MYGCS: 255, heartbeat lost" in station.texts()
    assert [c.service.split("/")[-1] for c in bench.rov.calls] == ([service] if service else [])
    if service == "set_mode":
        assert bench.rov.state["mode"] == ("depth_hold" if action == 3 else "surface")
    station.send("HEARTBEAT", 6, 8, 0, 0, 4, 3)
    assert "GCS Failsafe Cleared" in station.texts()


async def test_a_ground_station_that_is_lost_disarms_as_ardusub_has_it_by_default(bench):
    station = bench.station()
    bench.rov.state["armed"] = True
    bench.run(20.0)
    assert not station.texts()  # none was there, so none is missed
    station.send("HEARTBEAT", 6, 8, 0, 0, 4, 3)
    bench.run(4.5)
    assert bench.rov.state["armed"]
    bench.run(1.0)
    await asyncio.sleep(0.01)
    assert not bench.rov.state["armed"]
    bench.run(36.0)
    assert station.texts().count("MYGCS: 255, heartbeat lost") == 2  # each 30 s


async def test_a_vehicle_that_is_armed_while_its_ground_station_is_lost_fails_safe_then(bench):
    station, other = bench.station(), bench.station(254)
    station.send("HEARTBEAT", 6, 8, 0, 0, 4, 3)
    bench.run(8.0)
    assert await other.command(400, 1.0) == 0
    bench.run(0.2)
    await asyncio.sleep(0.01)
    assert not bench.rov.state["armed"]


async def test_a_fail_safe_whose_mode_cannot_be_had_disarms(make_bench):
    bench = make_bench(parameters={"FS_GCS_ENABLE": 3})
    bench.rov.state["armed"] = True

    def no_depth(_):
        raise Refused("denied", "depth_hold has no depth: it needs a valid sensor")

    bench.rov.scripts["rov/autopilot/set_mode"] = no_depth
    station = bench.station()
    station.send("HEARTBEAT", 6, 8, 0, 0, 4, 3)
    bench.run(6.0)
    await asyncio.sleep(0.01)
    assert not bench.rov.state["armed"]
    assert "Failsafe action failed: ALT_HOLD has no depth: it needs a valid sensor" in station.texts()


async def test_overrides_are_heartbeats_of_the_ground_station(make_bench):
    bench = make_bench(parameters={"FS_PILOT_INPUT": 0})
    station = bench.station()
    bench.rov.state["armed"] = True
    station.send("HEARTBEAT", 6, 8, 0, 0, 4, 3)
    for _ in range(10):
        station.send("RC_CHANNELS_OVERRIDE", 1, 1, *(1500,) * 18)
        bench.run(1.0)
    assert bench.rov.state["armed"]
    assert not station.texts()


def test_one_lost_stick_is_told_once(bench):
    """What the world says of it too: the watchdog of the port, the autopilot's own fail-safe, that it was disarmed."""
    station = bench.station()
    bench.rov.state["armed"] = True
    bench.run(1.0)
    steer(station, x=1000)
    bench.run(1.5)
    voice = '"rov/autopilot"'
    bench.rov.say(Event("watchdog", 1, 1, 'no command for "rov/autopilot/pilot" in 1 s: it went to neutral'))
    bench.rov.say(Event("autopilot", 1, 1, f"{voice} fail-safe: no command from the pilot, the sticks are neutral"))
    bench.rov.state["failsafe"] = "pilot"
    bench.run(2.5)
    bench.rov.state |= {"failsafe": "", "armed": False}
    bench.rov.say(Event("autopilot", 1, 1, f"{voice} disarmed"))
    bench.run(1.0)
    assert station.texts() == ["Lost manual control"]


def test_what_other_vehicles_autopilots_say_is_not_ours(bench):
    station = bench.station()
    bench.rov.say(Event("autopilot", 1, 1, '"rov2/autopilot" the test of the actuators is over'))
    bench.rov.say(Event("autopilot", 1, 1, '"rov/autopilot" the test of the actuators is over'))
    assert station.texts() == ["the test of the actuators is over"]


def test_a_leak_is_told_again_and_again(make_bench):
    bench = make_bench(parameters={"FS_LEAK_ENABLE": 2})
    station = bench.station()
    bench.rov.state["armed"] = True
    bench.run(1.0)
    bench.rov.said["leak"]["leak"] = True
    bench.run(21.0)
    assert station.texts().count("Leak Detected") == 2
    assert [c.args["mode"] for c in bench.rov.calls] == ["surface"]
    assert station.last("HEARTBEAT").system_status == 5


def test_an_empty_battery(make_bench):
    bench = make_bench(parameters={"BATT_LOW_VOLT": 14.0, "BATT_FS_LOW_ACT": 3})
    station = bench.station()
    bench.rov.state["armed"] = True
    bench.rov.said["battery"]["voltage"] = 13.5
    bench.run(1.0)
    assert station.texts() == ["Battery 1 is low 13.50V"]
    assert [c.args["mode"] for c in bench.rov.calls] == ["surface"]


def test_the_autopilot_has_failsafes_of_its_own(bench):
    station = bench.station()
    bench.rov.state["failsafe"] = "sensor depth"
    bench.run(1.1)
    assert station.texts() == ["Failsafe: sensor depth"]
    assert station.last("HEARTBEAT").system_status == 5


def test_time_that_begins_anew_lets_the_sticks_go(bench):
    station = bench.station()
    bench.run(5.0)
    steer(station, x=1000)
    bench.rov.tick, bench.rov.until_s = 0, 0.0
    bench.rov.say(Event("reset", 0, 0, "the world was reset"))
    assert bench.rov.commanded("pilot")[-1]["u"] == pytest.approx((0,) * 6)
    before = len(station.of("ATTITUDE"))
    bench.run(1.0)
    assert len(station.of("ATTITUDE")) == before + 11
    assert station.last("SYSTEM_TIME").time_boot_ms <= 1000
