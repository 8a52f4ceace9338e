"""Converts a Builder script of MORSE to a scenario. The script is parsed, never executed.

The statements at the top level of the script are read: they make a robot or component (``imu = IMU()``), place it (``translate``, ``rotate``), give
it a rate (``frequency``) and attach it to a robot (``robot.append(imu)``). Every other statement is reported with its line, so that nothing is lost
silently.
"""

from __future__ import annotations

import ast
import json
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from uwserver.frames import frd_from_flu, ned_from_enu
from uwserver.scenario.files.convert import NAME
from uwserver.units import deg

LONGEST = 1 << 20
"""Longest script, characters."""
RATE_HZ = 240
"""Rate of the physics; every sensor rate divides it."""

SENSORS = {
    "IMU": ["imu"],
    "Gyroscope": ["attitude"],
    "Attitude": ["attitude"],
    "Compass": ["attitude"],
    "Magnetometer": ["magnetometer"],
    "GPS": ["gps"],
    "Barometer": ["pressure"],
    "Pressure": ["pressure"],
    "Depth": ["pressure", 'output = "depth"'],
    "DepthSensor": ["pressure", 'output = "depth"'],
    "DVL": ["dvl", 'profile = "a50"'],
    "RadarAltimeter": ["altimeter", 'profile = "ping1d"'],
    "Altimeter": ["altimeter", 'profile = "ping1d"'],
    "Thermometer": ["ctd"],
    "Collision": ["contact"],
    "Clock": ["clock"],
    "Infrared": ["range_array", "beams = 20", "field_of_view_deg = 20"],
    "Sick": ["range_array", "beams = 181", "field_of_view_deg = 180"],
    "SickLDMRS": ["range_array", "beams = 101", "field_of_view_deg = 100"],
    "Hokuyo": ["range_array", "beams = 241", "field_of_view_deg = 240"],
    "Sonar": ["scanning_sonar", 'profile = "ping360"'],
}
"""Our kind and further keys for each sensor class of MORSE or UW-MORSE."""
TRUTH = {"Pose", "Velocity", "Accelerometer", "Odometry"}
"""Classes that give ground truth."""
AUTOPILOT = {
    "MotionVW",
    "MotionXYW",
    "MotionVelocity",
    "Waypoint",
    "Destination",
    "Orientation",
    "Keyboard",
    "Joystick",
}
"""Classes that move a robot as if it had no dynamics; here the autopilot moves it."""
ACTUATORS = {"ForceTorque": "force_torque", "ExternalForce": "force_torque", "Teleport": "teleport"}
BATTERY = {"Battery"}
HANDLED_METHODS = {
    "add_stream",
    "add_service",
    "add_default_interface",
    "add_interface",
    "append",
    "translate",
    "rotate",
    "frequency",
}
"""Methods that are converted, or that a server with adapters does not need."""


_UNARY: Mapping[type[ast.unaryop], Callable[[float], float]] = {ast.USub: operator.neg, ast.UAdd: operator.pos}
_BINARY: Mapping[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
}  # fmt: skip


class Converted(NamedTuple):
    """A converted scenario.

    Attributes:
        text: text of the scenario file.
        remarks: on what was not converted or is different here, each with its line.
    """

    text: str
    remarks: list[str]


class NoScript(Exception):
    """Raised if a text is not a Builder script; the text says why."""


@dataclass
class _Part:
    """A robot or component that the script makes."""

    name: str
    cls: str
    line: int
    place: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    turn: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    rate_hz: float | None = None
    parts: list[_Part] = field(default_factory=list)
    is_part: bool = False


def scenario_from(script: str, title: str, vehicle: str) -> Converted:
    """Return a scenario that builds what a script of MORSE builds.

    Args:
        script: its text.
        title: title of the scenario.
        vehicle: model for every robot, as robots of MORSE have no hydrodynamics.

    Raises:
        NoScript: the script cannot be read, or makes no robot.
    """
    if len(script) >= LONGEST:
        raise NoScript(f"it has {len(script)} characters; less than {LONGEST} are allowed")
    try:
        tree = ast.parse(script)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise NoScript(f"it is not a Python 3 script: {error}") from None
    reader = _Reader()
    for statement in tree.body:
        reader.read(statement)
    robots = [part for part in reader.parts.values() if not part.is_part and not _is_component(part.cls)]
    if not robots:
        raise NoScript(
            "it makes no robot: a Builder script has robot = ATRV(), and robot.append(...) for each component"
        )
    return Converted(_written(robots, title, vehicle, reader.remarks), sorted(reader.remarks, key=_line_of))


