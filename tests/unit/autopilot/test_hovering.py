"""Step responses of vehicles that hover, on simulated sensors: how near, how steady, in a current and at their limits.

Also of uwserver.autopilot.hover and uwserver.autopilot.sticks.
"""

from __future__ import annotations

import math

import pytest

from uwserver.frames import rpy_from_quat

ROVS = ("bluerov2", "bluerov2_heavy", "rexrov")


def settled(flight, mode, **set_points):
    flight.call("set_mode", mode=mode)
    flight.call("arm")
    for port, value in set_points.items():
        flight.send(port, **value)


@pytest.mark.parametrize("model", ROVS)
def test_depth_and_heading_are_reached_and_kept(fly, model):
    f = fly(model, start=(0.0, 0.0, 5.0), current=(0.1, 0.1, 0.0))
    settled(f, "depth_hold", depth={"depth": 8.0}, heading={"heading": 1.0})
    f.run(30.0)
    depths = []
    for _ in range(10):
        f.run(1.0)
        depths.append(f.vehicle.p_NB[2])
        assert f.off_heading(1.0) < 2.0
        assert max(abs(a) for a in f.vehicle.pose.rpy[:2]) < math.radians(5.0)
    # The depth sensor of the shipped ROVs has an offset of 2 cm.
    assert max(abs(d - 8.0) for d in depths) < 0.1
    state = f.state
    assert state["depth_ref"] == 8.0
    assert state["heading_ref"] == pytest.approx(1.0)
    assert state["mode"] == "depth_hold"


def test_a_step_of_depth_overshoots_little(fly):
    f = fly("bluerov2_heavy")
    settled(f, "depth_hold", depth={"depth": 6.0})
    deepest = 0.0
    for _ in range(100):
        f.run(0.2)
        deepest = max(deepest, f.vehicle.p_NB[2])
    assert 5.9 < deepest < 6.2


@pytest.mark.parametrize("model", ROVS)
def test_position_is_held_in_a_current(fly, model):
    f = fly(model, start=(2.0, -1.0, 5.0), current=(0.15, 0.2, 0.0), yaw_deg=70.0)
    settled(f, "position_hold")
    f.run(10.0)
    worst = 0.0
    for _ in range(20):
        f.run(1.0)
        worst = max(worst, math.dist(f.vehicle.p_NB[:2], (2.0, -1.0)))
    assert worst < 0.5
    # It was pushed round a little before it was armed.
    assert f.off_heading(f.state["heading_ref"]) < 2.0


@pytest.mark.parametrize("model", [*ROVS, "girona500", "lbv150", "minerva", "videoray_pro4"])
def test_a_step_of_heading_overshoots_little(fly, model):
    f = fly(model)
    settled(f, "depth_hold", heading={"heading": math.pi / 2})
    furthest = 0.0
    for _ in range(60):
        f.run(0.2)
        furthest = max(furthest, f.heading)
    assert math.radians(88.0) < furthest < math.radians(98.0)
    assert f.off_heading(math.pi / 2) < 2.0


@pytest.mark.parametrize(("start", "wanted"), [(170.0, -170.0), (-170.0, 170.0)])
def test_it_turns_the_short_way_across_south(fly, start, wanted):
    f = fly("bluerov2", yaw_deg=start)
    settled(f, "depth_hold", heading={"heading": math.radians(wanted)})
    furthest = 0.0
    for _ in range(20):
        f.run(0.2)
        furthest = max(furthest, f.off_heading(math.radians(wanted)))
    assert furthest < 21.0
    assert f.off_heading(math.radians(wanted)) < 3.0


@pytest.mark.parametrize("current", [(0.0, -0.5, 0.0), (0.3, 0.3, 0.0)])
def test_a_vehicle_without_thrust_sideways_turns_to_its_place_and_is_not_carried_away(fly, current):
    # It circles the place, 6 to 9 m away, as it can push only along its bow; a current of 0.5 m/s would carry it 50 m in this time.
    f = fly("videoray_pro4", start=(2.0, -1.0, 5.0), current=current)
    settled(f, "position_hold")
    worst = 0.0
    for _ in range(100):
        f.run(1.0)
        worst = max(worst, math.dist(f.vehicle.p_NB[:2], (2.0, -1.0)))
    assert worst < 10.0


def test_position_set_point_is_reached_with_its_heading(fly):
    f = fly("bluerov2_heavy")
    settled(f, "position_hold", position={"p_N": [2.0, 1.0, 4.0], "heading": -0.5})
    f.run(25.0)
    assert f.vehicle.p_NB == pytest.approx((2.0, 1.0, 4.0), abs=0.25)
    assert f.off_heading(-0.5) < 2.0
    assert f.state["p_ref_N"] == (2.0, 1.0, 4.0)


