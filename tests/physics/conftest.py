"""What the physics proofs share: shipped vehicles as kernel parameters, oracle files, and bodies with every term switched on."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from uwserver.physics.dynamics.params import BodyParams, rigid_body_inertia
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.scenario.world.tables import Environment

sys.path.insert(0, str(Path(__file__).parent))

SHIPPED = Path(__file__).parents[2] / "scenarios" / "uwserver_scenarios"

LoadVehicle = Callable[..., BodyParams]


@functools.cache
def read_vehicle(name: str, **environment: float) -> BodyParams:
    """Kernel parameters of a shipped vehicle file, read once: no test writes to them."""
    vehicle = msgspec.toml.decode((SHIPPED / "vehicles" / f"{name}.toml").read_bytes(), type=VehicleFile)
    devices = {
        thruster: msgspec.toml.decode((SHIPPED / "devices" / f"{entry.device}.toml").read_bytes(), type=ThrusterDevice)
        for thruster, entry in vehicle.thrusters.items()
    }
    return body_params(vehicle, devices, Environment(**environment))


@pytest.fixture(scope="session")
def load_vehicle() -> LoadVehicle:
    """`load_vehicle("bluerov2_heavy", density_kgpm3=1000.0)` gives `BodyParams`."""
    return read_vehicle


@pytest.fixture(scope="session")
def t200() -> ThrusterDevice:
    """The shipped T200 device file."""
    return msgspec.toml.decode((SHIPPED / "devices" / "t200.toml").read_bytes(), type=ThrusterDevice)


@pytest.fixture(scope="session")
def t200_von_benzon() -> ThrusterDevice:
    """The T200 as identified on a vehicle."""
    return msgspec.toml.decode((SHIPPED / "devices" / "t200_von_benzon.toml").read_bytes(), type=ThrusterDevice)


@pytest.fixture(scope="session")
def oracles() -> Path:
    """Folder of the oracle files."""
    return Path(__file__).parent / "oracles"


@pytest.fixture
def full_body() -> BodyParams:
    """A body with every term: centre of gravity off the origin, full matrices, all damping forms; seeded."""
    rng = np.random.default_rng(7)
    root = rng.normal(size=(6, 6))
    damping = [0.2 * rng.normal(size=(6, 6)) + np.diag(rng.uniform(4.0, 8.0, 6)) for _ in range(3)]
    r_g = (0.05, -0.03, 0.08)
    return BodyParams(
        M_RB=rigid_body_inertia(12.0, np.array([[0.4, 0.02, -0.01], [0.02, 0.5, 0.03], [-0.01, 0.03, 0.6]]), r_g),
        M_A=root @ root.T + np.diag([4.0, 6.0, 9.0, 0.3, 0.2, 0.4]),
        D_L=damping[0],
        D_Q=damping[1],
        D_S=damping[2],
        weight=12.0 * 9.81,
        buoyancy=119.0,
        r_g=r_g,
        r_b=(0.04, -0.02, -0.1),
    )
