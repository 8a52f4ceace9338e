"""The REMUS 100 comparison: ours is driven; theirs is measured where it is, and its absence is said."""

from __future__ import annotations

from pathlib import Path

import pytest
from uwserver_bench.engine.remus import BAR, VARIABLE, OurRemus, bench_remus

THEIRS = """
import numpy as np
calls = []
class remus100:
    nu, u_actual = np.zeros(6), np.zeros(3)
    def stepInput(self, t):
        return np.array([0.1, 0.0, 1525.0])
    def dynamics(self, eta, nu, u, command, dt):
        calls.append(dt)
        return nu, u
"""
LOOP = """
def simulate(N, sampleTime, vehicle):
    for i in range(N + 1):
        vehicle.dynamics(None, vehicle.nu, vehicle.u_actual, vehicle.stepInput(i * sampleTime), sampleTime)
"""


def test_ours_goes_ahead_and_turns() -> None:
    ours = OurRemus()
    ours.run(2400)
    vehicle = ours._world.vehicles["auv"]
    assert vehicle.nu[0] > 1.0
    assert all(slot.timeouts == 0 for slot in ours._world.actuators.values())


def test_without_the_simulator_the_row_says_how_to_name_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for source in ("", str(tmp_path)):
        monkeypatch.setenv(VARIABLE, source)
        (row,) = bench_remus(True, lambda line: None)
        assert (row.verdict, row.at_least) == ("absent", BAR)
        assert "not measured" in row.note


def test_a_copy_is_measured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    package = tmp_path / "python_vehicle_simulator"
    for folder in ("vehicles", "lib"):
        (package / folder).mkdir(parents=True)
        (package / folder / "__init__.py").touch()
    (package / "__init__.py").touch()
    (package / "vehicles" / "remus100.py").write_text(THEIRS)
    (package / "lib" / "gnc.py").write_text("def attitudeEuler(eta, nu, dt):\n    return eta\n")
    (package / "lib" / "mainLoop.py").write_text(LOOP)
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    rows = bench_remus(True, lambda line: None)
    assert [row.unit for row in rows] == ["steps/s", "ratio", "ratio", "ratio"]
    assert [row.at_least for row in rows] == [None, BAR, BAR, None]
    assert all(len(row.values) == 2 for row in rows)
