"""What a picture is made of: an instant of the world, and the pose of the camera. A camera needs it before any kernel is compiled."""

from __future__ import annotations

from typing import Any, NamedTuple

from uwserver.environment.light import Daylight, WaterLight
from uwserver.frames import Quat, Vec3
from uwserver.physics.kernel.arrays import FloatArray


class Pose(NamedTuple):
    """The pose of a camera: p_NS (m) and q_NS."""

    p: Vec3
    q: Quat


class View(NamedTuple):
    """Everything that a picture is made of, copied from the world at one instant.

    Attributes:
        t: simulation time, s.
        scene: a `visible.VisibleScene` of the things.
        state: (n, 13) state of the bodies.
        first, last: poses of the camera when the first and the last row of pixels are read.
        depth: depth of the camera below the surface, m; negative in air.
        water, day: light.
        lamps: `lamps.LampAt` of all lamps that shine.
        current: current of the water, m/s in N.
        own: row of the camera's vehicle; -1 for none.
    """

    t: float
    scene: Any
    state: FloatArray
    first: Pose
    last: Pose
    depth: float
    water: WaterLight
    day: Daylight
    lamps: tuple[Any, ...] = ()
    current: Vec3 = (0.0, 0.0, 0.0)
    own: int = -1


def quat_of(x: FloatArray) -> Quat:
    """Return the attitude of a state (13)."""
    w, i, j, k = x[3:7].tolist()
    return (w, i, j, k)
