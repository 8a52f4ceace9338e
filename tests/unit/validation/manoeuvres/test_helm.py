"""The sticks of a pilot, and bollard pull."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from manoeuvre_rig import BATTERY, FINS, FOUR, GLIDER, GUESS, RAFT, ROV, TORPEDO, helm, vehicle

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.layout import NU
from uwserver.validation.manoeuvres.helm import Helm, Sticks, bollard


def test_each_command_has_its_wrench(tmp_path: Path) -> None:
    """50 N at 0.3 m to either side and 5 cm below the origin; nothing at rest."""

    def port(hydro: Hydrodynamics, row: int) -> None:
        hydro.thrusters["command"][2 * row], hydro.thrusters["fresh"][2 * row] = 1.0, 1

    def still(_hydro: Hydrodynamics, _row: int) -> None:
        pass

    wrench = bollard(helm(tmp_path, RAFT).body, [still, port])
    np.testing.assert_allclose(wrench, [[0.0] * 6, [50.0, 0.0, 0.0, 0.0, 2.5, 15.0]], atol=1e-6)


def told(one: Helm, **sticks: float) -> Hydrodynamics:
    hydro = Hydrodynamics([one.body, one.body], 0.02)
    one.tell(hydro, 1, Sticks(**sticks))
    assert not hydro.thrusters["command"][: len(one.body.thrusters)].any(), "the other row is left alone"
    return hydro


@pytest.mark.parametrize(
    ("sticks", "commands"),
    [
        ({"surge": 1.0}, [-1, -1, 1, 1, 0, 0]),
        ({"surge": -0.5}, [0.5, 0.5, -0.5, -0.5, 0, 0]),
        ({"sway": 1.0}, [1, -1, 1, -1, 0, 0]),
        ({"heave": 1.0}, [0, 0, 0, 0, -1, 1]),
        ({"yaw": 1.0}, [1, -1, -1, 1, 0, 0]),
        ({"surge": 1.0, "yaw": 1.0}, [0, -1, 0, 1, 0, 0]),
    ],
)  # fmt: skip
def test_vectored_thrusters_get_their_shares(tmp_path: Path, sticks: dict[str, float], commands: list[float]) -> None:
    """As the motor matrix of ArduSub's vectored frame; nobody holds pitch or roll."""
    hydro = told(helm(tmp_path, ROV), **sticks)
    np.testing.assert_allclose(hydro.thrusters["command"][6:], commands, atol=1e-12)
    assert hydro.thrusters["fresh"][6:].all()


def test_two_thrusters_turn_and_do_not_push_sideways(tmp_path: Path) -> None:
    raft = helm(tmp_path, RAFT)
    assert [stick for stick in Sticks._fields if raft.has(stick)] == ["surge", "yaw"]
    np.testing.assert_allclose(told(raft, surge=0.5, yaw=0.5).thrusters["command"][2:], [1.0, 0.0], atol=1e-12)


def test_unequal_arms_are_balanced(tmp_path: Path) -> None:
    """Pushed sideways, the nearer thruster works harder and the vehicle does not turn."""
    sideways = {
        name: {**FOUR["up"], "position_frd_m": [x, 0.0, 0.0], "axis_frd": [0.0, 1.0, 0.0]}
        for name, x in (("bow", 0.2), ("stern", -0.4))
    }
    hydro = told(helm(tmp_path, vehicle(thrusters=sideways)), sway=1.0)
    np.testing.assert_allclose(hydro.thrusters["command"][2:], [1.0, 0.5], atol=1e-9)


def test_fins_turn_to_starboard_and_dive_whatever_their_hinge(tmp_path: Path) -> None:
    torpedo = helm(tmp_path, TORPEDO)
    assert [stick for stick in Sticks._fields if torpedo.has(stick)] == ["surge", "rudder", "planes"]
    assert (torpedo.rudder, torpedo.planes) == (pytest.approx(math.radians(20.0)), pytest.approx(math.radians(10.0)))
    hydro = told(torpedo, surge=0.5, rudder=0.1, planes=0.05)
    assert hydro.servos["command"][3:].tolist() == pytest.approx([-0.1, 0.05, 50.0])
    hydro.state[:, 2], hydro.state[:, NU] = 500.0, 1.0
    hydro.servos["value"][3:5] = hydro.servos["command"][3:5]
    made = hydro.rates_of_change(0.0)[1][1]
    assert made[5] > 0.0
    assert made[4] < 0.0


def test_an_angle_is_cut_at_the_limit_of_its_fin(tmp_path: Path) -> None:
    assert told(helm(tmp_path, TORPEDO), rudder=1.0).servos["command"][3] == pytest.approx(-math.radians(20.0))


def test_a_crossed_tail_turns_by_all_four(tmp_path: Path) -> None:
    """Each fin turns, pitches and rolls; together they only turn."""
    places = {"a": (1, -1), "b": (1, 1), "c": (-1, 1), "d": (-1, -1)}
    fins = {
        name: {**FINS["rudder"], "position_frd_m": [-0.5, 0.1 * y, 0.1 * z], "hinge_frd": [0.0, float(y * z), 1.0]}
        for name, (y, z) in places.items()
    }
    one = helm(tmp_path, vehicle(fins=fins))
    hydro = told(one, rudder=0.1)
    hydro.state[:, 2], hydro.state[:, NU] = 500.0, 1.0
    hydro.servos["value"] = hydro.servos["command"]
    made = hydro.rates_of_change(0.0)[1][1]
    assert made[5] > 0.0
    assert abs(made[3]) + abs(made[4]) < 1e-9 * made[5]


def test_ballast_sinks_and_a_mass_forward_puts_the_nose_down(tmp_path: Path) -> None:
    glider = helm(tmp_path, GLIDER)
    assert [stick for stick in Sticks._fields if glider.has(stick)] == ["sink", "nose_down"]
    assert told(glider, sink=1.0, nose_down=1.0).servos["command"][2:].tolist() == pytest.approx([0.0, 0.1])
    assert told(glider, sink=-1.0, nose_down=-0.5).servos["command"][2:].tolist() == pytest.approx([1e-3, -0.05])


def test_a_mass_that_moves_aft_is_turned_round(tmp_path: Path) -> None:
    aft = {"battery": {**BATTERY["battery"], "axis_frd": [-1.0, 0.0, 0.0]}}
    assert told(helm(tmp_path, vehicle(moving_masses=aft)), nose_down=1.0).servos["command"][1] == pytest.approx(-0.1)


def test_a_vehicle_without_propulsors_is_driven_by_its_wrench(tmp_path: Path) -> None:
    towed = vehicle(
        actuators={"wrench": {"kind": "force_torque"}},
        autopilot={**GUESS, "max_wrench": [10.0, 20.0, 30.0, 1.0, 2.0, 3.0]},
    )
    one = helm(tmp_path, towed)
    hydro = told(one, surge=1.0, yaw=-0.5)
    wrench = hydro.wrenches["bias"][hydro.bodies["wrench_first"][1]]
    assert wrench.tolist() == [10.0, 0.0, 0.0, 0.0, 0.0, -1.5]


def test_nothing_moves_a_bare_hull(tmp_path: Path) -> None:
    assert not any(helm(tmp_path, vehicle()).has(stick) for stick in Sticks._fields)