@pytest.mark.parametrize("model", ROVS)
def test_velocity_is_followed_over_ground_in_a_current(fly, model):
    f = fly(model, current=(0.1, 0.0, 0.0), start=(0.0, 0.0, 6.0))
    settled(f, "velocity")
    f.run(12.0, velocity={"v_N": [0.2, 0.1, 0.0], "heading": 0.5})
    before = f.vehicle.p_NB
    f.run(10.0, velocity={"v_N": [0.2, 0.1, 0.0], "heading": 0.5})
    moved = [(b - a) / 10.0 for a, b in zip(before, f.vehicle.p_NB, strict=True)]
    assert moved == pytest.approx([0.2, 0.1, 0.0], abs=0.03)
    assert f.off_heading(0.5) < 2.0


def test_velocity_in_body_axes_turns_with_the_vehicle_and_stops_without_commands(fly):
    f = fly("bluerov2_heavy")
    settled(f, "velocity")
    f.run(10.0, velocity={"v_B": [0.2, 0.0, 0.1], "yaw_rate": 0.1})
    assert f.heading == pytest.approx(1.0, abs=0.15)
    assert f.vehicle.nu[0] == pytest.approx(0.2, abs=0.04)
    # It follows the speed through the water and the depth: 0.1 m/s down.
    assert f.vehicle.p_NB[2] == pytest.approx(4.0, abs=0.2)
    f.run(8.0)
    assert max(abs(v) for v in f.vehicle.nu[:3]) < 0.03
    assert abs(f.vehicle.nu[5]) < 0.02


def test_altitude_is_held_and_its_stick_moves_it(fly):
    f = fly("bluerov2_heavy", bottom=15.0, start=(0.0, 0.0, 6.0))
    settled(f, "altitude_hold", altitude={"altitude": 7.0})
    f.run(20.0)
    assert 15.0 - f.vehicle.p_NB[2] == pytest.approx(7.0, abs=0.15)
    f.run(4.0, pilot={"u": [0, 0, -0.5, 0, 0, 0]})
    f.run(8.0, pilot={"u": [0] * 6})
    assert 15.0 - f.vehicle.p_NB[2] == pytest.approx(7.0 + 4.0 * 0.2, abs=0.25)


def test_sticks_move_the_set_points_that_are_held(fly):
    f = fly("bluerov2_heavy")
    settled(f, "position_hold")
    f.run(4.0, pilot={"u": [0.5, 0, 0.5, 0, 0, 0.5]})
    f.run(8.0, pilot={"u": [0] * 6})
    x, y, z = f.vehicle.p_NB
    assert z == pytest.approx(3.0 + 4.0 * 0.2, abs=0.2)
    assert f.heading == pytest.approx(4.0 * 0.4, abs=0.3)
    assert math.hypot(x, y) > 0.7
    held = f.state["p_ref_N"][:2]
    assert math.dist((x, y), held) < 0.2


def test_manual_sticks_are_forces(fly):
    f = fly("bluerov2_heavy")
    f.call("arm")
    f.run(2.0, pilot={"u": [0.5, 0, 0, 0, 0, 0]})
    tau = f.state["tau"]
    assert tau[0] > 20.0
    assert tau[1:] == (0.0,) * 5
    assert f.vehicle.nu[0] > 0.2
    f.run(3.0)
    assert f.state["tau"] == (0.0,) * 6
    assert f.state["failsafe"] == "pilot"


def test_stabilise_levels_and_leans_with_the_stick(fly):
    f = fly("bluerov2_heavy")
    settled(f, "stabilise")
    f.run(5.0, pilot={"u": [0, 0, 0, 0.5, 0, 0]})
    assert f.vehicle.pose.rpy[0] == pytest.approx(0.25, abs=0.03)
    f.run(5.0, pilot={"u": [0] * 6})
    assert abs(f.vehicle.pose.rpy[0]) < 0.02


def test_acro_turns_at_the_stick_s_rate(fly):
    f = fly("bluerov2_heavy")
    settled(f, "acro")
    f.run(4.0, pilot={"u": [0, 0, 0, 0, 0, 0.5]})
    assert f.vehicle.nu[5] == pytest.approx(0.4, abs=0.05)


def test_an_attitude_is_held_at_depth(fly):
    from uwserver.frames import quat_from_rpy

    f = fly("bluerov2_heavy")
    settled(f, "guided")
    q = quat_from_rpy(0.0, 0.3, 0.8)
    f.run(10.0, attitude={"q_NB": q, "heave": 0.0})
    assert f.vehicle.pose.rpy == pytest.approx((0.0, 0.3, 0.8), abs=0.04)
    assert f.vehicle.p_NB[2] == pytest.approx(3.0, abs=0.15)
    f.run(6.0)
    assert abs(f.vehicle.pose.rpy[1]) < 0.03