def _is_component(cls: str) -> bool:
    return cls in SENSORS or cls in TRUTH | AUTOPILOT | BATTERY or cls in ACTUATORS


class _Reader:
    """Reads statements, and collects parts and remarks."""

    def __init__(self) -> None:
        self.parts: dict[str, _Part] = {}
        self.remarks: list[str] = []

    def read(self, statement: ast.stmt) -> None:
        """Read one statement at the top level of the script."""
        if isinstance(statement, ast.Import | ast.ImportFrom | ast.Pass):
            return
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
            return  # a docstring
        if isinstance(statement, ast.Assign) and self._makes(statement):
            return
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call) and self._calls(statement.value):
            return
        self._remark(statement, f"not read: {_shown(statement)}")

    def _makes(self, statement: ast.Assign) -> bool:
        """Read a statement such as ``imu = IMU()``; return whether it is one."""
        target, value = statement.targets[0], statement.value
        if len(statement.targets) != 1 or not isinstance(target, ast.Name) or not isinstance(value, ast.Call):
            return False
        if not isinstance(value.func, ast.Name):
            return False
        given = value.args[0] if value.args else None
        said = given.value if isinstance(given, ast.Constant) and isinstance(given.value, str) else None
        if value.func.id == "Environment":
            self._remark(
                statement, f"the environment {said or ''} is not converted: use [seabed] and [structures] instead"
            )
            return True
        name = said if said is not None and NAME.fullmatch(said) else target.id
        self.parts[target.id] = _Part(name, value.func.id, statement.lineno)
        return True

    def _calls(self, call: ast.Call) -> bool:
        """Read a statement such as ``imu.translate(...)``; return whether it could be read."""
        if not isinstance(call.func, ast.Attribute) or not isinstance(call.func.value, ast.Name):
            return False
        part = self.parts.get(call.func.value.id)
        if part is None:
            return call.func.value.id in ("env", "environment")
        verb = call.func.attr
        if verb in ("translate", "rotate"):
            moved, numbers = part.place if verb == "translate" else part.turn, _numbers(call, ("x", "y", "z"))
            moved[:] = [a + b for a, b in zip(moved, numbers or (0.0, 0.0, 0.0), strict=True)]
            return numbers is not None
        if verb == "frequency":
            rate = _numbers(call, ("frequency",))
            if rate is None or not rate[0] > 0.0:
                return False
            part.rate_hz = rate[0]
        elif verb == "append":
            child = self.parts.get(call.args[0].id) if call.args and isinstance(call.args[0], ast.Name) else None
            if child is None or child is part:
                return False
            part.parts.append(child)
            child.is_part = True
        elif verb not in HANDLED_METHODS:
            self._remark(call, f"{_shown(call)} has no equivalent here")
        return True

    def _remark(self, node: ast.stmt | ast.expr, text: str) -> None:
        self.remarks.append(f"line {node.lineno}: {text}")


def _numbers(call: ast.Call, names: Sequence[str]) -> list[float] | None:
    """Return the arguments of a call, which may be simple arithmetic with pi; None if one is anything else."""
    found = [0.0] * len(names)
    try:
        for at, each in enumerate(call.args):
            found[at] = _number(each)
        for keyword in call.keywords:
            found[names.index(keyword.arg or "")] = _number(keyword.value)
    except (ValueError, IndexError, ZeroDivisionError, OverflowError, RecursionError):
        return None
    return found if all(map(math.isfinite, found)) else None


def _number(node: ast.expr) -> float:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return float(node.value)
    if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        return _UNARY[type(node.op)](_number(node.operand))
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        return _BINARY[type(node.op)](_number(node.left), _number(node.right))
    if (isinstance(node, ast.Attribute) and node.attr == "pi") or (isinstance(node, ast.Name) and node.id == "pi"):
        return math.pi
    raise ValueError


