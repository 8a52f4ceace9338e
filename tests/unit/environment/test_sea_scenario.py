"""Sea state through the scenario file, the world, its snapshots and its sensors."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.environment.currents import GaussMarkovConfig, ProfileConfig, UniformConfig
from uwserver.environment.waves import WavesConfig
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario, Server
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import Current, Environment
from uwserver.sensors import MotionCaptureConfig, PressureConfig
from uwserver.world.state import snapshot

ROUGH = Environment(
    current=Current(velocity_ned_mps=(0.1, 0.0, 0.0)),
    currents={
        "tide": UniformConfig(velocity_ned_mps=(0.2, -0.1, 0.0)),
        "layers": ProfileConfig(depth_m=(0.0, 20.0), velocity_ned_mps=((0.3, 0.0, 0.0), (0.1, 0.0, 0.0))),
        "eddy": GaussMarkovConfig(sigma_ned_mps=(0.1, 0.1, 0.02), tau_s=20.0),
        "gust": GaussMarkovConfig(sigma_ned_mps=(0.1, 0.1, 0.02), tau_s=20.0),
    },
    waves=WavesConfig(significant_height_m=0.8, peak_period_s=5.0, spreading=10.0, components=40),
)


def make(environment=ROUGH, seed=3, z=(2.0, 0.1)):
    vehicles = {
        f"rov{k}": VehicleEntry(
            model="bluerov2_heavy",
            position_ned_m=(4.0 * k, 0.0, depth),
            sensors={
                "barometer": PressureConfig(rate_hz=240, position_frd_m=(0.2, 0.0, 0.1)),
                "mocap": MotionCaptureConfig(rate_hz=240),
            },
        )
        for k, depth in enumerate(z)
    }
    scenario = Scenario(schema=1, seed=seed, environment=environment, vehicles=vehicles, server=Server(metrics=False))
    return build(load(scenario, adapters={}))


def test_same_seed_same_bits_another_seed_another_sea():
    hashes = []
    for seed in (3, 3, 4):
        world = make(seed=seed)
        world.step(300)
        hashes.append(snapshot.take(world).hash())
    assert hashes[0] == hashes[1] != hashes[2]


def test_every_drift_has_its_own_stream():
    eddy, gust = make().water.sea.drifts
    assert (eddy.ends != gust.ends).any()


def test_snapshot_restore_and_reset_are_exact():
    world = make()
    begin = world.call("world/state_hash")["hash"]
    world.step(130)
    kept = snapshot.take(world)
    first = world.step(200)
    end = world.call("world/state_hash")
    world.call("world/set_current", velocity_N=[1.0, 0.0, 0.0])
    world.step(77)
    snapshot.restore(world, kept)
    assert snapshot.take(world) == kept
    assert world.step(200) == first
    assert world.call("world/state_hash") == end
    other = make()
    snapshot.restore(other, kept)
    assert other.step(200) == first
    world.call("world/reset")
    assert world.call("world/state_hash")["hash"] == begin
    world.step(330)
    assert world.call("world/state_hash") == end


def test_the_hash_sees_the_drift():
    world = make()
    before = snapshot.take(world).hash()
    world.water.sea.drifts[0].ends[1, 0] += 1e-12
    assert snapshot.take(world).hash() != before


def test_set_current_replaces_the_steady_part_alone():
    world = make()
    assert world.water.current == pytest.approx((0.3, -0.1, 0.0))
    p = (1.0, 2.0, 5.0)
    before = np.array(world.water.velocity(p, 0.0))
    world.call("world/set_current", velocity_N=[1.3, -0.1, 0.0])
    assert np.array(world.water.velocity(p, 0.0)) - before == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    world.step(10)
    assert world.hydro.currents[0, 0] > 0.9


def test_a_uniform_current_by_either_name_is_the_same_to_the_bit():
    one = make(Environment(current=Current(velocity_ned_mps=(0.3, -0.2, 0.1))))
    two = make(Environment(currents={"tide": UniformConfig(velocity_ned_mps=(0.3, -0.2, 0.1))}))
    assert two.water.sea is None
    one.step(200)
    two.step(200)
    assert one.hydro.state.tobytes() == two.hydro.state.tobytes()


def test_sensors_ask_the_moving_water():
    world = make(z=(2.0, -0.3))
    world.step(100)
    t = world.tick / float(world.rate_hz)  # t_ns is rounded to whole nanoseconds, in which a wave goes on
    for name in ("rov0", "rov1"):
        vehicle = world.vehicles[name]
        x, y, z = vehicle.p_NB
        sample = world.read(f"{name}/mocap")
        assert sample.valid == (z + world.water.elevation(x, y, t) >= 0.0)
    x = world.hydro.state[0]
    from uwserver.frames import rotate

    place = np.array(x[:3]) + rotate(tuple(x[3:7]), (0.2, 0.0, 0.1))
    assert world.read("rov0/barometer").value[0] == world.water.pressure(tuple(place.tolist()), t)
    assert abs(world.water.sea.head(tuple(place.tolist()), t)) > 1e-4


def test_a_surface_vehicle_stays_near_the_surface_in_waves():
    """Within the significant height: with 2 N more buoyancy than weight it ducks under crests and comes up at 0.15 m/s."""
    world = make(z=(0.0, 0.0))
    for _ in range(10):
        world.step(480)
        for vehicle in world.vehicles.values():
            x, y, z = vehicle.p_NB
            assert abs(z + world.water.elevation(x, y, world.t_ns / 1e9)) < 0.8


BAD = """
schema = 1
[environment]
gravity_mps2 = 0
[environment.currents.layers]
kind = "profile"
depth_m = [0, 10, 5]
velocity_ned_mps = [[0, 0, 0], [1, 0, 0]]
[environment.currents.odd]
kind = "tidal"
[environment.currents.eddy]
kind = "gauss_markov"
sigma_ned_mps = [0.1, -0.1, 0]
tau_s = 10
[environment.waves]
significant_height_m = 5
peak_period_s = 4
"""


def test_faults_are_told_with_their_place(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(BAD)
    with pytest.raises(ScenarioError) as caught:
        load(path, adapters={})
    text = str(caught.value)
    assert "bad.toml:7:19: environment.currents.layers.depth_m[2]: 5 m is not below 10 m" in text
    assert "bad.toml:8:1: environment.currents.layers.velocity_ned_mps: 2 velocities for 3 depths" in text
    assert 'unknown kind "tidal"; allowed: uniform, profile, gauss_markov' in text
    assert "bad.toml:13:23: environment.currents.eddy.sigma_ned_mps[1]" in text
    assert "bad.toml:15:14: environment.waves: waves need gravity" in text


def test_a_sea_that_would_break_is_a_warning():
    steep = Environment(waves=WavesConfig(significant_height_m=3.0, peak_period_s=4.0))
    (warning,) = load(Scenario(schema=1, environment=steep), adapters={}).warnings
    assert "steeper than 1/16" in warning.text


def test_the_builder_has_the_verbs():
    scenario = (
        ScenarioBuilder("sea")
        .add_current("eddy", "gauss_markov", sigma_ned_mps=(0.1, 0.1, 0.0), tau_s=60)
        .waves(significant_height_m=1.0, peak_period_s=6.0)
        .build()
    )
    assert scenario.environment.currents["eddy"].tau_s == 60
    assert scenario.environment.waves.peak_period_s == 6.0
    with pytest.raises(ScenarioError, match="unknown kind"):
        ScenarioBuilder("sea").add_current("eddy", "whirl")


def test_the_wrench_of_a_vehicle_is_that_of_now():
    """Thrust depends on the inflow; asked between two ticks it is what the truth sensor says."""
    world = make(z=(5.0,))
    entry = world.vehicles["rov0"]
    world.command("rov0/thrusters", u=[0.4] * 8)
    world.step(2000)
    rates = world.hydro.rates_of_change(world.t_ns / 1e9)[1][0]
    assert entry.wrench == pytest.approx(tuple(rates), abs=1e-6)
