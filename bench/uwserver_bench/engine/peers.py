"""Other engines for the same job, for comparison: Bullet alone, Bullet with hydrodynamics in numpy, and the fluid model of MuJoCo.

pybullet and mujoco are optional. Making a peer whose engine is not installed raises ImportError.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray

SPACING_M = 5.0
"""Distance of the bodies: far enough that they never touch."""

MASS_KG, INERTIA_KGM2, SIZE_M = 13.5, (0.26, 0.23, 0.37), (0.457, 0.575, 0.254)
ADDED_MASS = (6.36, 7.12, 18.68, 0.189, 0.135, 0.222)
LINEAR_DAMPING, QUADRATIC_DAMPING = (13.7, 1.0, 33.0, 0.1, 0.8, 0.1), (141.0, 217.0, 190.0, 1.19, 0.47, 1.5)
WEIGHT_N, CENTER_OF_BUOYANCY_M = 132.57, (0.0, 0.0, -0.01)
PUSH = (8.0, 3.0, 2.0, 0.1, 0.1, 0.2)
"""Constant wrench on each body, N and N m; so a peer need not compute thrusters."""


class BulletBodies:
    """Free boxes in pybullet (DIRECT) that are only stepped: no simulator based on Bullet can be faster."""

    name, dt = "pybullet, bare step", 1.0 / 240.0

    def __init__(self, vehicles: int) -> None:
        self.vehicles = vehicles
        self._bullet: Any = importlib.import_module("pybullet")
        self._client = self._bullet.connect(self._bullet.DIRECT)
        self._bullet.setTimeStep(self.dt, physicsClientId=self._client)
        self._bodies = [self._box(k) for k in range(vehicles)]

    def _box(self, k: int) -> int:
        b, client = self._bullet, self._client
        shape = b.createCollisionShape(b.GEOM_BOX, halfExtents=[s / 2 for s in SIZE_M], physicsClientId=client)
        place = [SPACING_M * (k % 10), SPACING_M * (k // 10), 10.0]
        body = int(b.createMultiBody(MASS_KG, shape, basePosition=place, physicsClientId=client))
        b.changeDynamics(body, -1, linearDamping=0, angularDamping=0, physicsClientId=client)
        b.changeDynamics(body, -1, mass=MASS_KG, localInertiaDiagonal=list(INERTIA_KGM2), physicsClientId=client)
        return body

    def prepare(self) -> None:
        """Do nothing: free bodies need no reset."""

    def run(self, steps: int) -> None:
        """Make steps."""
        for _ in range(steps):
            self._bullet.stepSimulation(physicsClientId=self._client)

    def close(self) -> None:
        """Close the engine."""
        self._bullet.disconnect(physicsClientId=self._client)


class BulletWithNumpy(BulletBodies):
    """The usual way to simulate an underwater vehicle in Bullet: read pose and velocity, compute Fossen's model in numpy, apply the wrench, step."""

    name = "pybullet + numpy a vehicle"

    def __init__(self, vehicles: int) -> None:
        super().__init__(vehicles)
        self._M_RB, self._M_A = np.diag([MASS_KG] * 3 + list(INERTIA_KGM2)), np.diag(ADDED_MASS)
        self._M_inv = np.linalg.inv(self._M_RB + self._M_A)
        self._D_L, self._D_Q = np.diag(LINEAR_DAMPING), np.diag(QUADRATIC_DAMPING)
        self._push, self._r_b = np.array(PUSH), np.array(CENTER_OF_BUOYANCY_M)

    def prepare(self) -> None:
        """Bring all bodies to rest."""
        for body in self._bodies:
            self._bullet.resetBaseVelocity(body, [0, 0, 0], [0, 0, 0], physicsClientId=self._client)

    def run(self, steps: int) -> None:
        """Make steps: first the hydrodynamics of each body, then a step of the engine."""
        b, client = self._bullet, self._client
        for _ in range(steps):
            for body in self._bodies:
                _, q = b.getBasePositionAndOrientation(body, physicsClientId=client)
                v, w = b.getBaseVelocity(body, physicsClientId=client)
                R = np.array(b.getMatrixFromQuaternion(q)).reshape(3, 3)
                wrench = self._M_RB @ self._acceleration(R, np.concatenate([R.T @ np.array(v), R.T @ np.array(w)]))
                b.applyExternalForce(body, -1, wrench[:3].tolist(), [0, 0, 0], b.LINK_FRAME, physicsClientId=client)
                b.applyExternalTorque(body, -1, wrench[3:].tolist(), b.LINK_FRAME, physicsClientId=client)
            b.stepSimulation(physicsClientId=client)

    def _acceleration(self, R: FloatArray, nu: FloatArray) -> FloatArray:
        C = _coriolis(self._M_RB, nu) + _coriolis(self._M_A, nu)
        D = self._D_L + self._D_Q * np.abs(nu)
        buoyancy = R.T @ np.array([0.0, 0.0, WEIGHT_N])
        restoring = np.concatenate([np.zeros(3), np.cross(self._r_b, buoyancy)])
        acceleration: FloatArray = self._M_inv @ (self._push - C @ nu - D @ nu + restoring)
        return acceleration


