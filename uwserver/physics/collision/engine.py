"""What `solids` asks of a collision engine, and which engine there is: one question, the shortest way out of an overlap.

All engines give the same contacts, as `directions` makes each answer exact. They differ where two ways out are equally long, and where
shapes are deep in each other.
"""

from __future__ import annotations

import math
from importlib.util import find_spec
from typing import TYPE_CHECKING, NamedTuple, Protocol

from uwserver.frames import multiply
from uwserver.physics.geometry.shapes import Capsule, Cylinder, Placed
from uwserver.physics.kernel.arrays import FloatArray

if TYPE_CHECKING:
    from uwserver.physics.geometry.rows import Part  # which compiles

AUTO = "auto"
_AXIS = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""Axis x of our cylinders and capsules is axis z of the engines'."""


class Pose(NamedTuple):
    """Where an engine's shape is: position (3) in N, m, and attitude (4), x y z w."""

    p: FloatArray
    q: FloatArray


class Engine(Protocol):
    """One world of convex shapes. Not thread-safe. What it answers depends on its arguments alone, not on what it was asked before."""

    name: str

    def add(self, placed: Placed, rows: Part) -> int:
        """Take a convex shape; returns its handle. Raises BadSolid if it cannot."""

    def close(self) -> None:
        """Give everything back; may be called twice."""

    def way_out(self, a: int, pose_a: Pose, b: int, pose_b: Pose) -> FloatArray:
        """The direction (3) in N in which shape a comes out of shape b soonest; NaN if the engine knows none."""


def engine_attitude(placed: Placed) -> tuple[float, float, float, float]:
    """Attitude of an engine's shape (w x y z) in the solid."""
    return multiply(placed.q, _AXIS) if isinstance(placed.shape, Cylinder | Capsule) else placed.q


_PACKAGES = {"bullet": "pybullet", "coal": "coal"}
ENGINES = tuple(_PACKAGES)
"""Names, in the order in which "auto" looks for them: recordings made so far are Bullet's, which has no wheels from CPython 3.12 on."""


def missing_engine(name: str = AUTO, instead: bool = True) -> str | None:
    """Why an engine cannot be had, and what to do; None if it can. Nothing is imported.

    Args:
        name: of `ENGINES`, or "auto".
        instead: whether to tell of another that is installed.
    """
    if name == AUTO:
        if any(find_spec(package) for package in _PACKAGES.values()):
            return None
        return 'neither pybullet nor coal is installed: pip install "uwserver[solid]"'
    package = _PACKAGES[name]
    if find_spec(package):
        return None
    others = [other for other in ENGINES if other != name and find_spec(_PACKAGES[other])]
    choice = f', or choose engine = "{others[0]}", which is installed' if others and instead else ""
    return f'the engine "{name}" needs {package}: pip install {package}{choice}'


def chosen_engine(name: str = AUTO) -> str:
    """What "auto" stands for on this machine: the first engine that is installed, or "auto" if none is. Other names stand for themselves."""
    if name != AUTO:
        return name
    return next((engine for engine, package in _PACKAGES.items() if find_spec(package)), AUTO)
