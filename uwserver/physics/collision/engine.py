"""The contract of a collision engine, and which engine is used. An engine answers one question: the shortest way out of an overlap.

All engines lead to the same contacts, as `directions` makes each answer exact. They differ if two ways out are equally long, or if shapes are deep in
each other.
"""

from __future__ import annotations

import math
from importlib.util import find_spec
from typing import TYPE_CHECKING, NamedTuple, Protocol

from uwserver.frames import multiply
from uwserver.packages import install_command
from uwserver.physics.geometry.shapes import Capsule, Cylinder, Placed
from uwserver.physics.kernel.arrays import FloatArray

if TYPE_CHECKING:
    from uwserver.physics.geometry.rows import Part  # which compiles

AUTO = "auto"
_AXIS = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""Axis x of our cylinders and capsules is axis z of those of the engines."""


class Pose(NamedTuple):
    """Place of an engine's shape: position (3) in N, m, and attitude (4), x y z w."""

    p: FloatArray
    q: FloatArray


class Engine(Protocol):
    """One world of convex shapes. Not thread-safe. Its answers depend on the arguments alone, not on earlier questions."""

    name: str

    def add(self, placed: Placed, rows: Part) -> int:
        """Take a convex shape and return its handle. Raise BadSolid if that is impossible."""

    def close(self) -> None:
        """Free everything; may be called twice."""

    def way_out(self, a: int, pose_a: Pose, b: int, pose_b: Pose) -> FloatArray:
        """Return the direction (3) in N in which shape a leaves shape b by the shortest way; NaN if the engine knows none."""


def engine_attitude(placed: Placed) -> tuple[float, float, float, float]:
    """Return the attitude of an engine's shape (w x y z) in the solid."""
    return multiply(placed.q, _AXIS) if isinstance(placed.shape, Cylinder | Capsule) else placed.q


_PACKAGES = {"bullet": "pybullet", "coal": "coal"}
ENGINES = tuple(_PACKAGES)
"""Names in the order in which "auto" looks for them. Recordings made so far used Bullet, which has no wheels from CPython 3.12 on."""


def missing_engine(name: str = AUTO, instead: bool = True) -> str | None:
    """Return why an engine is not available and what to do; None if it is available. Nothing is imported.

    Args:
        name: of `ENGINES`, or "auto".
        instead: whether to name another engine that is installed.
    """
    if name == AUTO:
        if any(find_spec(package) for package in _PACKAGES.values()):
            return None
        return f"neither pybullet nor coal is installed: {install_command('uwserver[solid]')}"
    package = _PACKAGES[name]
    if find_spec(package):
        return None
    others = [other for other in ENGINES if other != name and find_spec(_PACKAGES[other])]
    choice = f', or choose engine = "{others[0]}", which is installed' if others and instead else ""
    return f'the engine "{name}" needs {package}: {install_command(package)}{choice}'


def chosen_engine(name: str = AUTO) -> str:
    """Return the engine for "auto" on this machine: the first that is installed, or "auto" if none is. Other names are returned unchanged."""
    if name != AUTO:
        return name
    return next((engine for engine, package in _PACKAGES.items() if find_spec(package)), AUTO)