# -- writing ----------------------------------------------------------------------------------------------------------------------------


def _written(robots: Sequence[_Part], title: str, vehicle: str, remarks: list[str]) -> str:
    lines = [
        f"# {title}: from a Builder script of MORSE. MORSE's robots had no hydrodynamics: choose models that have (uwserver list).",
        "schema = 1",
        f"title = {json.dumps(title)}",
        "",
        "[world]",
        f"rate_hz = {RATE_HZ}",
        "origin_lat_deg = 63.43                  # where position_ned_m = [0, 0, 0] lies: for GPS and compass",
        "origin_lon_deg = 10.40",
    ]
    for robot in robots:
        lines += _robot(robot, vehicle, remarks)
    lines += [
        "",
        "# pymorse and ArduPilot's MORSE backend connect here as before.",
        "[adapters.morse]",
        'kind = "morse"',
        "truth = true",
    ]
    return "\n".join(lines) + "\n"


def _robot(robot: _Part, vehicle: str, remarks: list[str]) -> list[str]:
    place = ned_from_enu(robot.place)
    if place[2] < 0.0:
        remarks.append(
            f"line {robot.line}: {robot.name} started {-place[2]:g} m above the water; here it starts at the surface"
        )
        place = (place[0], place[1], 0.0)
    key = _key(robot.name)
    lines = [
        "",
        f"[vehicles.{key}]                          # {robot.cls}",
        f"model = {json.dumps(vehicle, ensure_ascii=False)}",
        f"position_ned_m = {_row(place)}",
        f"attitude_rpy_deg = {_row([deg(robot.turn[0]), -deg(robot.turn[1]), 90.0 - deg(robot.turn[2])])}",
    ]
    if any(part.cls in AUTOPILOT for part in robot.parts):
        lines += ["", f"[vehicles.{key}.autopilot]"]
    truth = [part.rate_hz for part in robot.parts if part.cls in TRUTH]
    if truth:
        lines += ["", f"[vehicles.{key}.truth]", f"rate_hz = {_rate(max((rate or 60.0) for rate in truth))}"]
    for part in robot.parts:
        lines += _part(key, part, remarks)
    return lines


def _part(vehicle: str, part: _Part, remarks: list[str]) -> list[str]:
    name = _key(part.name)
    if part.cls in TRUTH | AUTOPILOT:
        return []
    if part.cls in BATTERY:
        rate = f"rate_hz = {_rate(part.rate_hz or 10.0)}"
        return ["", f"[vehicles.{vehicle}.sensors.{name}]", 'kind = "battery"', 'profile = "lipo_4s_18ah"', rate]
    if part.cls in ACTUATORS:
        return ["", f"[vehicles.{vehicle}.override.actuators.{name}]", f'kind = "{ACTUATORS[part.cls]}"']
    if part.cls not in SENSORS:
        remarks.append(f"line {part.line}: there is no equivalent of {part.cls} here: {part.name} is left out")
        return []
    kind, *more = SENSORS[part.cls]
    lines = [
        "",
        f"[vehicles.{vehicle}.sensors.{name}]",
        f'kind = "{kind}"',
        *more,
        f"rate_hz = {_rate(part.rate_hz or 60.0)}",
    ]
    if any(part.place):
        lines.append(f"position_frd_m = {_row(frd_from_flu(part.place))}")
    if any(part.turn):
        lines.append(f"rpy_deg = {_row([deg(part.turn[0]), -deg(part.turn[1]), -deg(part.turn[2])])}")
    return lines


def _rate(wanted_hz: float) -> str:
    """Return the nearest whole rate that divides that of the physics."""
    rates = [n for n in range(1, RATE_HZ + 1) if RATE_HZ % n == 0]
    return str(min(rates, key=lambda rate: abs(math.log(rate / wanted_hz))))


def _row(numbers: Sequence[float]) -> str:
    return f"[{', '.join(repr(round(each, 9) + 0.0) for each in numbers)}]"


def _key(name: str) -> str:
    return name.replace(".", "_")


def _shown(node: ast.AST) -> str:
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= 70 else f"{text[:70]} ..."


def _line_of(remark: str) -> int:
    return int(remark.split(":", 1)[0].removeprefix("line "))
