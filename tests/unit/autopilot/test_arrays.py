"""Autopilots in the same arrays: each is what it is alone, whoever lies beside it, comes or goes; its rows read as typed records.

Also of uwserver.autopilot.entries and uwserver.autopilot.arrays.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec import structs

from uwserver.autopilot.arrays import AutopilotArrays
from uwserver.autopilot.config import Gains
from uwserver.autopilot.flight import BEGIN, DONE, FAILSAFE, PROGRESS, READY
from uwserver.autopilot.mission import Hold
from uwserver.autopilot.route import leave_bottom, set_course
from uwserver.autopilot.state import NAN, NOWHERE, Estimate, Memory, Orders
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.load.scenario import load
from uwserver.world.stepping.piloting import Piloting

STARTS = {
    "rov": ("bluerov2_heavy", (0.0, 0.0, 3.0)),
    "auv": ("remus100", (50.0, 0.0, 10.0)),
    "big": ("rexrov", (0.0, 60.0, 5.0)),
    "pro": ("videoray_pro4", (0.0, -60.0, 5.0)),
}


def world_of(*names, seed=5):
    builder = ScenarioBuilder("autopilots", seed=seed, rate_hz=240, adapters={})
    builder.current(velocity_ned_mps=(0.1, 0.0, 0.0))
    for name in names:
        model, start = STARTS[name]
        builder.vehicle(name, model, position_ned_m=start, autopilot={"start_position_ned_m": start})
        builder.sensor(name, "ahrs", "attitude", rate_hz=40, noise_deg=0.05, heading_sigma_deg=0.3)
    return build(load(builder.build(), adapters={}))


def pilot_of(world, name):
    part = world.parts[f"{name}/autopilot"]
    assert isinstance(part, Piloting)
    return part.pilot


def flown(world, *names):
    """After two seconds of depth_hold on the way to another depth and heading."""
    world.step(240)
    for name in names:
        world.call(f"{name}/autopilot/set_mode", mode="depth_hold")
        world.call(f"{name}/autopilot/arm")
        world.command(f"{name}/autopilot/depth", depth=STARTS[name][1][2] + 1.0)
        world.command(f"{name}/autopilot/heading", heading=0.5)
    world.step(480)
    return world


@pytest.fixture(scope="module")
def together():
    return flown(world_of(*STARTS), *STARTS)


@pytest.mark.parametrize("name", STARTS)
def test_each_flies_as_it_does_alone_bit_for_bit(together, name):
    alone = flown(world_of(name), name)
    assert pilot_of(together, name).row.read() == pilot_of(alone, name).row.read()
    assert any(pilot_of(alone, name).memory.outputs)
    assert together.vehicles[name].p_NB == alone.vehicles[name].p_NB


def test_one_that_goes_takes_its_rows_and_leaves_the_others_theirs():
    world = flown(world_of("auv", "rov"), "auv", "rov")
    gone, kept = pilot_of(world, "auv"), pilot_of(world, "rov").row.read()
    before = gone.row.read()
    world.dismiss("auv")
    assert pilot_of(world, "rov").row.read() == kept
    assert gone.row.read() == before
    flew = world.hydro.thrusters["command"].copy()
    world.step(120)
    assert pilot_of(world, "rov").row.read() != kept
    assert gone.row.read() == before
    assert not (world.hydro.thrusters["command"] == flew).all()


def test_one_that_went_changes_and_hears_for_itself_alone():
    """Its number in the arrays is now that of another one."""
    world = flown(world_of("auv", "rov"), "auv", "rov")
    gone, other = pilot_of(world, "auv"), pilot_of(world, "rov")
    world.dismiss("auv")
    assert gone.row.k == other.row.k == 0
    kept, row = other.row.read(), np.zeros(32 + len(gone.spec.names))
    gone.row.tell(world.t_ns, row)
    assert row[1] == pytest.approx(gone.estimate.p[0])
    gone.hold()
    gone.row.on_sample("auv/ahrs", ((1.0, 0.0, 0.0, 0.0), 0.0), world.t_ns, world.t_ns)
    assert gone.estimate.attitude_ns == world.t_ns
    assert gone.orders.depth == gone.estimate.p[2]
    assert other.row.read() == kept


def test_each_place_in_the_arrays_is_found_after_others_came_and_went():
    """Devices, curves, sensors and beacons lie one after the other, of vehicles with different numbers of them."""
    rows = {name: pilot_of(world_of(name), name).row for name in STARTS}
    arrays, own = AutopilotArrays(), {name: row.read() for name, row in rows.items()}
    ports = [port for row in rows.values() for port in row.spec.inputs.ports]
    streams = {port: 2 * k for k, port in enumerate(ports)}
    for names in (("rov", "auv"), ("big", "rov", "pro"), ("pro",), (), tuple(STARTS)):
        arrays.gather([rows[name] for name in names], streams, 2 * len(streams))
        assert {name: row.read() for name, row in rows.items()} == own
        tables = arrays._kept
        for name in names:
            row = rows[name]
            c, allocation, inputs = row.record["c"], row.spec.allocation, row.spec.inputs
            mine = tables["devices"][c["device_first"] : c["device_first"] + c["device_count"]]
            assert (mine["row"] == allocation.devices["row"]).all()
            if len(allocation.curves):
                assert (
                    tables["curves"][mine["curve_first"]] == allocation.curves[allocation.devices["curve_first"]]
                ).all()
            for n, port in enumerate(inputs.ports):
                sensor = tables["sensors"][tables["listeners"][streams[port]]]
                assert (sensor["pilot"], sensor["kind"], sensor["next"]) == (row.k, inputs.rows["kind"][n], -1)
    assert {row.k for row in rows.values()} == {0, 1, 2, 3}


# -- rows as records -----------------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def row():
    return pilot_of(world_of("rov"), "rov").row


def test_records_come_out_of_a_row_as_they_went_in(row):
    estimate = Estimate(p=(1.0, 2.0, 3.0), leak=True, refused=3, imu_ns=7, flat=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    memory = Memory(push=(1.0, 2.0, 3.0), crab=0.1, outputs=tuple(0.1 * k for k in range(8)))
    orders = Orders(
        gains=Gains(depth_p=0.7), mode="guided", armed=True, pilot="lost", given=("depth", "place"), frame="N", attitude=(1.0, 0.0, 0.0, 0.0),
        looks=True, test=(0.5,) * 8, failsafe="sensor depth", turn_limit=math.inf, index=-1,
    )  # fmt: skip
    row.write(estimate, memory, orders)
    assert row.read() == (estimate, memory, orders)
    assert (row.orders.mode, row.orders.given, row.orders.armed) == ("guided", ("depth", "place"), True)
    row.orders.attitude, row.orders.test = None, ()
    assert row.read()[2] == structs.replace(orders, attitude=None, test=())
    # What is no number is the same everywhere, so that records can be compared.
    assert row.orders.place is not NOWHERE
    assert row.orders.place == NOWHERE
    assert row.orders.speed is NAN


def test_what_it_is_can_be_copied_read_and_put_back(row):
    estimate, memory = Estimate(p=(1.0, math.nan, 3.0), leak=True), Memory(tau=(1.0,) * 6, outputs=(0.25,) * 8)
    orders = Orders(gains=Gains(depth_p=0.7), mode="mission", items=(Hold(time_s=5.0),), index=0, test=(0.5,) * 8)
    row.write(estimate, memory, orders)
    kept, written = row.save(), row.read()
    assert row.records(kept) == written
    assert row.load(kept) is False
    row.write(Estimate(), Memory(), Orders(gains=Gains(), mode="mission"))
    assert row.read() != written
    assert row.records(kept) == written
    assert row.load(kept) is False  # neither the mode nor who commands the actuators is another one
    assert row.read() == written
    assert row.save() == kept
    row.orders.armed = True
    assert row.load(kept) is True
    assert not row.orders.armed


def test_a_field_that_a_record_has_not_is_no_attribute(row):
    with pytest.raises(AttributeError, match="Orders has no depht"):
        _ = row.orders.depht
    with pytest.raises(AttributeError, match="Orders has no depht"):
        row.orders.depht = 1.0


def test_a_course_is_set_with_all_that_belongs_to_it(row):
    before = Orders(
        gains=Gains(cruise_mps=0.7), mode="guided", given=("altitude",), frame="N", attitude=(1.0, 0.0, 0.0, 0.0), heading=0.5, looks=False,
        settled=True, astray=True, turn=0.1, turn_limit=0.2, blind=True, failsafe="sensor altitude", velocity=(1.0, 2.0, 3.0), altitude=4.0,
    )  # fmt: skip
    row.write(Estimate(p=(1.0, 2.0, 3.0)), Memory(), before)
    set_course(row.orders, row.estimate, (10.0, 20.0, 30.0), None, None, 2.0)
    went = structs.replace(
        before, origin=(1.0, 2.0, 3.0), place=(10.0, 20.0, 30.0), depth=30.0, given=("altitude", "depth", "heading", "place"), looks=True, speed=0.7,
        radius=2.0, frame="", attitude=None, settled=False, astray=False, turn=NAN, turn_limit=math.inf,
    )  # fmt: skip
    assert row.read()[2] == went
    set_course(row.orders, row.estimate, (10.0, 20.0, 30.0), 1.5, 0.3, 2.0)
    assert row.read()[2] == structs.replace(went, heading=1.5, looks=False, speed=0.3)
    leave_bottom(row.orders)
    left = row.read()[2]
    assert (left.given, left.blind, left.failsafe) == (("depth", "heading", "place"), False, "")
    row.orders.failsafe = "battery"
    leave_bottom(row.orders)
    assert row.orders.failsafe == "battery", "of another reason"


def test_what_does_not_fit_changes_nothing(row):
    row.orders.place, row.orders.depth, row.orders.index = (1.0, 2.0, 3.0), 4.0, 5
    kept = row.read()
    for name, value in (
        ("place", (1.0, 2.0)),
        ("place", 7.0),
        ("place", (1.0, None, 3.0)),
        ("depth", None),
        ("index", 1.5),
        ("mode", "none"),
    ):
        with pytest.raises((TypeError, ValueError)):
            setattr(row.orders, name, value)
        assert row.read() == kept
    row.orders.place, row.orders.depth, row.orders.index, row.orders.armed = (
        np.arange(3.0),
        np.float64(6.0),
        np.int64(7),
        np.True_,
    )
    assert (row.orders.place, row.orders.depth, row.orders.index, row.orders.armed) == (
        (0.0, 1.0, 2.0),
        6.0,
        7,
        True,
    )


# -- what a step needs of python --------------------------------------------------------------------------------------------------------------


def needs_of(monkeypatch, world, name):
    """What the autopilot is asked to do, as it goes on."""
    pilot, needs = pilot_of(world, name), []
    handle = pilot._handle
    monkeypatch.setattr(pilot, "_handle", lambda need: needs.append(need) or handle(need))
    return needs


def test_a_step_stops_for_what_is_rare_and_for_nothing_else(monkeypatch):
    world = world_of("rov")
    needs = needs_of(monkeypatch, world, "rov")
    world.step(240)
    assert needs == []
    world.call(
        "rov/autopilot/set_mission", items=[{"kind": "hold", "time_s": 0.5}, {"kind": "heading", "heading_deg": 0}]
    )
    pilot_of(world, "rov").orders.mode = "mission"
    world.call("rov/autopilot/arm", force=True)
    world.step(8)
    assert needs == [FAILSAFE]  # there is no position: depth_hold is the refuge
    assert pilot_of(world, "rov").orders.failsafe == "sensor position"
    needs.clear()
    world.step(240)
    assert needs == []


def test_items_of_a_mission_begin_and_end_in_python(monkeypatch, fly):
    world = fly("bluerov2").world
    needs = needs_of(monkeypatch, world, "v")
    items = [{"kind": "speed", "speed_mps": 0.3}, {"kind": "hold", "time_s": 0.49}]
    world.call("v/autopilot/arm")
    world.call("v/autopilot/set_mission", items=items)
    world.call("v/autopilot/start_mission")
    world.step(4)
    assert needs == [BEGIN, DONE]
    world.step(4)
    assert needs == [BEGIN, DONE, BEGIN]
    assert pilot_of(world, "v").orders.waited == pytest.approx(1.0 / 60.0)
    # A mission that was restored in the middle of an item goes on with it.
    kept = world.parts["v/autopilot"].save()
    world.call("v/autopilot/set_mission", items=[{"kind": "waypoint", "position_ned_m": [50, 0, 3]}])
    world.call("v/autopilot/start_mission")
    world.step(4)
    world.parts["v/autopilot"].load(kept)
    needs.clear()
    world.step(28 * 4)
    assert needs == []
    world.step(4)
    assert needs == [DONE]


def test_a_way_is_told_of_twice_a_second(monkeypatch, fly):
    f = fly("bluerov2")
    needs = needs_of(monkeypatch, f.world, "v")
    f.call("arm")
    answers = f.post("goto", position_ned_m=[5.0, 0.0, 3.0])
    f.run(2.2)
    assert needs == [PROGRESS] * 4
    assert len(answers) == 4


def test_one_that_waits_for_its_sensors_is_told_when_they_have_spoken(monkeypatch):
    builder = ScenarioBuilder("waits", rate_hz=240, adapters={})
    builder.vehicle("rov", "bluerov2", position_ned_m=(0, 0, 3), autopilot={"armed": True, "mode": "stabilise"})
    builder.sensor("rov", "ahrs", "attitude", rate_hz=40)
    world = build(load(builder.build(), adapters={}))
    needs = needs_of(monkeypatch, world, "rov")
    world.step(24)
    assert needs == [READY]
