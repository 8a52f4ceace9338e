"""What a sensor shares with others: vehicles, sensors, mounts that tilt, structures, what cameras see, and code that writes its readings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from uwserver.environment.light import Daylight, WaterLight
from uwserver.frames import Quat, Vec3
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Field, Value


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


class FixedPlace(NamedTuple):
    """A `Place` at one instant."""

    p_NB: Vec3
    q_NB: Quat
    nu: tuple[float, ...]


class Joint(Protocol):
    """The actuator that tilts a mount."""

    @property
    def rate(self) -> float:
        """Largest rate of the tilt, rad/s."""

    @property
    def memory(self) -> Any:
        """The state of the actuator; its `tilt` (rad) is the last command."""


class Outline(NamedTuple):
    """The box around a structure.

    Attributes:
        p: centre of the box, m in N.
        q: attitude of the box in N.
        half: half the length of each edge, m.
    """

    p: Vec3
    q: Quat
    half: Vec3


class Latest(Protocol):
    """Another sensor of the same vehicle, for a sensor that repeats its readings or hears its sound."""

    @property
    def fields(self) -> tuple[Field, ...]:
        """Fields of its port."""

    @property
    def held(self) -> tuple[bool, tuple[Value, ...]] | None:
        """Validity and values of its last reading, errors included; None before the first one."""

    @property
    def held_ns(self) -> int:
        """Time of that reading."""

    @property
    def stream_numbers(self) -> range:
        """Numbers of its streams in the world; its own stream is the first."""

    @property
    def sensor(self) -> object:
        """The sensor itself."""

    @property
    def works(self) -> bool:
        """Whether it reads: it is switched on, and no fault keeps it silent."""


class Writing(NamedTuple):
    """How compiled code writes the readings of a sensor, as it does for autopilots (`autopilot.entries.tell_one`).

    Attributes:
        row: number of the sensor there.
        texts: the values that are no numbers, by the state that the sensor reports.
    """

    row: int
    texts: Sequence[tuple[Value, ...]]


class Sight(NamedTuple):
    """What cameras may see of a world. Pictures are made elsewhere, and only if somebody reads them.

    Attributes:
        water, day: light.
        scene: returns the `uwserver.sensors.optical.camera.visible.VisibleScene` of everything that is there now.
        lamps: returns all lamps that shine now, each as a `uwserver.sensors.optical.camera.lamps.LampAt`.
        state: returns the present state (n, 13) of all bodies.
    """

    water: WaterLight
    day: Daylight
    scene: Callable[[], Any]
    lamps: Callable[[], tuple[Any, ...]]
    state: Callable[[], FloatArray]
