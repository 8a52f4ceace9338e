"""Compares the production integrator with a reference trajectory (an oracle file).

An oracle file is JSON of the format ``uwserver-oracle-1``. It has one body in unbounded water with its matrices, a harmonic wrench, a uniform
current, and the states that an independent integration with tighter tolerances reached. Its ``law`` is the equation of
`uwserver.physics.dynamics.fossen`.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta, Struct

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, P, Q
from uwserver.units import deg

FORMAT = "uwserver-oracle-1"

Vector3 = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]
Matrix6 = tuple[Six, Six, Six, Six, Six, Six]
StateRow = Annotated[tuple[float, ...], Meta(min_length=13, max_length=13)]


class OracleWrench(Struct, frozen=True):
    """tau(t) = amplitude sin(omega t + phase) + bias about the body origin, components in `frame`."""

    frame: Literal["B", "N"]
    amplitude: Six
    omega_radps: Six
    phase_rad: Six
    bias: Six


class Oracle(Struct, frozen=True):
    """The keys of an oracle file that a run needs, in SI units and the frames N and B. Other keys (description, law, ...) are ignored."""

    weight_N: float
    buoyancy_N: float
    r_g_B: Vector3
    r_b_B: Vector3
    M_RB: Matrix6
    M_A: Matrix6
    D_linear: Matrix6
    D_quadratic: Matrix6
    D_speed: Matrix6
    current_N_mps: Vector3
    wrench: OracleWrench
    state0: StateRow
    t_s: Annotated[tuple[float, ...], Meta(min_length=1)]
    states: tuple[StateRow, ...]


class _Header(Struct, frozen=True):
    format: str | None = None


class Worst(NamedTuple):
    """The largest error over all samples, and its time, s."""

    error: float
    t_s: float


class OracleResult(NamedTuple):
    """The largest errors of a run, compared with the oracle's samples.

    Attributes:
        position: m.
        attitude: angle of the rotation between the two attitudes, degrees.
        linear_velocity: m/s.
        angular_velocity: rad/s.
        rate_hz: rate of the integrator; steps were at most 1 / rate_hz long.
        samples: number of samples that were compared.
        steps: number of steps that were taken.
    """

    position: Worst
    attitude: Worst
    linear_velocity: Worst
    angular_velocity: Worst
    rate_hz: float
    samples: int
    steps: int


def validate(path: Path, rate_hz: float = 240) -> OracleResult:
    """Integrate an oracle file, and compare the states with each of its samples.

    Each interval between samples is divided into the smallest number of equal steps of at most 1 / rate_hz, so that steps end at samples.

    Raises:
        OSError: the file cannot be read.
        ValueError: it has another format, a key is missing or wrong, or the run diverged; the text names it.
    """
    if not rate_hz > 0.0:
        raise ValueError(f"the rate must be positive, found {rate_hz}")
    oracle = load_oracle(path)
    states, steps = run(oracle, rate_hz)
    return _compare(oracle, states, rate_hz, steps)


def load_oracle(path: Path) -> Oracle:
    """Read and check an oracle file. Raises the errors of `validate`."""
    text = path.read_bytes()
    try:
        header = msgspec.json.decode(text, type=_Header)
    except msgspec.MsgspecError as error:
        raise ValueError(f'{path}: not a JSON object with "format": "{FORMAT}" ({error})') from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not JSON, which is UTF-8 text ({error})") from error
    if header.format != FORMAT:
        found = "none" if header.format is None else f'"{header.format}"'
        raise ValueError(f'{path}: format {found} found, "{FORMAT}" expected')
    try:
        oracle = msgspec.json.decode(text, type=Oracle)
    except msgspec.MsgspecError as error:
        raise ValueError(f"{path}: {error}") from error
    if fault := _fault(oracle):
        raise ValueError(f"{path}: {fault}")
    return oracle


def _fault(oracle: Oracle) -> str:
    """Return what is wrong with a well-formed oracle, or ""."""
    M_RB, M_A = np.array(oracle.M_RB), np.array(oracle.M_A)
    for name, M in (("M_RB", M_RB), ("M_A", M_A)):
        if np.abs(M - M.T).max() > 1e-9 * np.abs(M).max():
            return f"{name}: symmetric matrix expected"
    if not np.linalg.eigvalsh(M_RB + M_A).min() > 0.0:
        return "M_RB + M_A: positive definite matrix expected"
    if len(oracle.states) != len(oracle.t_s):
        return f"states: one row for each of the {len(oracle.t_s)} times of t_s expected, {len(oracle.states)} found"
    if oracle.t_s[0] < 0.0 or any(a >= b for a, b in zip(oracle.t_s, oracle.t_s[1:], strict=False)):
        return "t_s: rising times from 0 on expected"
    if any(math.hypot(*row[Q : Q + 4]) == 0.0 for row in (oracle.state0, *oracle.states)):
        return "state0, states: unit quaternions (w, x, y, z) in columns 4 to 7 expected, one is zero"
    return ""


def build(oracle: Oracle) -> Hydrodynamics:
    """Return a world with the oracle's body in its initial state, with its wrench and current."""
    body = BodyParams(
        M_RB=np.array(oracle.M_RB),
        M_A=np.array(oracle.M_A),
        D_L=np.array(oracle.D_linear),
        D_Q=np.array(oracle.D_quadratic),
        D_S=np.array(oracle.D_speed),
        weight=oracle.weight_N,
        buoyancy=oracle.buoyancy_N,
        r_g=oracle.r_g_B,
        r_b=oracle.r_b_B,
    )
    hydro = Hydrodynamics([body], 0.0)
    hydro.state[0] = oracle.state0
    hydro.state[0, Q : Q + 4] /= np.linalg.norm(hydro.state[0, Q : Q + 4])
    hydro.currents[0] = oracle.current_N_mps
    wrench = hydro.wrenches[0]
    wrench["frame"] = int(oracle.wrench.frame == "N")
    for key, value in (("bias", "bias"), ("amplitude", "amplitude"), ("omega", "omega_radps"), ("phase", "phase_rad")):
        wrench[key] = getattr(oracle.wrench, value)
    wrench["harmonic"] = 1
    return hydro


