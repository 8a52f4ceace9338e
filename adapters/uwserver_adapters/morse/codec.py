"""Readings and commands in MORSE's forms: the world is east, north, up, bodies are forward, left, up, quaternions are {x, y, z, w}.

Where MORSE has such a sensor or actuator, the keys are its keys. All other ports keep their own names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from uwserver.frames import attitude_enu_flu, conjugate, frd_from_flu, multiply, ned_from_enu, rotate, rpy_from_quat
from uwserver.ports import Field, Port, Refused, Value
from uwserver.units import NANOSECONDS, deg

Reading = dict[str, object]

_FLIP = (0.0, 1.0, 0.0, 0.0)
"""Half a turn about x, from forward, right, down to forward, left, up."""
_SWAPS = {"N": ned_from_enu, "B": frd_from_flu, "S": frd_from_flu}
_SUFFIX = {"N", "B", "S", "NB", "NS"}


def timestamp(epoch_ns: int, t_ns: int) -> float:
    """Return a simulation time as seconds since 1970."""
    return (epoch_ns + t_ns) / NANOSECONDS


def seconds(t_ns: int) -> float:
    """Return seconds of simulation time."""
    return t_ns / NANOSECONDS


# -- readings ---------------------------------------------------------------------------------------------------------------------------


TRUE_VELOCITY = "TrueVelocity"
"""What MORSE tells in the world's axes too, and so needs the attitude for."""


def reading(port: Port, value: Sequence[Value], attitude: Sequence[float] | None = None) -> Reading:
    """Return a sample of a sensor in MORSE's form, without its time.

    Args:
        port: port of the sample.
        value: one entry for each field.
        attitude: q_NB of the vehicle, for values that MORSE has in the world's axes; None where it is not known.
    """
    fields = {field.name: (field, each) for field, each in zip(port.fields, value, strict=True)}
    told = _MESSAGES.get(port.message or "", {})
    if not all(name in fields for name in told):
        told = {}
    said: Reading = {}
    for name, (field, each) in fields.items():
        converted = _converted(field, each)
        said |= told[name](converted) if name in told else {name: converted}
    if port.message == TRUE_VELOCITY and attitude is not None and isinstance(fields["v_NB_B"][1], tuple):
        v_N = rotate(attitude, fields["v_NB_B"][1])  # type: ignore[arg-type]  # three numbers
        said["world_linear_velocity"] = list(ned_from_enu(v_N))
    return said


def _converted(field: Field, value: Value) -> object:
    """Return the value of a field in MORSE's frames. Bytes and buffers stay as they are."""
    if not isinstance(value, tuple):
        return value
    numbers: Any = value
    if field.is_rotation:
        return None if None in value else _quaternion(_turned(field.frame, numbers))
    swap = _SWAPS.get(field.frame)
    if swap is None or None in value or field.shape[-1:] != (3,):
        return list(value)
    rows = [list(swap(numbers[i : i + 3])) for i in range(0, len(value), 3)]
    if field.shape == (3,):
        return rows[0]
    if field.shape == (3, 3):  # a covariance: both its rows and its columns turn
        return [list(row) for row in zip(*(swap(column) for column in zip(*rows, strict=True)), strict=True)]
    return rows


def _turned(frame: str, q: Sequence[float]) -> tuple[float, float, float, float]:
    """Return a quaternion between our frames as one between MORSE's frames. The same function turns it back."""
    return attitude_enu_flu(q) if frame.startswith("N") else multiply(multiply(_FLIP, q), conjugate(_FLIP))


def _quaternion(q: Sequence[float]) -> Reading:
    if q[0] < 0.0:  # the negative of q is the same attitude, and people expect a positive w
        q = [-each for each in q]
    return {"x": q[1], "y": q[2], "z": q[3], "w": q[0]}


def _angles(attitude: Any) -> Reading:
    if attitude is None:
        return {"orientation": None}
    roll, pitch, yaw = rpy_from_quat([attitude[key] for key in "wxyz"])
    return {"yaw": yaw, "pitch": pitch, "roll": roll, "orientation": attitude}


def _named(name: str) -> Any:
    return lambda value: {name: value}


def _degrees(name: str) -> Any:
    return lambda angle: {name: None if angle is None else deg(angle)}


