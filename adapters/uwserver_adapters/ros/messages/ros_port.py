"""What the message table knows of a port besides the port itself: where its sensor is mounted, how exact it is, and the names of its frames."""

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
"""Standard deviation of a field: one number for each component, or one number for all."""
Make = Callable[[Sample], object | None]
"""Makes the message of a sample; returns None where the sample gives no message."""


@dataclass(frozen=True)
class Mount:
    """The pose of a sensor in B, the geometry of its beams in its own frame S, and what is known of its errors.

    Attributes:
        p: position of S in B, m.
        q: attitude of S in B (w x y z).
        beams: its single beams.
        fan: its fan of beams; None where it has none.
        sigmas: field -> standard deviation, in the field's unit; the deviation of a field that is not listed is unknown.
    """

    p: Vec3 = (0.0, 0.0, 0.0)
    q: Quat = IDENTITY
    beams: tuple[BeamView, ...] = ()
    fan: FanView | None = None
    sigmas: Mapping[str, Sigma] = field(default_factory=dict)


@dataclass(frozen=True)
class Facts:
    """What is the same for all topics.

    Attributes:
        epoch_ns: stamp of simulation time zero, ns since 1970.
        tick_s: duration of a physics tick, s.
        mounts: path of a sensor -> its mount.
        geoid_m: height of the sea surface above the ellipsoid, m; NavSatFix counts heights from the ellipsoid.
        truth: whether ground truth may be published.
        tf: source of the vehicles' poses on ``/tf``: "estimate" (the autopilot's), "truth", or "none".
    """

    epoch_ns: int = 0
    tick_s: float = 0.0
    mounts: Mapping[str, Mount] = field(default_factory=dict)
    geoid_m: float = 0.0
    truth: bool = False
    tf: str = "estimate"


def mounts_of(scene: SceneView) -> dict[str, Mount]:
    """Return the mounts of all sensors of a world, by path."""
    return {
        sensor.path: Mount(sensor.p, sensor.q, sensor.beams, sensor.fan, sensor.sigmas or {})
        for body in scene.vehicles
        for sensor in body.sensors
    }


@dataclass(frozen=True)
class SensorTopic:
    """A topic that is published from the samples of one port or several.

    Attributes:
        name: name of the topic.
        type: ``package/msg/Name``.
        ports: paths of the ports; more than one where a message combines several.
        make: makes the message of a sample, or returns None. Never raises for a sample of these ports.
        latched: late subscribers get the newest message too.
        cdr: makes the CDR bytes of a sample directly, for messages where that is worth it.
    """

    name: str
    type: str
    ports: tuple[str, ...]
    make: Make
    latched: bool = False
    cdr: Callable[[Sample], bytes | None] | None = None


def ros_name(path: str) -> str:
    """Return a path as ROS allows names: letters, digits and underscores, and no level that begins with a digit."""
    levels = [re.sub(r"[^A-Za-z0-9_]", "_", level) for level in path.split("/")]
    return "/".join(level if level[:1].isalpha() else f"_{level}".replace("__", "_") for level in levels)


class RosPort:
    """One sensor port, as the functions that make its topics see it.

    Args:
        types: message types of the distribution.
        facts: what is the same for all topics.
        port: the sensor port.

    Attributes:
        types, facts, port: as given.
        name: its topic without a suffix, ``/vehicle/sensor``.
        vehicle: first level of the name.
        frame: frame of its measurements, ``vehicle/sensor``: FLU axes at the mount.
        base: FLU frame of the vehicle, ``vehicle/base_link``.
        mount: mount of the sensor; None where it is unknown.
    """

    def __init__(self, types: Types, facts: Facts, port: Port) -> None:
        self.types, self.facts, self.port = types, facts, port
        self.name = "/" + ros_name(port.path)
        self.vehicle = self.name.split("/")[1]
        self.base = f"{self.vehicle}/base_link"
        # The port of a stream belongs to the sensor one level above it.
        above = port.path.rsplit("/", 1)[0]
        owner = above if port.path not in facts.mounts and above in facts.mounts else port.path
        self.mount = facts.mounts.get(owner)
        self.frame = ros_name(owner) if self.mount is not None else self.base

    def bind(self, *names: str) -> Callable[[tuple[Value, ...]], Any]:
        """Return a getter of some fields of a sample's value: it gives the value of one field, or a tuple for several.

        Raises:
            ValueError: the port has no such field.
        """
        known = [field.name for field in self.port.fields]
        missing = [name for name in names if name not in known]
        if missing:
            raise ValueError(f'"{self.port.path}" has no field "{missing[0]}", it has: {", ".join(known)}')
        return itemgetter(*(known.index(name) for name in names))

    def complete(
        self, required: tuple[str, ...], make: Callable[..., object | None], optional: tuple[str, ...] = ()
    ) -> Make:
        """Return a maker that makes messages of complete measurements only.

        A sample that is not valid, or lacks a required field (or one component of it), gives no message.

        Args:
            required: fields that a sample must have.
            make: gets the sample, then the values of the required and of the optional fields.
            optional: further fields; the value of such a field may be None.

        Raises:
            ValueError: the port has no such field.
        """
        names, count = (*required, *optional), len(required)
        get = self.bind(*names)

        def made(sample: Sample) -> object | None:
            if not sample.valid:
                return None
            values = get(sample.value) if len(names) > 1 else (get(sample.value),)
            return make(sample, *values) if all(map(is_whole, values[:count])) else None

        return made

    def has(self, *names: str) -> bool:
        """Return whether the port has all these fields."""
        return {field.name for field in self.port.fields}.issuperset(names)

    def header(self, sample: Sample, frame: str | None = None) -> object:
        """Return a Header stamped with the time of measurement; its frame is that of the sensor by default."""
        return self.types.header(self.facts.epoch_ns + sample.t_ns, self.frame if frame is None else frame)

    def variances(self, name: str, size: int = 3) -> tuple[float, ...]:
        """Return the configured variance of each component of a field. Zeros mean unknown, as ROS has it.

        The errors of a stream differ from those of its sensor and are unknown.
        """
        mount = self.facts.mounts.get(self.port.path)
        sigma = mount.sigmas.get(name, 0.0) if mount is not None else 0.0
        parts = sigma if isinstance(sigma, tuple) else (sigma,)
        parts = parts * size if len(parts) == 1 else parts
        return tuple(part * part for part in parts)

    def sensor_topic(
        self, suffix: str, type_name: str, make: Make, latched: bool = False, cdr: Callable[[Sample], bytes | None] | None = None
    ) -> SensorTopic:  # fmt: skip
        """Return a topic of this port, whose name is that of the port and a suffix."""
        return SensorTopic(self.name + suffix, type_name, (self.port.path,), make, latched, cdr)


def number(value: Value) -> float:
    """Return a number; NaN for None."""
    return math.nan if value is None else float(value)  # type: ignore[arg-type]  # callers give numbers


def numbers(value: Sequence[float | None]) -> NDArray[np.float64]:
    """Return an array with NaN for each None."""
    return np.array([math.nan if part is None else part for part in value], np.float64)


def is_whole(value: Any) -> bool:
    """Return whether a field has a value: for a vector, whether every component has one."""
    return value is not None and not (isinstance(value, tuple) and None in value)


def diagonal(*variances: float) -> NDArray[np.float64]:
    """Return a covariance without correlations, row-major."""
    return np.diag(np.array(variances, np.float64)).ravel()


def unknown(size: int = 9) -> NDArray[np.float64]:
    """Return a covariance whose first element, -1, says that the quantity is not measured."""
    made = np.zeros(size)
    made[0] = -1.0
    return made
