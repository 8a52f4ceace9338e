"""Mappings: they say which fields of a log give the pose of a body or the samples of a port, and in which units and axes they are.

`uwserver log FILE --mapping` prints the mapping that `uwserver.logfiles.rules` finds, for editing. `uwserver.logfiles.poses` and
`uwserver.logfiles.ports` use mappings to convert logs to NED, FRD and SI; no other code converts them.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from collections.abc import Mapping as Mapping_
from pathlib import Path
from typing import Any, Literal

import msgspec
import tomli_w
from msgspec import Struct

from uwserver.logfiles.log import LogError
from uwserver.logfiles.si import scale_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FORMAT = "uwserver-log-mapping-1"
ACTUATOR_UNITS: Mapping_[str, Literal["part", "angle", "pulse"]] = {
    "1": "part", "%": "part", "us": "pulse", "rad": "angle", "deg": "angle"
}  # fmt: skip
_MOST_BYTES = 1 << 20

Axes = Literal["NED/FRD", "ENU/FLU"]
"""World and body axes of an attitude: those of aerospace, or those of ROS (REP 103)."""
Match = dict[str, str | float | int | bool]


class Value(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The place of one number in a log.

    Attributes:
        field: name of the field, with dots for nested messages: ``pose.position.x``, ``q.0``.
        topic: its topic, if it differs from that of the section.
        unit: its unit, if it differs from that of the section.
        scale: additional factor; -1.0 reverses an axis.
    """

    field: str
    topic: str = ""
    unit: str | None = None
    scale: float = 1.0


Entry = Value | str
"""A value, or only the name of the field."""


