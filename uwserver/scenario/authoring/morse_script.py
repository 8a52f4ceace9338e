"""A scenario from a Builder script of MORSE: what it builds, read from its text. The script is never executed.

Read are statements at the top of the script: a robot or component is made (``imu = IMU()``), placed (``translate``, ``rotate``), given a rate
(``frequency``) and fixed to a robot (``robot.append(imu)``). What else it says is told by its line, so that nothing is lost unseen.
"""

from __future__ import annotations

import ast
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from uwserver.frames import frd_from_flu, ned_from_enu
from uwserver.scenario.files.convert import NAME
from uwserver.units import deg

LONGEST = 1 << 20
"""Of a script, bytes."""
RATE_HZ = 240
"""Of the physics, which every rate of a sensor divides."""

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
"""Class of MORSE, or of UW-MORSE, -> kind of ours, and further keys."""
TRUTH = {"Pose", "Velocity", "Accelerometer", "Odometry"}
"""Classes that tell what no instrument could know."""
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
"""Classes that move a robot as if it had no dynamics: the autopilot does it here."""
ACTUATORS = {"ForceTorque": "force_torque", "ExternalForce": "force_torque", "Teleport": "teleport"}
BATTERY = {"Battery"}
QUIET = {
    "add_stream",
    "add_service",
    "add_default_interface",
    "add_interface",
    "append",
    "translate",
    "rotate",
    "frequency",
}
"""Methods that are read, or that a server with adapters needs not."""


class Converted(NamedTuple):
    """A scenario.

    Attributes:
        text: of its file.
        remarks: what was not understood or is otherwise here, each with its line.
    """

    text: str
    remarks: list[str]


class NoScript(Exception):
    """The text is no script of Python; says why."""


@dataclass
class _Part:
    """A robot or component that a script makes."""

    name: str
    cls: str
    line: int
    place: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    turn: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    rate_hz: float | None = None
    parts: list[_Part] = field(default_factory=list)
    is_part: bool = False


def scenario_from(script: str, title: str, vehicle: str) -> Converted:
    """A scenario that builds what a script of MORSE builds.

    Args:
        script: its text.
        title: of the scenario.
        vehicle: model of every robot, as MORSE's have no hydrodynamics.

    Raises:
        NoScript: it cannot be read, or makes no robot.
    """
    if len(script) >= LONGEST:
        raise NoScript(f"a script has less than {LONGEST} characters")
    try:
        tree = ast.parse(script)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise NoScript(f"this is no script of Python 3: {error}") from None
    reader = _Reader()
    for statement in tree.body:
        reader.read(statement)
    robots = [part for part in reader.parts.values() if not part.is_part and not _is_component(part.cls)]
    if not robots:
        raise NoScript(
            "it makes no robot: a Builder script says robot = ATRV(), and robot.append(...) for each component"
        )
    return Converted(_written(robots, title, vehicle, reader.remarks), sorted(reader.remarks, key=_line_of))


def _is_component(cls: str) -> bool:
    return cls in SENSORS or cls in TRUTH | AUTOPILOT | BATTERY or cls in ACTUATORS


class _Reader:
    """Statements to parts."""

    def __init__(self) -> None:
        self.parts: dict[str, _Part] = {}
        self.remarks: list[str] = []

    def read(self, statement: ast.stmt) -> None:
        """One statement at the top of the script."""
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
        """``imu = IMU()`` or ``imu = robot.append(IMU())``."""
        target, value = statement.targets[0], statement.value
        if len(statement.targets) != 1 or not isinstance(target, ast.Name) or not isinstance(value, ast.Call):
            return False
        if not isinstance(value.func, ast.Name):
            return False
        given = value.args[0] if value.args else None
        said = given.value if isinstance(given, ast.Constant) and isinstance(given.value, str) else None
        if value.func.id == "Environment":
            self._remark(
                statement, f"the environment {said or ''} is not converted: [seabed] and [structures] take its place"
            )
            return True
        name = said if said is not None and NAME.fullmatch(said) else target.id
        self.parts[target.id] = _Part(name, value.func.id, statement.lineno)
        return True

    def _calls(self, call: ast.Call) -> bool:
        """``imu.translate(...)``."""
        if not isinstance(call.func, ast.Attribute) or not isinstance(call.func.value, ast.Name):
            return False
        part = self.parts.get(call.func.value.id)
        if part is None:
            return call.func.value.id in ("env", "environment")
        verb = call.func.attr
        if verb in ("translate", "rotate"):
            return self._moves(part, call, part.place if verb == "translate" else part.turn)
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
        elif verb not in QUIET:
            self._remark(call, f"{_shown(call)} has no equal here")
        return True

    def _moves(self, part: _Part, call: ast.Call, what: list[float]) -> bool:
        numbers = _numbers(call, ("x", "y", "z"))
        if numbers is None:
            return False
        for axis in range(3):
            what[axis] += numbers[axis]
        return True

    def _remark(self, node: ast.stmt | ast.expr, text: str) -> None:
        self.remarks.append(f"line {node.lineno}: {text}")


def _numbers(call: ast.Call, names: Sequence[str]) -> list[float] | None:
    """Arguments that are numbers, or simple sums of such with pi; None where one is not."""
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
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        return -_number(node.operand) if isinstance(node.op, ast.USub) else _number(node.operand)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub | ast.Mult | ast.Div):
        a, b = _number(node.left), _number(node.right)
        if isinstance(node.op, ast.Mult):
            return a * b
        if isinstance(node.op, ast.Div):
            return a / b
        return a + b if isinstance(node.op, ast.Add) else a - b
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
            f"line {robot.line}: {robot.name} began {-place[2]:g} m above the water and begins at its surface now"
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
        remarks.append(f"line {part.line}: no component here does what {part.cls} did: {part.name} is left out")
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
    """The nearest whole rate that divides that of the physics."""
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
