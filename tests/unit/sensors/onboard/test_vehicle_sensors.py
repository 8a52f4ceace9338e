"""Sensors of the vehicle itself: contact, battery, leak, shaft speed, ranges, compound; and that they survive a snapshot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from uwserver_bench.proofs.colliders import Floor

from uwserver.frames import quat_from_rpy
from uwserver.ports import Refused
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import WorldTable
from uwserver.sensors import (
    BatteryConfig,
    CompoundConfig,
    ContactConfig,
    GpsConfig,
    ImuConfig,
    LeakConfig,
    MagnetometerConfig,
    Pose,
    RangeArrayConfig,
    RpmConfig,
    SensorConfig,
)
from uwserver.sensors.motion.triad import TriadErrors
from uwserver.sensors.wiring import Touch
from uwserver.testing.fake_geometry import FakeGeometry, Plane
from uwserver.world import World

THRUSTERS = tuple(f"t{k}" for k in range(1, 9))


def world_with(depth=20.0, seed=1, **sensors: SensorConfig) -> World:
    entry = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, depth), sensors=sensors)
    place = WorldTable(origin_lat_deg=63.4, origin_lon_deg=10.4)
    return build(load(Scenario(schema=1, seed=seed, world=place, vehicles={"rov": entry}), adapters={}))


def last(world: World, port: str, ticks: int):
    return next(s for s in reversed(world.step(ticks)) if s.port == f"rov/{port}").value


def full_speed(world: World, seconds: float, port: str, u: float = 1.0):
    for _ in range(round(seconds * 2)):
        world.command("rov/thrusters", u=[u] * 8)
        value = last(world, port, 120)
    return value


# -- battery ----------------------------------------------------------------------------------------------------------------------------

BATTERY = BatteryConfig(
    rate_hz=20, capacity_Ah=18.0, cell_curve_V=(3.0, 3.7, 4.2), resistance_ohm=0.05, hotel_load_W=20.0
)


def test_an_idle_battery_gives_the_hotel_load():
    voltage, current, power, energy, charge = last(world_with(battery=BATTERY), "battery", 240)
    assert voltage * current == pytest.approx(20.0)
    assert power == pytest.approx(20.0)
    assert voltage == pytest.approx(4 * 4.2 - 0.05 * current, abs=1e-3)
    assert energy == pytest.approx(20.0, rel=1e-9)
    assert charge == pytest.approx(1.0 - current / (18.0 * 3600.0), rel=1e-6)


def test_power_of_the_thrusters_is_that_of_their_thrust():
    """The electric power is k T**1.5 a thruster, T the open-water thrust of the table at the voltage of now."""
    world = world_with(battery=BATTERY)
    voltage, current, power, _, _ = full_speed(world, 4.0, "battery")
    wiring = world.sensors["rov/battery"].wiring
    assert wiring.voltage == voltage
    row = world.hydro.thrusters[0]
    thrust = float(row["demand"]) / float(row["installed"])
    assert wiring.power() == pytest.approx(8 * 1.06 * thrust**1.5, rel=1e-3)
    assert power == pytest.approx(20.0 + wiring.power(), rel=1e-3)  # it has settled, and does not hunt
    battery = world.sensors["rov/battery"].sensor
    assert voltage == pytest.approx(
        battery.open_circuit(world.sensors["rov/battery"].held[1][4]) - 0.05 * current, rel=1e-4
    )
    assert 9.0 < voltage < 11.0


def test_sag_limits_thrust():
    stiff = world_with(battery=BatteryConfig(rate_hz=20, resistance_ohm=0.0))
    soft = world_with(battery=BatteryConfig(rate_hz=20, resistance_ohm=0.05))
    speeds = []
    for world in (stiff, soft):
        full_speed(world, 3.0, "battery")
        speeds.append(world.sensors["rov/battery"].wiring.shaft_speed("t1"))
    assert speeds[1] < 0.97 * speeds[0]
    voltage = soft.hydro.thrusters["voltage"]
    assert (voltage == voltage[0]).all()
    assert voltage[0] < stiff.hydro.thrusters["voltage"][0]


def test_thrust_is_that_of_the_table_at_the_sagged_voltage():
    """Full ahead: each thruster pushes what its device file gives for the voltage under load, which lies between two of its curves."""
    world = world_with(battery=BATTERY)
    voltage = full_speed(world, 4.0, "battery")[0]
    device = (
        load(Scenario(schema=1, vehicles={"rov": VehicleEntry(model="bluerov2_heavy")}), adapters={})
        .vehicles["rov"]
        .devices["t1"]
    )
    at = {curve.voltage_V: curve.max_forward_N for curve in device.curves.values()}
    low, high = max(v for v in at if v <= voltage), min(v for v in at if v > voltage)
    expected = at[low] + (at[high] - at[low]) * (voltage - low) / (high - low)
    row = world.hydro.thrusters[0]
    # The demand is from before the last reading of the meter, between which the voltage sinks a little.
    assert float(row["demand"]) / float(row["installed"]) == pytest.approx(expected, rel=1e-4)
    assert expected < 0.75 * at[16.0]


def test_the_current_of_the_thrusters_disturbs_the_compass():
    """The field moves by a constant vector per ampere that they draw together; at rest, and for an ideal one, by nothing."""
    per_ampere = (1e-7, -2e-7, 3e-7)
    compass = {"rate_hz": 20, "thruster_field_TpA": per_ampere}
    world = world_with(
        battery=BATTERY, compass=MagnetometerConfig(**compass), ideal=MagnetometerConfig(ideal=True, **compass)
    )
    at_rest = {s.port: s.value[0] for s in world.step(48) if s.port in ("rov/compass", "rov/ideal")}
    assert at_rest["rov/compass"] == at_rest["rov/ideal"]
    world.command("rov/thrusters", u=[0.8] * 8)
    under_way = {s.port: s.value[0] for s in world.step(96) if s.port in ("rov/compass", "rov/ideal")}
    wiring = world.sensors["rov/compass"].wiring
    current = wiring.power() / wiring.voltage
    assert current > 20.0
    moved = np.subtract(under_way["rov/compass"], under_way["rov/ideal"])
    assert moved == pytest.approx(np.multiply(per_ampere, current), rel=1e-9)


def test_charge_and_energy_are_the_integrals_and_empty_is_dead():
    """A small battery runs down under a known load: charge is the integral of the current, then the thrusters stop for good."""
    small = BatteryConfig(rate_hz=20, capacity_Ah=0.01, resistance_ohm=0.0, cell_curve_V=(3.7, 3.7), hotel_load_W=148.0)
    world = world_with(battery=small)
    voltage, current, _, energy, charge = last(world, "battery", 240)
    assert (voltage, current) == (14.8, 10.0)
    assert charge == pytest.approx(1.0 - 10.0 * 1.0 / 36.0)
    assert energy == pytest.approx(148.0)
    assert last(world, "battery", 720)[4] == 0.0
    values = full_speed(world, 2.0, "battery")
    assert values[0] == 0.0
    assert world.sensors["rov/battery"].wiring.power() == 0.0
    assert abs(world.vehicles["rov"].nu[0]) < 0.01


def test_the_meter_errs_and_the_battery_does_not():
    config = BatteryConfig(
        rate_hz=20, resistance_ohm=0.0, cell_curve_V=(3.7, 3.7), hotel_load_W=14.8, current_sigma_A=0.1
    )
    world = world_with(battery=config)
    currents = [s.value[1] for s in world.step(24_000) if s.port == "rov/battery"]
    assert np.mean(currents) == pytest.approx(1.0, abs=0.01)
    assert np.std(currents) == pytest.approx(0.1, rel=0.05)
    assert world.sensors["rov/battery"].held[1][3] == pytest.approx(14.8 * 100.0)


def test_the_hotel_load_is_a_setting():
    world = world_with(battery=BATTERY)
    world.call("rov/battery/set", hotel_load_W=200.0)
    assert world.call("rov/battery/get")["hotel_load_W"] == 200.0
    assert last(world, "battery", 240)[2] == pytest.approx(200.0)
    with pytest.raises(Refused):
        world.call("rov/battery/set", hotel_load_W=-1.0)


# -- shafts, leak, contact, ranges ------------------------------------------------------------------------------------------------------


def test_shaft_speed_is_the_root_of_the_thrust():
    world = world_with(shafts=RpmConfig(rate_hz=20, members=THRUSTERS))
    speeds = full_speed(world, 4.0, "shafts", u=-0.5)[0]
    row = world.hydro.thrusters[0]
    thrust = float(row["demand"]) / float(row["installed"])  # the lag has settled
    assert speeds[0] == pytest.approx(-51.0 * math.sqrt(-thrust), rel=1e-3)
    assert speeds == pytest.approx((speeds[0],) * 8)


def test_a_leak_fills_until_the_probe_is_wet():
    """A sqrt(2 g h) 0.6: through 1 mm2 at 20 m 12 ml a second."""
    world = world_with(leak=LeakConfig(rate_hz=10, threshold_m3=6e-5))
    assert last(world, "leak", 480) == (False,)
    world.call("rov/leak/set", area_m2=1e-6)
    wet = [s.value[0] for s in world.step(2400) if s.port == "rov/leak"]
    assert wet.index(True) / 10 == pytest.approx(6e-5 / (0.6e-6 * math.sqrt(2 * 9.81 * 20.0)), abs=0.15)
    world.call("world/reset")
    assert last(world, "leak", 240) == (False,)


class Touching:
    def touches(self):
        return [Touch(3, (1.0, 2.0, 6.0), (0.0, 0.0, -4.0)), Touch(-1, (1.5, 2.0, 5.0), (-1.0, 0.0, 0.0))]


def test_contacts_in_the_frame_of_the_body(scope):
    sensor = ContactConfig(rate_hz=10, points=3).build(Pose())
    instant = replace(scope(q_NB=quat_from_rpy(0, 0, math.pi / 2)), wiring=Touching())
    valid, (touching, count, impulse, body, points, impulses) = sensor.measure(instant)
    assert (valid, touching, count, body) == (True, True, 2, 3)
    assert impulse == pytest.approx((0.0, 1.0, -4.0), abs=1e-12)
    assert points[:6] == pytest.approx((0.0, 0.0, 1.0, 0.0, -0.5, 0.0), abs=1e-12)
    assert impulses[:6] == pytest.approx((0.0, 0.0, -4.0, 0.0, 1.0, 0.0), abs=1e-12)
    assert points[6:] == (None,) * 3


def test_nothing_touched(scope):
    valid, values = ContactConfig(rate_hz=10, points=1).build(Pose()).measure(scope())
    assert valid
    assert values == [False, 0, (0.0, 0.0, 0.0), None, (None,) * 3, (None,) * 3]


def test_a_landing_is_felt():
    """At rest on the seabed the contacts carry the weight in water, once a tick."""
    feet = tuple((x, y, 0.12) for x in (-0.2, 0.2) for y in (-0.25, 0.25))
    world = world_with(bump=ContactConfig(rate_hz=240, points=4), depth=-0.5)
    world.hydro.collider = Floor({0: feet})
    world.hydro.bodies["weight"] = 18.0 * 9.81
    world.hydro.state[0, 2] = -0.5  # the floor of the collider is z = 0
    values = [s.value for s in world.step(2400) if s.port == "rov/bump"]
    assert values[0][:2] == (False, 0)
    assert (values[-1][0], values[-1][3]) == (True, -1)
    body = world.hydro.bodies[0]
    total = np.mean([v[2] for v in values[-240:]], axis=0)
    assert total[2] == pytest.approx(-18.0 * 9.81 / 240.0, rel=0.05)
    assert float(body["weight"]) == 18.0 * 9.81
    assert values[-1][4][2] == pytest.approx(0.12, abs=0.02)


@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_ideal_ranges_equal_the_geometry(scope, angle):
    """A wall 6 m north of the origin, seen by a fan of 60 degrees from x = 1 m."""
    wall = FakeGeometry([Plane((6.0, 0.0, 0.0), (-1.0, 0.0, 0.0))])
    config = RangeArrayConfig(rate_hz=10, beams=7, field_of_view_deg=60, max_range_m=20, sigma_m=1.0, ideal=True)
    sensor = config.build(Pose())
    valid, (ranges,) = sensor.measure(replace(scope(q_NB=quat_from_rpy(0, 0, angle)), geometry=wall))
    assert valid
    for k, found in enumerate(ranges):
        bearing = math.radians(-30 + 10 * k) + angle
        assert found == pytest.approx(5.0 / math.cos(bearing), abs=1e-9)


def test_ranges_err_get_lost_and_end(scope):
    wall = FakeGeometry([Plane((6.0, 0.0, 0.0), (-1.0, 0.0, 0.0))])
    sensor = RangeArrayConfig(rate_hz=10, beams=400, max_range_m=20, sigma_m=0.02, loss_probability=0.1).build(Pose())
    instant = replace(scope(), geometry=wall)
    found = [r for _ in range(50) for r in sensor.measure(instant)[1][0]]
    seen = [r for r in found if r is not None]
    assert len(seen) / len(found) == pytest.approx(0.9, abs=0.01)
    assert np.mean(seen) == pytest.approx(5.0, abs=1e-3)
    assert np.std(seen) == pytest.approx(0.02, rel=0.03)
    sensor.change({"max_range_m": 4.0})
    assert set(sensor.measure(instant)[1][0]) == {None}
    assert not sensor.measure(replace(instant, p_NB=(0.0, 0.0, -1.0)))[0]


# -- compound, snapshot, time -----------------------------------------------------------------------------------------------------------

NOISY = TriadErrors(noise_density=1e-3, instability=1e-3, random_walk=1e-4)


def test_a_compound_holds_what_its_members_have_just_read():
    world = world_with(
        auto=CompoundConfig(rate_hz=120, members=("imu", "pressure")),
        slow=CompoundConfig(rate_hz=60, members=("pressure", "leak")),
        leak=LeakConfig(rate_hz=2),
    )
    names = [field.name for field in world.ports["rov/auto"].fields]
    assert names[:5] == ["age", "imu_valid", "imu_f_S", "imu_w_S", "imu_temperature"]
    by_port: dict[str, list] = {}
    for sample in world.step(240):
        by_port.setdefault(sample.port, []).append(sample)
    imu = {s.t_ns: s.value for s in by_port["rov/imu"]}
    pressure = {s.t_ns: s.value for s in by_port["rov/pressure"]}  # delivered later, measured then
    for sample in by_port["rov/auto"]:
        assert sample.value[2:5] == imu[sample.t_ns]
        newest = max(t for t in pressure if t <= sample.t_ns) if min(pressure) <= sample.t_ns else None
        if newest is not None and newest == sample.t_ns:
            assert sample.value[6:8] == pressure[newest]
            assert sample.value[0] == 0.0
    assert by_port["rov/slow"][0].t_ns == 500_000_000  # the first reading of the leak probe


def test_stateful_sensors_go_on_bit_for_bit_after_a_restore():
    world = world_with(
        depth=0.0,
        tactical=ImuConfig(rate_hz=240, gyroscope=NOISY, accelerometer=NOISY),
        gps=GpsConfig(rate_hz=5, horizontal_sigma_m=2.0, hot_fix_s=1.0, cold_fix_s=2.0),
        battery=BATTERY,
        leak=LeakConfig(rate_hz=2, area_m2=1e-6, threshold_m3=1e-4),
        auto=CompoundConfig(rate_hz=60, members=("tactical", "gps", "battery")),
    )
    world.command("rov/thrusters", u=[0.4] * 8)
    world.step(333)
    world.call("rov/battery/set", hotel_load_W=50.0)
    taken = world.call("world/snapshot")
    going = world.step(700)
    world.call("rov/battery/set", hotel_load_W=70.0)
    world.step(50)
    assert world.call("world/restore")
    assert world.call("world/state_hash")["hash"] == taken["hash"]
    assert world.step(700) == going


def test_rate_of_a_stateful_sensor_can_change():
    """A tenth of the rate: ten times the variance goes with a tenth of the density's bandwidth, and memory goes on in seconds."""
    world = world_with(imu2=ImuConfig(rate_hz=240, gyroscope=TriadErrors(noise_density=1e-3)))
    fast = [s.value[1] for s in world.step(4800) if s.port == "rov/imu2"]
    world.call("rov/imu2/set", rate_hz=24.0)
    slow = [s.value[1] for s in world.step(24_000) if s.port == "rov/imu2"]
    ideal = np.array([0.0, 0.0, 0.0])
    assert np.std(np.diff(np.array(fast) - ideal, axis=0)) / math.sqrt(2) == pytest.approx(
        1e-3 * math.sqrt(240), rel=0.05
    )
    assert np.std(np.diff(np.array(slow) - ideal, axis=0)) / math.sqrt(2) == pytest.approx(
        1e-3 * math.sqrt(24), rel=0.06
    )