_MESSAGES: Mapping[str, Mapping[str, Any]] = {
    "Imu": {"f_S": _named("linear_acceleration"), "w_S": _named("angular_velocity")},
    "MagneticField": {"field_S": _named("magnetic_field")},
    "TruePose": {"p_NB": lambda p: {"x": p[0], "y": p[1], "z": p[2]}, "q_NB": _angles},
    "TrueVelocity": {"v_NB_B": _named("linear_velocity"), "w_NB_B": _named("angular_velocity")},
    "TrueAcceleration": {"v_dot_B": _named("acceleration"), "w_dot_B": _named("angular_acceleration")},
    "Attitude": {"q_NS": _angles},
    "Dvl": {"v_S": _named("linear_velocity")},
    "NavSatFix": {"latitude": _degrees("latitude"), "longitude": _degrees("longitude"), "height": _named("altitude")},
    "Range": {"range": _named("z")},
    "BatteryState": {"charge": lambda share: {"charge": None if share is None else 100.0 * share}},
    "LaserScan": {"ranges": _named("range_list")},
}
"""Standard message of a port -> field -> its part of the reading, from the value in MORSE's frames. A port that lacks one of these fields keeps its
own names."""


# -- commands ---------------------------------------------------------------------------------------------------------------------------


def command(port: Port, said: Mapping[str, object]) -> dict[str, object]:
    """Return the command for an actuator. A field goes by its name, or by the name without the frame (``force`` for ``force_B``).

    Raises:
        Refused: a key is no field of the port. Numbers and limits are checked by the world.
    """
    fields = {field.name: field for field in port.fields}
    short = {_short(field): field for field in port.fields}
    value: dict[str, object] = {}
    for key, given in said.items():
        if key == "timestamp":
            continue
        field = fields.get(key) or short.get(key)
        if field is None:
            there = ", ".join(dict.fromkeys([*short, *fields]))
            raise Refused("bad_argument", f'"{key[:80]}" is no field of {port.path}, it has: {there}', port.path)
        value[field.name] = _taken(field, given)
    if not value:
        raise Refused("bad_argument", f"nothing is said for {port.path}, it has: {', '.join(short)}", port.path)
    return value


def _short(field: Field) -> str:
    stem, _, frame = field.name.rpartition("_")
    return stem if stem and frame in _SUFFIX else field.name


def _taken(field: Field, given: object) -> object:
    """Return a field's value in our frames. A value of another shape stays as it is, and the world refuses it."""
    if field.is_rotation:
        if isinstance(given, dict) and set(given) == set("xyzw"):
            given = [given[key] for key in "wxyz"]
        return list(_turned(field.frame, given)) if _numbers(given, 4) else given  # type: ignore[arg-type]
    swap = _SWAPS.get(field.frame)
    if swap is not None and field.shape == (3,) and _numbers(given, 3):
        return list(swap(given))  # type: ignore[arg-type]  # three numbers
    return given


def _numbers(given: object, count: int) -> bool:
    return (
        isinstance(given, list)
        and len(given) == count
        and all(isinstance(each, int | float) and not isinstance(each, bool) and abs(each) < 1e300 for each in given)
    )


def motion(said: Mapping[str, object]) -> dict[str, object]:
    """Return the autopilot's velocity for the keys of MORSE's `MotionVW` {v, w} and `MotionXYW` {x, y, w}, with z besides.

    Raises:
        Refused: there are other keys, or values that are no numbers.
    """
    if set(said) - {"v", "x", "y", "z", "w", "timestamp"} or ("v" in said and "x" in said):
        raise Refused("bad_argument", "write {v, w}, or {x, y, z, w}: m/s forward, left, up, and rad/s to the left")
    x = number(said, "v") if "v" in said else number(said, "x")
    return {"v_B": list(frd_from_flu((x, number(said, "y"), number(said, "z")))), "yaw_rate": -number(said, "w")}


def place(x: float, y: float, z: float) -> list[float]:
    """Return a position (m) in N for one in east, north, up."""
    return list(ned_from_enu((x, y, z)))


def number(said: Mapping[str, object], key: str) -> float:
    """Return the number of a key, 0 where the key is missing.

    Raises:
        Refused: the value is no number, or not finite.
    """
    value = said.get(key, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
        raise Refused("bad_argument", f'"{key}" is a finite number')
    return float(value)
