"""A mapping: which fields of a log give the pose of which body, and the samples of which port; in which units and axes they are.

`uwserver log FILE --mapping` prints one that `uwserver.logfiles.rules` found, to be edited. All conversions to NED, FRD and SI happen by it, in
`uwserver.logfiles.poses` and `uwserver.logfiles.samples`, and nowhere else.
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
SECTIONS = ("position", "attitude", "velocity", "actuators")
"""Of a track."""
ACTUATOR_UNITS: Mapping_[str, Literal["part", "angle", "pulse"]] = {
    "1": "part", "%": "part", "us": "pulse", "rad": "angle", "deg": "angle"
}  # fmt: skip
_MOST_BYTES = 1 << 20

Axes = Literal["NED/FRD", "ENU/FLU"]
"""World and body of an attitude: aerospace, or ROS (REP 103)."""
Match = dict[str, str | float | int | bool]


class Value(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Where one number stands.

    Attributes:
        field: its name, with dots where messages are nested: ``pose.position.x``, ``q.0``.
        topic: when it is another one than that of its section.
        unit: when it is another one than that of its section.
        scale: what it is multiplied by besides; -1.0 turns an axis round.
    """

    field: str
    topic: str = ""
    unit: str | None = None
    scale: float = 1.0


Entry = Value | str
"""A value, or only the name of its field."""


