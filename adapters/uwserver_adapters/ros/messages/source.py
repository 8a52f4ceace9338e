"""What the table of messages knows of a port besides the port: where its sensor sits, how exact it is, and what its frames are called."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwserver.frames import IDENTITY, Quat, Vec3
from uwserver.ports import BeamView, FanView, Port, Sample, SceneView, Value
from uwserver_adapters.ros.messages.types import Types

Sigma = float | tuple[float, ...]
"""Standard deviation of a field: of each component, or one for all."""
Make = Callable[[Sample], object | None]
"""A message of a sample; None where this one gives none."""


@dataclass(frozen=True)
class Mount:
    """Where a sensor sits in B, what it sends out (its frame S), and what is known of its errors.

    Attributes:
        sigmas: field -> standard deviation, in the field's unit; a field that is not there has an unknown one.
    """

    p: Vec3 = (0.0, 0.0, 0.0)
    q: Quat = IDENTITY
    beams: tuple[BeamView, ...] = ()
    fan: FanView | None = None
    sigmas: Mapping[str, Sigma] = field(default_factory=dict)


@dataclass(frozen=True)
class Facts:
    """What holds for all topics.

    Attributes:
        epoch_ns: stamp of simulation time zero, ns since 1970.
        tick_s: time of a tick of the physics.
        mounts: path of a sensor -> its mount.
        geoid_m: height of the sea surface above the ellipsoid; NavSatFix wants heights above the latter.
        truth: whether ground truth may be told.
        tf: who tells where vehicles are, on ``/tf``: the autopilot's estimate, the truth, or nobody.
    """

    epoch_ns: int = 0
    tick_s: float = 0.0
    mounts: Mapping[str, Mount] = field(default_factory=dict)
    geoid_m: float = 0.0
    truth: bool = False
    tf: str = "estimate"


def mounts_of(scene: SceneView) -> dict[str, Mount]:
    """The mounts of all sensors of a world."""
    return {
        sensor.path: Mount(sensor.p, sensor.q, sensor.beams, sensor.fan, sensor.sigmas or {})
        for body in scene.vehicles
        for sensor in body.sensors
    }


@dataclass(frozen=True)
class Outlet:
    """A topic that samples of some ports become.

    Attributes:
        topic: its name.
        type: ``package/msg/Name``.
        ports: paths; of more than one port where a message tells of several.
        make: the message of a sample; None where it gives none. Never raises for a sample of these ports.
        latched: the newest message is for late comers too.
        cdr: makes the bytes at once, where that is worth it.
    """

    topic: str
    type: str
    ports: tuple[str, ...]
    make: Make
    latched: bool = False
    cdr: Callable[[Sample], bytes | None] | None = None


def ros_name(path: str) -> str:
    """A path as ROS allows it: letters, digits and underscores, no level that begins with a digit."""
    levels = [re.sub(r"[^A-Za-z0-9_]", "_", level) for level in path.split("/")]
    return "/".join(level if level[:1].isalpha() else f"_{level}".replace("__", "_") for level in levels)


class Source:
    """One port, for the functions that make its topics.

    Args:
        types: of the distribution.
        facts: of the world.
        port: a sensor.

    Attributes:
        types, facts, port: as given.
        name: its topic without a suffix, ``/vehicle/sensor``.
        vehicle: first level of the name.
        frame: of its measurements, FLU axes at the mount: ``vehicle/sensor``.
        base: FLU frame of the vehicle, ``vehicle/base_link``.
        mount: of the sensor; None where nothing is known.
    """

    def __init__(self, types: Types, facts: Facts, port: Port) -> None:
        self.types, self.facts, self.port = types, facts, port
        self.name = "/" + ros_name(port.path)
        self.vehicle = self.name.split("/")[1]
        self.base = f"{self.vehicle}/base_link"
        owner = sensor_of(port.path, facts.mounts)
        self.mount = facts.mounts.get(owner)
        self.frame = ros_name(owner) if self.mount is not None else self.base

    def bind(self, *names: str) -> Callable[[tuple[Value, ...]], Any]:
        """A getter of some fields of a sample's value: of one its value, of several a tuple.

        Raises:
            ValueError: the port has no such field.
        """
        known = [field.name for field in self.port.fields]
        missing = [name for name in names if name not in known]
        if missing:
            raise ValueError(f'"{self.port.path}" has no field "{missing[0]}", it has: {", ".join(known)}')
        return itemgetter(*(known.index(name) for name in names))

    def has(self, *names: str) -> bool:
        """Whether the port has all these fields."""
        return {field.name for field in self.port.fields}.issuperset(names)

    def header(self, sample: Sample, frame: str | None = None) -> object:
        """Stamped with the time of measurement."""
        return self.types.header(self.facts.epoch_ns + sample.t_ns, self.frame if frame is None else frame)

    def variances(self, name: str, size: int = 3) -> tuple[float, ...]:
        """Configured variance of each component of a field; zeros where it is unknown, as ROS says that. A stream has errors of its own, which
        are not known here."""
        is_own = self.mount is not None and self.port.path in self.facts.mounts
        sigma = self.mount.sigmas.get(name, 0.0) if is_own and self.mount is not None else 0.0
        parts = sigma if isinstance(sigma, tuple) else (sigma,)
        parts = parts * size if len(parts) == 1 else parts
        return tuple(part * part for part in parts)

    def outlet(
        self, suffix: str, type_name: str, make: Make, latched: bool = False, cdr: Callable[[Sample], bytes | None] | None = None
    ) -> Outlet:  # fmt: skip
        """A topic of this port, below its name."""
        return Outlet(self.name + suffix, type_name, (self.port.path,), make, latched, cdr)


def sensor_of(path: str, mounts: Mapping[str, Mount]) -> str:
    """The sensor that a port belongs to: itself, or what a stream is a stream of."""
    above = path.rsplit("/", 1)[0]
    return above if path not in mounts and above in mounts else path


def number(value: Value) -> float:
    """A number; nan for none."""
    return math.nan if value is None else float(value)  # type: ignore[arg-type]  # callers give numbers


def numbers(value: Sequence[float | None]) -> NDArray[np.float64]:
    """An array; nan for each that there is not."""
    return np.array([math.nan if part is None else part for part in value], np.float64)


def is_whole(value: Any) -> bool:
    """Whether a field has its value: of a vector every component."""
    return value is not None and not (isinstance(value, tuple) and None in value)


def diagonal(*variances: float) -> NDArray[np.float64]:
    """A covariance without correlations, row-major."""
    return np.diag(np.array(variances, np.float64)).ravel()


def unknown(size: int = 9) -> NDArray[np.float64]:
    """A covariance whose first element says that the quantity is not measured."""
    made = np.zeros(size)
    made[0] = -1.0
    return made
