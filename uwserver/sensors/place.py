"""What a sensor may know of others: where a vehicle is, how its mount tilts, where a structure stands."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from uwserver.frames import Quat, Vec3


class Place(Protocol):
    """Where another vehicle is."""

    @property
    def p_NB(self) -> Vec3:
        """Position of its origin in N, m."""

    @property
    def q_NB(self) -> Quat:
        """Its attitude."""

    @property
    def nu(self) -> tuple[float, ...]:
        """Its velocity, v_NB_B (m/s) and w_NB_B (rad/s)."""


class Standing(NamedTuple):
    """A `Place` of one instant."""

    p_NB: Vec3
    q_NB: Quat
    nu: tuple[float, ...]


class Joint(Protocol):
    """The actuator that tilts a mount."""

    @property
    def rate(self) -> float:
        """rad/s."""

    @property
    def memory(self) -> Any:
        """With the `tilt` (rad) that it was told."""


class Outline(NamedTuple):
    """The box around a structure.

    Attributes:
        p: its middle, m in N.
        q: its attitude in N.
        half: half of its edges, m.
    """

    p: Vec3
    q: Quat
    half: Vec3