class Section(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """Values of one topic.

    Attributes:
        topic: of all values that name no other.
        unit: of all values that name no other.
        where: only data whose fields have these values count: ``{ C = 0 }``.
    """

    topic: str = ""
    unit: str = ""
    where: Match = {}

    def values(self) -> Iterator[tuple[str, Value]]:
        """Each value under the name of its key, with topic and unit filled in."""
        for name in self.__struct_fields__:
            entry = getattr(self, name)
            if name in ("topic", "unit", "where", "axes") or entry is None:
                continue
            yield name, self._filled(entry, self._unit_of(name))

    def _unit_of(self, name: str) -> str:
        return self.unit

    def _filled(self, entry: Entry, unit: str) -> Value:
        value = Value(entry) if isinstance(entry, str) else entry
        return Value(value.field, value.topic or self.topic, unit if value.unit is None else value.unit, value.scale)


class Position(Section, frozen=True, kw_only=True):
    """Where the body is: north and east, or latitude and longitude (unit: `angle_unit`); and one of down, depth, up, altitude."""

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

    def values(self) -> Iterator[tuple[str, Value]]:
        """As in `Section`."""
        return ((name, value) for name, value in Section.values(self) if name != "angle_unit")

    def _unit_of(self, name: str) -> str:
        return self.angle_unit if name in ("latitude", "longitude") else self.unit


class Velocity(Section, frozen=True, kw_only=True):
    """In the world: north, east and one of down, up. Of the body: forward, one of right, left, and one of down, up."""

    unit: str = "m/s"
    north: Entry | None = None
    east: Entry | None = None
    down: Entry | None = None
    up: Entry | None = None
    forward: Entry | None = None
    right: Entry | None = None
    left: Entry | None = None


class Attitude(Section, frozen=True, kw_only=True):
    """A quaternion w, x, y, z; or roll, pitch and yaw, of which only yaw must be there."""

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
    """What thrusters, fins and propellers give, for who looks.

    Attributes:
        unit: "1" for a part of all that each can give (-1 to 1), "us" for a servo's pulses (1100 to 1900), or an angle of fins.
        outputs: by the name of the actuator in the vehicle's file, or its number from 1 in the order of that file.
    """

    unit: str = "1"
    outputs: dict[str, Entry] = {}

    def values(self) -> Iterator[tuple[str, Value]]:
        """As in `Section`."""
        return ((name, self._filled(entry, self.unit)) for name, entry in self.outputs.items())


class Track(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The pose of one body over time. Without attitude it heads north, level."""

    position: Position
    attitude: Attitude | None = None
    velocity: Velocity | None = None
    actuators: Actuators | None = None


class PortSource(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The samples of one port.

    Attributes:
        topic: that gives one sample a datum.
        fields: of the port: a value, or a list of them for a vector.
        kind: of the port, for whoever shows it.
        where: as in `Section`.
    """

    topic: str
    fields: dict[str, Entry | list[Entry]]
    kind: str = ""
    where: Match = {}


class Origin(Struct, frozen=True, forbid_unknown_fields=True):
    """Where N touches the Earth, in degrees. Without it, latitudes and longitudes are counted from the first fix of each track."""

    latitude_deg: float
    longitude_deg: float


class Mapping(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What a log gives: tracks and ports by name."""

    format: str = FORMAT
    origin: Origin | None = None
    tracks: dict[str, Track] = {}
    ports: dict[str, PortSource] = {}


def read_mapping(path: str | Path) -> Mapping:
    """A mapping from its file.

    Raises:
        LogError: it cannot be read, is no TOML, or has keys, units or sections that do not fit; the text says where.
    """
    try:
        with Path(path).open("rb") as file:
            raw = file.read(_MOST_BYTES + 1)
        if len(raw) > _MOST_BYTES:
            raise LogError(f"{path}: more than {_MOST_BYTES} bytes: no mapping")
        return parse_mapping(raw.decode())
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise LogError(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from error


def parse_mapping(text: str) -> Mapping:
    """A mapping from its text.

    Raises:
        ValueError: as `read_mapping`, without the name of the file.
    """
    mapping = msgspec.convert(tomllib.loads(text), Mapping)
    if mapping.format != FORMAT:
        raise ValueError(f'format "{mapping.format}": here it is "{FORMAT}"')
    for name, track in mapping.tracks.items():
        _check_track(f"tracks.{name}", track)
    for name, port in mapping.ports.items():
        for field, entries in port.fields.items():
            for entry in entries if isinstance(entries, list) else [entries]:
                _check_unit(f"ports.{name}.{field}", entry.unit if isinstance(entry, Value) else None)
    return mapping


def mapping_text(mapping: Mapping) -> str:
    """A mapping as TOML that `parse_mapping` reads: a line for each section, its units and axes written out."""
    lines = [f"format = {_toml(FORMAT)}"]
    if mapping.origin is not None:
        lines += ["", "[origin]", *(f"{key} = {_toml(v)}" for key, v in msgspec.to_builtins(mapping.origin).items())]
    for name, track in mapping.tracks.items():
        lines += ["", f"[tracks.{_key(name)}]"]
        for key in SECTIONS:
            section: Section | None = getattr(track, key)
            if section is not None:
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
    """As TOML knows it, without what is the default."""
    raw = msgspec.to_builtins(value)
    return [_plain(v) for v in raw] if isinstance(raw, list) else _without_ones(raw) if isinstance(raw, dict) else raw


def _without_ones(raw: dict[str, Any]) -> dict[str, Any]:
    found = {k: _without_ones(v) if isinstance(v, dict) else v for k, v in raw.items()}
    return {k: v for k, v in found.items() if not (k == "scale" and v == 1.0)}


def _toml(value: object) -> str:
    """A value on one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(str(k))} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return tomli_w.dumps({"v": value}).removeprefix("v = ").rstrip("\n")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _toml(name)


def one_of(section: Section, *names: str) -> str:
    """Which of these keys is given; "" for none."""
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
    for name in SECTIONS:
        section: Section | None = getattr(track, name)
        for key, value in section.values() if section is not None else ():
            if not value.topic:
                raise ValueError(f"{where}.{name}.{key}: neither it nor its section names a topic")
            _check_unit(f"{where}.{name}.{key}", value.unit)
    for key, value in track.actuators.values() if track.actuators is not None else ():
        if value.unit not in ACTUATOR_UNITS:
            known = ", ".join(f'"{unit}"' for unit in ACTUATOR_UNITS)
            raise ValueError(f'{where}.actuators.{key}: unit "{value.unit}"; those of actuators are {known}')


def _only_one(where: str, section: Section, *names: str) -> None:
    given = [name for name in names if getattr(section, name) is not None]
    if len(given) > 1 or (not given and "depth" not in names):
        raise ValueError(f"{where}: give one of {', '.join(names)}{f', not {len(given)}' if given else ''}")


def _check_unit(where: str, unit: str | None) -> None:
    try:
        scale_of(unit or "")
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