def test_a_heading_and_a_rate_of_turn(fly):
    f = fly("bluerov2_heavy")
    settled(f, "heading_hold", heading={"heading": 1.5, "rate": 0.1})
    f.run(5.0)
    assert 0.3 < f.heading < 0.6
    f.run(20.0)
    assert f.off_heading(1.5) < 2.0
    f.send("heading", rate=-0.2)
    f.run(5.0)
    assert f.heading == pytest.approx(0.5, abs=0.15)


def test_it_comes_up(fly):
    f = fly("bluerov2_heavy")
    settled(f, "surface")
    f.run(30.0)
    assert f.vehicle.p_NB[2] < 0.3


@pytest.mark.parametrize("model", ["bluerov2_heavy", "minerva", "rexrov"])
def test_a_mission_ends_at_the_surface(fly, model):
    """RexROV floats with its origin half a metre below the surface, its float 0.1 m out of it: it has come up all the same."""
    f = fly(model)
    f.call("set_mission", items=[{"kind": "surface"}])
    f.call("arm")
    f.call("start_mission")
    f.run(25.0)
    assert (f.state["mission_index"], f.state["reached"]) == (-1, 1)
    assert f.vehicle.p_NB[2] < 0.75


@pytest.mark.parametrize("model", ["bluerov2", "bluerov2_heavy"])
def test_goto_tells_progress_and_arrives(fly, model):
    f = fly(model, current=(0.1, 0.0, 0.0))
    f.call("arm")
    answers = f.post("goto", position_ned_m=[4.0, 3.0, 5.0], radius_m=0.5)
    f.run(40.0)
    *progress, last = answers
    fractions = [p.fraction for p in progress]
    assert len(fractions) > 5
    assert fractions == sorted(fractions) or max(fractions) > 0.8
    assert last.fault is None
    assert last.result["distance_m"] <= 0.5
    assert math.dist(f.vehicle.p_NB, (4.0, 3.0, 5.0)) < 0.5
    assert f.state["mode"] == "guided"


def test_a_mission_reaches_every_waypoint_within_its_radius(fly):
    f = fly("bluerov2_heavy", current=(0.1, 0.05, 0.0))
    places = [(4.0, 0.0, 4.0), (4.0, 4.0, 5.0), (0.0, 4.0, 4.0)]
    items = [{"kind": "speed", "speed_mps": 0.5}]
    items += [{"kind": "waypoint", "position_ned_m": list(p), "radius_m": 0.5} for p in places]
    items += [{"kind": "heading", "heading_deg": 90}, {"kind": "hold", "time_s": 2}, {"kind": "surface"}]
    assert f.call("set_mission", items=items) == {"count": 7}
    f.call("arm")
    f.call("start_mission")
    nearest = [math.inf] * 3
    turned = math.inf
    for _ in range(900):
        f.run(0.1)
        nearest = [min(n, math.dist(f.vehicle.p_NB, p)) for n, p in zip(nearest, places, strict=True)]
        if f.state["reached"] == 6:
            turned = min(turned, f.off_heading(math.pi / 2))
    # The dead reckoning has its own error beside the radius.
    assert max(nearest) < 0.7
    assert turned < 5.0
    state = f.state
    assert (state["mission_index"], state["reached"], state["mission_count"]) == (-1, 7, 7)
    assert f.vehicle.p_NB[2] < 0.5
    assert any("all 7 items done" in text for text in f.events)


def test_too_much_is_asked_and_the_integrals_do_not_wind_up(fly):
    """A current stronger than the vehicle: it is carried away; when the current stops it comes back without overshooting far."""
    f = fly("bluerov2_heavy", start=(0.0, 0.0, 6.0), autopilot={"gains": {"max_speed_mps": 0.4}})
    settled(f, "position_hold")
    f.run(5.0)
    f.world.set_current((1.5, 0.0, 0.0))
    f.run(15.0)
    assert f.vehicle.p_NB[0] > 2.0
    away = f.vehicle.p_NB[0]
    f.world.set_current((0.0, 0.0, 0.0))
    backmost = away
    for _ in range(80):
        f.run(1.0)
        backmost = min(backmost, f.vehicle.p_NB[0])
    assert f.vehicle.p_NB[:2] == pytest.approx((0.0, 0.0), abs=0.4)
    assert backmost > -1.0
    assert f.vehicle.p_NB[2] == pytest.approx(6.0, abs=0.15)