def _coriolis(M: FloatArray, nu: FloatArray) -> FloatArray:
    """C(nu) of Fossen (2011), theorem 3.2."""
    a, b = M[:3, :3] @ nu[:3] + M[:3, 3:] @ nu[3:], M[3:, :3] @ nu[:3] + M[3:, 3:] @ nu[3:]
    C = np.zeros((6, 6))
    C[:3, 3:] = C[3:, :3] = -_skew(a)
    C[3:, 3:] = -_skew(b)
    return C


def _skew(a: FloatArray) -> FloatArray:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


class MujocoFluid:
    """MuJoCo's own fluid model: free bodies with ellipsoid fluid shape in water, Euler steps of 2 ms, no contacts, a constant wrench on each."""

    name, dt = "MuJoCo ellipsoid fluid, no thrusters", 0.002
    _thrusters: tuple[tuple[str, str], ...] = ()

    def __init__(self, vehicles: int) -> None:
        self.vehicles = vehicles
        self._mujoco: Any = importlib.import_module("mujoco")
        self._model = self._mujoco.MjModel.from_xml_string(_mujoco_xml(vehicles, self._thrusters))
        self._state = self._mujoco.MjData(self._model)

    def prepare(self) -> None:
        """Reset to rest, with the wrench."""
        self._mujoco.mj_resetData(self._model, self._state)
        self._state.xfrc_applied[1:] = PUSH

    def run(self, steps: int) -> None:
        """Make all steps in one call, without Python between them."""
        self._mujoco.mj_step(self._model, self._state, nstep=steps)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""


class MujocoVehicle(MujocoFluid):
    """The same with the eight thrusters of a BlueROV2 Heavy: actuators with a first-order lag that act at sites of the body."""

    name = "MuJoCo ellipsoid fluid + 8 thrusters"
    _thrusters = (
        ("0.156 0.111 0.085", "-1 1 0"), ("0.156 -0.111 0.085", "-1 -1 0"),
        ("-0.156 0.111 0.085", "1 1 0"), ("-0.156 -0.111 0.085", "1 -1 0"),
        ("0.12 0.218 0", "0 0 1"), ("0.12 -0.218 0", "0 0 1"), ("-0.12 0.218 0", "0 0 1"), ("-0.12 -0.218 0", "0 0 1"),
    )  # fmt: skip

    def prepare(self) -> None:
        """Reset to rest, with commands for the thrusters."""
        self._mujoco.mj_resetData(self._model, self._state)
        self._state.ctrl[:] = np.random.Generator(np.random.PCG64(1)).uniform(-0.5, 0.5, self._model.nu)


def _mujoco_xml(vehicles: int, thrusters: Sequence[tuple[str, str]]) -> str:
    half = " ".join(f"{s / 2:g}" for s in SIZE_M)
    inertia = " ".join(f"{i:g}" for i in INERTIA_KGM2)
    bodies, actuators = "", ""
    for k in range(vehicles):
        sites = "".join(f'<site name="t{k}_{i}" pos="{place}"/>' for i, (place, _) in enumerate(thrusters))
        bodies += (
            f'<body pos="{SPACING_M * (k % 10):g} {SPACING_M * (k // 10):g} 0"><freejoint/>'
            f'<inertial pos="0 0 0" mass="{MASS_KG:g}" diaginertia="{inertia}"/>'
            f'<geom type="box" size="{half}" fluidshape="ellipsoid" contype="0" conaffinity="0"/>{sites}</body>'
        )
        actuators += "".join(
            f'<general site="t{k}_{i}" gear="{axis} 0 0 0" dyntype="filter" dynprm="0.1" gainprm="30"/>'
            for i, (_, axis) in enumerate(thrusters)
        )
    option = f'<option timestep="{MujocoFluid.dt:g}" density="1000" viscosity="0.001" gravity="0 0 0"/>'
    return f"<mujoco>{option}<worldbody>{bodies}</worldbody><actuator>{actuators}</actuator></mujoco>"
