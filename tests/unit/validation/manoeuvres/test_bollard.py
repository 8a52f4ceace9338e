"""Held fast, a vehicle shows what its commands make, whatever its damping and its buoyancy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from manoeuvre_rig import RAFT, helm

from uwserver.physics.bodies import Hydrodynamics
from uwserver.validation.manoeuvres.bollard import bollard


def test_each_command_has_its_wrench(tmp_path: Path) -> None:
    """50 N at 0.3 m to either side and 5 cm below the origin; nothing at rest."""

    def port(hydro: Hydrodynamics, row: int) -> None:
        hydro.thrusters["command"][2 * row], hydro.thrusters["fresh"][2 * row] = 1.0, 1

    def still(_hydro: Hydrodynamics, _row: int) -> None:
        pass

    wrench = bollard(helm(tmp_path, RAFT).body, [still, port])
    np.testing.assert_allclose(wrench, [[0.0] * 6, [50.0, 0.0, 0.0, 0.0, 2.5, 15.0]], atol=1e-6)
