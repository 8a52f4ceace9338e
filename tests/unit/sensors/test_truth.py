"""Truth ports, and ideal sensors of a moving vehicle against them."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.frames import rotate
from uwserver.physics.kernel.layout import NU
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import ImuConfig, MotionCaptureConfig, PressureConfig
from uwserver.sensors.truth import TRUTH, Truth, TruthAcceleration, TruthFlow, TruthPose, TruthVelocity, TruthWrench

ZERO = (0.0, 0.0, 0.0)


@pytest.fixture
def world():
    entry = VehicleEntry(
        model="bluerov2_heavy",
        position_ned_m=(1.0, -2.0, 20.0),
        attitude_rpy_deg=(5.0, -10.0, 40.0),
        velocity_frd_mps=(0.8, -0.3, 0.2),
        truth=Truth(rate_hz=240),
        sensors={
            "gyro": ImuConfig(rate_hz=240),
            "mocap": MotionCaptureConfig(rate_hz=240),
            "ideal_depth": PressureConfig(rate_hz=240, output="depth"),
            "ideal_pressure": PressureConfig(rate_hz=240),
        },
    )
    world = build(load(Scenario(schema=1, vehicles={"rov": entry}), adapters={}))
    world.command("rov/thrusters", u=[0.3, 0.3, -0.2, -0.25, 0.4, 0.2, 0.1, 0.4])
    return world


def test_what_truth_tells_of_one_instant(scope):
    here = scope(v_NB_B=(1, 2, 3), w_NB_B=(4, 5, 6), nu_dot=(1, 2, 3, 4, 5, 6), tau=(6, 5, 4, 3, 2, 1))
    assert TruthPose().measure(here) == (True, [(1.0, 2.0, 5.0), (1.0, 0.0, 0.0, 0.0)])
    assert TruthVelocity().measure(here) == (True, [(1, 2, 3), (4, 5, 6)])
    assert TruthAcceleration().measure(here) == (True, [(1, 2, 3), (4, 5, 6)])
    assert TruthWrench().measure(here) == (True, [(6, 5, 4), (3, 2, 1)])


def test_the_flow_is_that_of_the_water_in_the_axes_of_the_body(world):
    world.set_current((0.5, 0.2, 0.0))
    (flow,) = [s.value[0] for s in world.step(1) if s.port == "rov/truth/flow"]
    (q,) = [s.value[1] for s in world.step(1) if s.port == "rov/truth/pose"]
    assert rotate(q, flow) == pytest.approx((0.5, 0.2, 0.0), abs=5e-3)  # it turns a little meanwhile
    assert TruthFlow.fields[0].name == "v_NW_B"


def test_every_truth_port_is_there_and_is_marked(world):
    paths = {path for path, port in world.ports.items() if port.is_truth}
    assert paths == {f"rov/truth/{name}" for name in TRUTH}


def test_ideal_sensors_equal_truth(world):
    for sample_set in (world.step(1) for _ in range(200)):
        by_port = {sample.port: sample.value for sample in sample_set}
        p, q = by_port["rov/truth/pose"]
        assert by_port["rov/mocap"][0] == pytest.approx(p, abs=1e-9)
        assert by_port["rov/mocap"][1] == pytest.approx(q, abs=1e-9)
        assert by_port["rov/ideal_depth"][0] == pytest.approx(p[2], abs=1e-9)
        assert by_port["rov/ideal_pressure"][0] == pytest.approx(101_325.0 + 1025.0 * 9.81 * p[2], rel=1e-12)
        assert by_port["rov/gyro"][1] == pytest.approx(by_port["rov/truth/velocity"][1], abs=1e-9)


def test_acceleration_is_the_rate_of_the_velocity(world):
    """Central differences of the velocity on the wire: second order, so a small step leaves little."""
    world.step(60)
    samples = [world.step(1) for _ in range(60)]
    nu = np.array([_six(s, "rov/truth/velocity") for s in samples])
    nu_dot = np.array([_six(s, "rov/truth/acceleration") for s in samples])
    differenced = (nu[2:] - nu[:-2]) * 120.0
    assert np.abs(nu_dot[1:-1] - differenced).max() < 2e-3 * np.abs(nu_dot).max()


def test_wrench_is_what_moves_the_body(world):
    """M nu_dot = tau + what depends on pose and velocity alone: so two commands at one state differ by their wrench."""
    world.step(30)
    hydro = world.hydro
    before, tau = hydro.rates_of_change(0.0)
    sample = world.read("rov/truth/wrench")
    assert (*sample.value[0], *sample.value[1]) == pytest.approx(tuple(tau[0]), abs=1e-12)
    hydro.wrenches["bias"][0] = (5.0, -3.0, 2.0, 0.5, 0.2, -0.1)
    after, tau_with = hydro.rates_of_change(0.0)
    assert tau_with[0] - tau[0] == pytest.approx(hydro.wrenches["bias"][0])
    inertia = hydro.params[0].M_RB + hydro.params[0].M_A
    assert inertia @ (after[0] - before[0]) == pytest.approx(hydro.wrenches["bias"][0], rel=1e-9, abs=1e-9)


def test_truth_velocity_is_the_state(world):
    sample = [s for s in world.step(10) if s.port == "rov/truth/velocity"][-1]
    assert tuple(world.hydro.state[0, NU : NU + 6]) == (*sample.value[0], *sample.value[1])


def _six(samples, port):
    value = next(sample.value for sample in samples if sample.port == port)
    return (*value[0], *value[1])