class Section(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """Values that belong together.

    Attributes:
        topic: topic of all values that name no other topic.
        unit: unit of all values that name no other unit.
        where: only data whose fields have these values are used: ``{ C = 0 }``.
    """

    topic: str = ""
    unit: str = ""
    where: Match = {}

    def values(self) -> Iterator[tuple[str, Value]]:
        """Yield each given value with its key; the topic and unit of the section are filled in."""
        for name in self.__struct_fields__:
            entry = getattr(self, name)
            if name not in ("topic", "unit", "angle_unit", "where", "axes") and entry is not None:
                yield name, self._filled(entry, self._unit_of(name))

    def _unit_of(self, name: str) -> str:
        return self.unit

    def _filled(self, entry: Entry, unit: str) -> Value:
        value = value_of(entry)
        return Value(value.field, value.topic or self.topic, unit if value.unit is None else value.unit, value.scale)


class Position(Section, frozen=True, kw_only=True):
    """The place of the body: north and east, or latitude and longitude (in `angle_unit`); and one of down, depth, up, altitude."""

    unit: str = "m"
    angle_unit: str = "deg"
    north: Entry | None = None
    east: Entry | None = None
    latitude: Entry | None = None
    longitude: Entry | None = None
    down: Entry | None = None
    depth: Entry | None = None
    up: Entry | None = None
    altitude: Entry | None = None

    def _unit_of(self, name: str) -> str:
        return self.angle_unit if name in ("latitude", "longitude") else self.unit


class Velocity(Section, frozen=True, kw_only=True):
    """The velocity in world axes: north, east and one of down, up; or in body axes: forward, one of right, left, and one of down, up."""

    unit: str = "m/s"
    north: Entry | None = None
    east: Entry | None = None
    down: Entry | None = None
    up: Entry | None = None
    forward: Entry | None = None
    right: Entry | None = None
    left: Entry | None = None


class Attitude(Section, frozen=True, kw_only=True):
    """The attitude: a quaternion w, x, y, z; or roll, pitch and yaw, of which only yaw is required."""

    unit: str = "rad"
    axes: Axes = "NED/FRD"
    w: Entry | None = None
    x: Entry | None = None
    y: Entry | None = None
    z: Entry | None = None
    roll: Entry | None = None
    pitch: Entry | None = None
    yaw: Entry | None = None


class Actuators(Section, frozen=True, kw_only=True):
    """The outputs of thrusters, fins and propellers; they are shown in views, but do not move the body.

    Attributes:
        unit: "1" for a part of the full output (-1 to 1), "us" for the pulses of a servo (1100 to 1900), or an angle for fins.
        outputs: by the name of the actuator in the vehicle file, or by its number in the order of that file, from 1.
    """

    unit: str = "1"
    outputs: dict[str, Entry] = {}

    def values(self) -> Iterator[tuple[str, Value]]:
        """Yield the value of each output with the name of the actuator, as `Section.values`."""
        return ((name, self._filled(entry, self.unit)) for name, entry in self.outputs.items())


class Track(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The pose of one body over time. Without an attitude the body is level and heads north."""

    position: Position
    attitude: Attitude | None = None
    velocity: Velocity | None = None
    actuators: Actuators | None = None

    def sections(self) -> Iterator[tuple[str, Section]]:
        """Yield the name and the section of each section that is given."""
        for name in self.__struct_fields__:
            section = getattr(self, name)
            if section is not None:
                yield name, section


class PortMapping(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The samples of one port.

    Attributes:
        topic: each datum of this topic gives one sample.
        fields: the fields of the port: a value each, or a list of values for a vector.
        kind: kind of the port, which views use to choose how to show it.
        where: as in `Section`.
    """

    topic: str
    fields: dict[str, Entry | list[Entry]]
    kind: str = ""
    where: Match = {}


class Origin(Struct, frozen=True, forbid_unknown_fields=True):
    """The origin of N on the Earth, in degrees. Without it, each track begins at its own first fix."""

    latitude_deg: float
    longitude_deg: float


class Mapping(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The tracks and ports that a log gives, by name."""

    format: str = FORMAT
    origin: Origin | None = None
    tracks: dict[str, Track] = {}
    ports: dict[str, PortMapping] = {}


def read_mapping(path: str | Path) -> Mapping:
    """Read a mapping from a file.

    Raises:
        LogError: the file cannot be read, is not TOML, or has wrong keys, units or sections; the text says where.
    """
    try:
        with Path(path).open("rb") as file:
            raw = file.read(_MOST_BYTES + 1)
        if len(raw) > _MOST_BYTES:
            raise LogError(f"{path}: the file is larger than {_MOST_BYTES} bytes, so it is not a mapping")
        return parse_mapping(raw.decode())
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise LogError(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from error


def parse_mapping(text: str) -> Mapping:
    """Read a mapping from its text.

    Raises:
        ValueError: as `read_mapping`, without the name of the file.
    """
    mapping = msgspec.convert(tomllib.loads(text), Mapping)
    if mapping.format != FORMAT:
        raise ValueError(f'unknown format "{mapping.format}"; this version reads "{FORMAT}"')
    for name, track in mapping.tracks.items():
        _check_track(f"tracks.{name}", track)
    for name, port in mapping.ports.items():
        for field, entries in port.fields.items():
            for entry in entries if isinstance(entries, list) else [entries]:
                _check_unit(f"ports.{name}.{field}", value_of(entry).unit)
    return mapping


def mapping_text(mapping: Mapping) -> str:
    """Return a mapping as TOML that `parse_mapping` reads: one line for each section, with its units and axes written out."""
    lines = [f"format = {_toml(FORMAT)}"]
    if mapping.origin is not None:
        lines += ["", "[origin]", *(f"{key} = {_toml(v)}" for key, v in msgspec.to_builtins(mapping.origin).items())]
    for name, track in mapping.tracks.items():
        lines += ["", f"[tracks.{_key(name)}]"]
        for key, section in track.sections():
            written = {"topic": section.topic, "unit": section.unit, **_plain(section)}
            if isinstance(section, Position) and section.latitude is not None:
                written["angle_unit"] = section.angle_unit
            if isinstance(section, Attitude):
                written["axes"] = section.axes
            lines.append(f"{key} = {_toml({k: v for k, v in written.items() if k != 'topic' or v})}")
    for name, port in mapping.ports.items():
        lines += ["", f"[ports.{_key(name)}]"]
        lines += [f"{key} = {_toml(v)}" for key, v in _plain(port).items() if key != "fields"]
        lines += [f"fields.{_key(key)} = {_toml(_plain(entry))}" for key, entry in port.fields.items()]
    return "\n".join(lines) + "\n"


def _plain(value: object) -> Any:
    """Return a value as dictionaries, lists and scalars, without factors of 1, which msgspec does not take for the default."""
    raw = msgspec.to_builtins(value)
    if isinstance(raw, list):
        return [_plain(v) for v in raw]
    if isinstance(raw, dict):
        return {k: _plain(v) for k, v in raw.items() if not (k == "scale" and v == 1.0)}
    return raw


def _toml(value: object) -> str:
    """Return a TOML value on one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(str(k))} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return tomli_w.dumps({"v": value}).removeprefix("v = ").rstrip("\n")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _toml(name)


def value_of(entry: Entry) -> Value:
    """Return an entry as a `Value`."""
    return Value(entry) if isinstance(entry, str) else entry


def one_of(section: Section, *names: str) -> str:
    """Return the first of these keys that the section gives; "" when it gives none."""
    return next((name for name in names if getattr(section, name) is not None), "")


def _check_track(where: str, track: Track) -> None:
    position = track.position
    geographic = position.latitude is not None and position.longitude is not None
    if geographic == (position.north is not None and position.east is not None):
        raise ValueError(f"{where}.position: give north and east, or latitude and longitude")
    _only_one(f"{where}.position", position, "down", "depth", "up", "altitude")
    if (velocity := track.velocity) is not None:
        if velocity.forward is not None:
            _only_one(f"{where}.velocity", velocity, "right", "left")
        elif velocity.north is None or velocity.east is None:
            raise ValueError(f"{where}.velocity: give north and east, or forward and right or left")
        _only_one(f"{where}.velocity", velocity, "down", "up")
    if (attitude := track.attitude) is not None:
        quaternion = [getattr(attitude, name) is not None for name in "wxyz"]
        if any(quaternion) != all(quaternion) or any(quaternion) == (attitude.yaw is not None):
            raise ValueError(f"{where}.attitude: give w, x, y and z, or yaw (and roll and pitch)")
    for name, section in track.sections():
        for key, value in section.values():
            if not value.topic:
                raise ValueError(f"{where}.{name}.{key}: give the topic, here or in the section")
            _check_unit(f"{where}.{name}.{key}", value.unit)
            if name == "actuators" and value.unit not in ACTUATOR_UNITS:
                known = ", ".join(f'"{unit}"' for unit in ACTUATOR_UNITS)
                raise ValueError(
                    f'{where}.actuators.{key}: no actuator has the unit "{value.unit}"; possible are {known}'
                )


def _only_one(where: str, section: Section, *names: str) -> None:
    given = [name for name in names if getattr(section, name) is not None]
    if len(given) > 1 or (not given and "depth" not in names):
        raise ValueError(f"{where}: give one of {', '.join(names)}{f', not {len(given)}' if given else ''}")


def _check_unit(where: str, unit: str | None) -> None:
    try:
        scale_of(unit or "")
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
