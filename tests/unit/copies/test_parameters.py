"""What differs from copy to copy: each factor does what its name says, in its copy alone, and holds over resets."""

import numpy as np
import pytest

import uwserver
from uwserver.ports import Refused
from uwserver.scenario.builder import ScenarioBuilder


def scenario():
    b = ScenarioBuilder("made", rate_hz=240).vehicle("rov", "bluerov2_heavy", position_ned_m=[0, 0, 5])
    b.sensor("rov", "ahrs", "attitude", rate_hz=40, profile="mems_ahrs", latency_s=0.0)
    return b.build()


def pushed(**parameters):
    """Accelerations along x just after a push, of three copies."""
    batch = uwserver.batch(scenario(), 3, sensors=(), seeds=[1, 1, 1], **parameters)
    batch.command("rov/thrusters", u=np.array([0.3, 0.3, -0.3, -0.3, 0, 0, 0, 0]))
    return batch


def test_the_first_is_as_the_scenario_says_whatever_the_others_are():
    u = np.array([0.3, 0.3, -0.3, -0.3, 0, 0, 0, 0])
    batch = pushed(mass=[1, 1.2, 0.9], added_mass=[1, 2, 0.5], damping=[1, 3, 0.3], thruster_gain=[1, 0.5, 1.1])
    for _ in range(2):
        world = uwserver.load(scenario(), seed=1).core
        world.command("rov/thrusters", u=u)
        batch.command("rov/thrusters", u=u)
        batch.step(200)
        world.step(200)
        assert np.array_equal(batch.states()[0], world.hydro.state[0])
        assert len(np.unique(batch.states()[:, 7])) == 3  # also after a reset
        batch.reset()


def test_a_heavier_copy_sinks_with_what_it_weighs_more():
    """After a moment from rest: dw/dt (M + M_A) = W - B, along z."""
    batch = pushed(mass=[1.0, 1.1, 0.9])
    batch.reset()
    batch.step(1)
    hydro = [copy.world.hydro for copy in batch._copies]
    expected = [
        (h.bodies["weight"][0] - h.bodies["buoyancy"][0]) / (h.bodies["M_RB"] + h.bodies["M_A"])[0, 2, 2] for h in hydro
    ]
    assert np.allclose(batch.states()[:, 9] * 240, expected, rtol=0.02, atol=1e-4)
    assert hydro[1].bodies["weight"][0] == pytest.approx(1.1 * hydro[0].bodies["weight"][0])


def test_gain_scales_the_thrust_and_damping_the_speed_that_it_holds():
    gain = pushed(thruster_gain=[1.0, 2.0, 0.0])
    gain.step(5)
    u = gain.states()[:, 7]
    assert u[1] == pytest.approx(2 * u[0], rel=0.02)
    assert abs(u[2]) < 1e-9
    drag = pushed(damping=[1.0, 4.0, 0.25])
    drag.step(900)
    u = np.abs(drag.states()[:, 7])
    assert u[1] < 0.7 * u[0] < 0.7 * 0.7 * u[2]


def test_a_current_carries_its_copy_alone():
    batch = uwserver.batch(scenario(), 2, sensors=(), current=[[0.0, 0.0, 0.0], [0.0, 0.4, 0.0]])
    batch.step(1200)
    assert abs(batch.states()[0, 1]) < 1e-6
    assert batch.states()[1, 1] > 0.5
    batch.reset([1], current=[np.nan] * 3)
    batch.step(10)
    assert abs(batch.states()[1, 1]) < 1e-6


def test_latency_delays_samples_and_noise_scales_their_errors():
    batch = uwserver.batch(scenario(), 3, seeds=[1, 1, 1], latency=[0, 0.1, 0], noise=[1, 1, 3])
    batch.step(240)
    ahrs = batch.read("rov/ahrs")
    assert (ahrs.t_sent_ns - ahrs.t_ns).tolist() == [0, 100_000_000, 0]
    quiet = uwserver.batch(scenario(), 1, seeds=1, noise=0)
    quiet.step(240)
    q = quiet.read("rov/ahrs")["q_NS"][0]
    errors = np.abs(ahrs["q_NS"] - q)[:, 1:].max(axis=1)
    assert errors[0] > 1e-4
    assert errors[2] == pytest.approx(3 * errors[0], rel=0.05)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"mas": 1}, 'did you mean "mass"'),
        ({"mass": [1, 2]}, r"\(3,\) is needed"),
        ({"mass": [1, 0, 1]}, "of copy 1 is 0"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_has_changed(given, text):
    batch = uwserver.batch(scenario(), 3, sensors=())
    batch.step(5)
    with pytest.raises(Refused, match=text):
        batch.reset(damping=2.0, **given)
    assert batch.ticks.tolist() == [5, 5, 5]
    assert batch.parameters["damping"].tolist() == [1, 1, 1]
