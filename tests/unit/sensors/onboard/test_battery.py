"""The battery: load, sag, charge, meter, and what it does to the thrusters."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_rig import (
    BATTERY,
    electromotive,
    full_speed,
    last,
    world_with,
)

from uwserver.ports import Refused
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.body import force_table
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import (
    BatteryConfig,
    RpmConfig,
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
    assert wiring.power() == pytest.approx(8 * 0.964 * thrust**1.5, rel=1e-3)
    assert power == pytest.approx(20.0 + wiring.power(), rel=1e-3)  # it has settled, and does not hunt
    charge = world.sensors["rov/battery"].held[1][4]
    assert voltage == pytest.approx(electromotive(BATTERY, charge) - 0.05 * current, rel=1e-4)
    assert 9.0 < voltage < 11.0


def test_sag_limits_thrust():
    shafts = RpmConfig(rate_hz=20, members=("t1",))
    stiff = world_with(battery=BatteryConfig(rate_hz=20, resistance_ohm=0.0), shafts=shafts)
    soft = world_with(battery=BatteryConfig(rate_hz=20, resistance_ohm=0.05), shafts=shafts)
    speeds = []
    for world in (stiff, soft):
        speeds.append(full_speed(world, 3.0, "shafts")[0][0])
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
    table = force_table(device)
    at = {supply: curve[-1][1] for supply, curve in zip(table.voltages, table.curves, strict=True)}
    low, high = max(v for v in at if v <= voltage), min(v for v in at if v > voltage)
    expected = at[low] + (at[high] - at[low]) * (voltage - low) / (high - low)
    row = world.hydro.thrusters[0]
    # The demand is from before the last reading of the meter, between which the voltage sinks a little.
    assert float(row["demand"]) / float(row["installed"]) == pytest.approx(expected, rel=1e-4)
    assert expected < 0.75 * at[16.0]


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
