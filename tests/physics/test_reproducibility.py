"""The same bits: again, in another process, and whatever else is in the world."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU

STEPS = 480


def drive(bodies: list[BodyParams]) -> FloatArray:
    """States (steps, n, 13) of bodies under seeded commands; what each one gets depends on its own thruster count only."""
    hydro = Hydrodynamics(bodies, 1.0 / 240.0)
    hydro.state[:, 2] = 0.5  # near the surface: the branches of partial immersion are taken too
    hydro.currents[:] = 0.2, -0.1, 0.05
    states = np.empty((STEPS, len(bodies), 13))
    for k in range(STEPS):
        if k % 24 == 0:
            for row, body in enumerate(hydro.bodies):
                rng = np.random.default_rng([k, int(body["thruster_count"]), int(body["weight"])])
                first, count = int(body["thruster_first"]), int(body["thruster_count"])
                hydro.thrusters["command"][first : first + count] = rng.uniform(-1.0, 1.0, count)
                hydro.thrusters["fresh"][first : first + count] = 1
                hydro.wrenches["bias"][row] = (
                    0.3 * body["weight"] * rng.uniform(-1.0, 1.0, 6) * (1, 1, 1, 0.1, 0.1, 0.1)
                )
        assert hydro.advance(k / 240.0) < 0
        states[k] = hydro.state
    return states


def digest(states: FloatArray) -> str:
    return hashlib.sha256(np.ascontiguousarray(states).tobytes()).hexdigest()


def test_a_repeat_has_the_same_bits(load_vehicle: Callable[..., BodyParams]) -> None:
    bodies = [load_vehicle("bluerov2_heavy"), load_vehicle("lauv")]
    assert digest(drive(bodies)) == digest(drive(bodies))


def test_another_process_has_the_same_bits(load_vehicle: Callable[..., BodyParams]) -> None:
    here = Path(__file__).parent
    code = (
        f"import sys; sys.path[:0] = [{str(here)!r}, *{sys.path!r}]\n"
        "from conftest import read_vehicle\n"
        "from test_reproducibility import digest, drive\n"
        "print(digest(drive([read_vehicle(name) for name in ('bluerov2_heavy', 'rexrov')])))\n"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.strip() == digest(drive([load_vehicle("bluerov2_heavy"), load_vehicle("rexrov")]))


def test_a_body_moves_the_same_alone_and_among_others(load_vehicle: Callable[..., BodyParams]) -> None:
    names = ["bluerov2", "bluerov2_heavy", "rexrov", "lauv", "eca_a9", "tethys", "bluerov2_heavy"]
    bodies = [load_vehicle(name) for name in names]
    together = drive(bodies)
    for row, body in enumerate(bodies):
        alone = drive([body])[:, 0]
        assert np.array_equal(alone, together[:, row]), names[row]
    assert np.abs(together[-1, :, NU:]).max() > 0.1


def test_adding_a_body_leaves_the_others_alone(load_vehicle: Callable[..., BodyParams]) -> None:
    def run(add: bool) -> FloatArray:
        hydro = Hydrodynamics([load_vehicle("bluerov2_heavy")], 1.0 / 240.0)
        hydro.state[0, 2] = 5.0
        hydro.thrusters["command"], hydro.thrusters["fresh"] = 0.4, 1
        for k in range(240):
            if add and k == 100:
                hydro.add(load_vehicle("bluerov2"))
            hydro.advance(k / 240.0)
        state: FloatArray = hydro.state[0].copy()
        return state

    assert np.array_equal(run(False), run(True))