def run(oracle: Oracle, rate_hz: float) -> tuple[FloatArray, int]:
    """Return the states (n, 13) at the oracle's times, and the number of steps. Raises ValueError if the run diverged."""
    hydro = build(oracle)
    # state0 is the state at t = 0, where the time of the wrench starts, unless the first sample repeats it.
    t = oracle.t_s[0] if tuple(oracle.states[0]) == tuple(oracle.state0) else 0.0
    states, total = np.empty((len(oracle.t_s), 13)), 0
    for k, goal in enumerate(oracle.t_s):
        # The small offset keeps rounding errors from adding a step.
        steps = math.ceil((goal - t) * rate_hz - 1e-9)
        for i in range(steps):
            hydro.dt = (goal - t) / steps
            if hydro.advance(t + i * hydro.dt) >= 0:
                raise ValueError(f"the run diverged before t = {goal} s at {rate_hz} Hz: raise the rate")
        states[k], t, total = hydro.state[0], goal, total + steps
    return states, total


def _compare(oracle: Oracle, states: FloatArray, rate_hz: float, steps: int) -> OracleResult:
    expected = np.array(oracle.states)

    def worst(errors: FloatArray) -> Worst:
        k = int(np.argmax(errors))
        return Worst(float(errors[k]), oracle.t_s[k])

    def distance(first: int) -> Worst:
        return worst(np.linalg.norm((states - expected)[:, first : first + 3], axis=1))

    angles = [deg(_angle(a[Q : Q + 4], b[Q : Q + 4])) for a, b in zip(states, expected, strict=True)]
    return OracleResult(
        distance(P), worst(np.array(angles)), distance(NU), distance(NU + 3), rate_hz, len(oracle.t_s), steps
    )  # fmt: skip


def _angle(a: FloatArray, b: FloatArray) -> float:
    """Return the angle (rad) between two attitudes.

    It is exact for small angles, unlike an arc cosine, and does not depend on the sign and length of the quaternions.
    """
    w = float(a @ b)
    v = a[0] * b[1:] - b[0] * a[1:] - np.cross(a[1:], b[1:])
    return 2.0 * math.atan2(float(np.linalg.norm(v)), abs(w))
