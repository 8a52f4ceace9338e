"""The thrusters of the scenario against the motors that PX4's airframe has in mind: a demand of PX4 is a wrench of the same sign."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tomllib
import uwserver_scenarios

SCENARIOS = Path(uwserver_scenarios.__file__).parent

# CA_ROTORn_PX, _PY, _PZ and _AX, _AY, _AZ of PX4's airframe 1022_gazebo-classic_uuv_bluerov2_heavy.
MOTORS = (
    ((0.5, 0.3, 0.2), (1, -1, 0)),
    ((0.5, -0.3, 0.2), (1, 1, 0)),
    ((-0.5, 0.3, 0.2), (1, 1, 0)),
    ((-0.5, -0.3, 0.2), (1, -1, 0)),
    ((0.5, 0.5, 0.0), (0, 0, -1)),
    ((0.5, -0.5, 0.0), (0, 0, 1)),
    ((-0.5, 0.5, 0.0), (0, 0, 1)),
    ((-0.5, -0.5, 0.0), (0, 0, -1)),
)


def effectiveness(thrusters: list[tuple[list[float], list[float]]]) -> np.ndarray:
    """6 x n: X Y Z K M N of each thruster at full power."""
    columns = []
    for position, axis in thrusters:
        direction = np.array(axis, float) / np.linalg.norm(axis)
        columns.append([*direction, *np.cross(position, direction)])
    return np.array(columns).T


def test_each_demand_of_px4_moves_the_vehicle_the_right_way() -> None:
    adapter = tomllib.loads((SCENARIOS / "bluerov2_px4.toml").read_text(encoding="utf-8"))["adapters"]["px4"]
    vehicle = tomllib.loads((SCENARIOS / "vehicles" / "bluerov2_heavy.toml").read_text(encoding="utf-8"))
    ours = [(t["position_frd_m"], t["axis_frd"]) for t in vehicle["thrusters"].values()]
    full = adapter["outputs"]["thrusters"]["full"]
    allocation = np.linalg.pinv(effectiveness([(list(p), list(a)) for p, a in MOTORS]))
    wrench = effectiveness(ours) @ np.diag(full) @ allocation
    assert np.diag(wrench).min() > 0.2, "of its own sign, and strong"
    across = wrench - np.diag(np.diag(wrench))
    assert abs(across).max() < 0.05, "and next to nothing else"
    assert abs(np.diag(effectiveness(ours) @ allocation)).max() < 0.2, "which is not so without `full`"