def test_held_at_the_limit_depth_has_priority(fly):
    f = fly("bluerov2_heavy", start=(0.0, 0.0, 5.0))
    settled(f, "depth_hold", depth={"depth": 7.0})
    f.run(15.0, pilot={"u": [1.0, 1.0, 0, 0, 0, 0.2]})
    assert f.vehicle.p_NB[2] == pytest.approx(7.0, abs=0.2)


def test_it_holds_depth_and_a_heading_of_its_own_by_imu_and_depth_sensor_alone(fly):
    """As the vehicle file stands: no AHRS, no DVL. The heading drifts as the gyroscope does."""
    f = fly("bluerov2", bottom=None, without=("ahrs",))
    settled(f, "depth_hold", depth={"depth": 5.0})
    f.run(25.0)
    assert f.vehicle.p_NB[2] == pytest.approx(5.0, abs=0.1)
    assert max(abs(a) for a in f.vehicle.pose.rpy[:2]) < 0.05
    assert f.off_heading(0.0) < 5.0


@pytest.mark.parametrize("model", ["girona500", "lbv150", "minerva"])
def test_the_other_rovs_hold_depth_heading_and_place(fly, model):
    f = fly(model, start=(2.0, -1.0, 5.0), current=(0.15, 0.2, 0.0), yaw_deg=70.0)
    settled(f, "position_hold", position={"p_N": [2.0, -1.0, 7.0], "heading": 1.0})
    f.run(25.0)
    for _ in range(5):
        f.run(1.0)
        assert math.dist(f.vehicle.p_NB, (2.0, -1.0, 7.0)) < 0.3
        assert f.off_heading(1.0) < 2.0


def test_a_rov_that_cannot_go_sideways_holds_depth_and_heading(fly):
    f = fly("videoray_pro4", start=(0.0, 0.0, 5.0), current=(0.1, 0.1, 0.0))
    settled(f, "depth_hold", depth={"depth": 8.0}, heading={"heading": 1.0})
    f.run(30.0)
    for _ in range(5):
        f.run(1.0)
        assert abs(f.vehicle.p_NB[2] - 8.0) < 0.1
        assert f.off_heading(1.0) < 2.0


def beside(p, a, b):
    """Distance of p from the line a b in space, m."""
    u = [(y - x) / math.dist(a, b) for x, y in zip(a, b, strict=True)]
    d = [q - x for q, x in zip(p, a, strict=True)]
    along = sum(x * y for x, y in zip(d, u, strict=True))
    return math.dist(d, [along * x for x in u])


@pytest.mark.parametrize("model", ["bluerov2", "bluerov2_heavy", "girona500"])
def test_a_mission_keeps_to_its_lines_and_stops_at_its_waypoints(fly, model):
    """Three legs of 8 to 12 m, up and down, with corners of 90 degrees, in a current of 0.25 m/s; all distances are true ones."""
    places = [(0.0, 0.0, 5.0), (12.0, 0.0, 6.0), (12.0, 10.0, 8.0), (4.0, 10.0, 5.0)]
    f = fly(model, start=places[0], current=(0.15, 0.2, 0.0))
    f.call("set_mission", items=[{"kind": "waypoint", "position_ned_m": list(p)} for p in places[1:]])
    f.call("arm")
    f.call("start_mission")
    arrivals, away = [], 0.0
    for _ in range(1500):
        f.run(0.1)
        reached = f.state["reached"]
        if reached > len(arrivals):
            arrivals.append(math.dist(f.vehicle.p_NB, places[reached]))
        if reached == 3:
            break
        away = max(away, beside(f.vehicle.p_NB, places[reached], places[reached + 1]))
    assert len(arrivals) == 3
    assert max(arrivals) < 0.3
    assert away < 0.3


def test_a_gyroscope_that_is_off_leaves_no_error_of_heading(fly):
    """Two degrees a second: over a `heading_p` of 1.5 they would stand as 1.3 degrees."""
    modifiers = {"off": {"kind": "bias", "field": "w_S", "value": [0.0, 0.0, math.radians(2.0)]}}
    f = fly("bluerov2_heavy", override={"sensors": {"imu": {"modifiers": modifiers}}})
    settled(f, "depth_hold", heading={"heading": 1.0})
    f.run(40.0)
    worst = 0.0
    for _ in range(20):
        f.run(0.5)
        worst = max(worst, abs(math.degrees(math.remainder(rpy_from_quat(f.state["q_NB"])[2] - 1.0, 2 * math.pi))))
    assert worst < 0.4
    assert abs(f.state["w_B"][2] - f.vehicle.nu[5]) < math.radians(0.3)
