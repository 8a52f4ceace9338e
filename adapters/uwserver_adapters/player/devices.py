"""Which devices of Player the world has, what they tell, and what they take. Axes are east, north, up and forward, left, up, as Player's are
right-handed with z upwards; angles are rad, of a world whose x points east."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from uwserver.adapter import SampleForm, decode
from uwserver.frames import attitude_enu_flu, conjugate, frd_from_flu, ned_from_enu, rotate, rpy_from_quat
from uwserver.ports import Port, Refused, Sample, Value
from uwserver.units import NANOSECONDS, deg
from uwserver_adapters.player import wire
from uwserver_adapters.player.wire import CMD, GPS, IMU, OPAQUE, POSITION3D, RANGER, REQ, Message

Told = tuple[int, bytes]
"""Subtype and body of a message of data."""
SERVICES = "services"
"""Name of the opaque device by which all services are called."""

RANGES: Mapping[str, str] = {"altimeter": "range", "range_array": "ranges", "dvl": "beam_ranges"}
"""Kinds of sensors that are rangers, and the field with their ranges."""
SET_VEL, SET_POS = 1, 2
MOTOR_POWER, VELOCITY_MODE, POSITION_MODE = 2, 3, 4
GUIDED = "guided"
"""Mode of the autopilot in which it follows speeds and places."""
_CALIB, _SET_DATATYPE = 2, 1
_VELOCITY = struct.Struct(">6dI")
_TURN_ONLY = 1e-9
_LARGEST_FLOAT = 3.4028234e38


class Ask(NamedTuple):
    """What a message asks of the world: a command of a port, or a call of a service; neither where it is just to be acknowledged."""

    port: str = ""
    service: str = ""
    args: Mapping[str, object] = {}


class Device(NamedTuple):
    """A device.

    Attributes:
        interface, number: its address.
        name: of its driver: the path of the port behind it, or of the vehicle.
        ports: whose samples it tells.
        tell: what a sample of one of them says; None for nothing.
        take: what a message asks; raises `Refused`.
    """

    interface: int
    number: int
    name: str
    ports: tuple[str, ...] = ()
    tell: Callable[[Sample], Told | None] = lambda _: None
    take: Callable[[Message], Ask] | None = None


def devices_of(ports: Mapping[str, Port], epoch_ns: int, pose: str) -> list[Device]:
    """All devices, numbered in each interface.

    Args:
        ports: those of the context.
        epoch_ns: UTC of simulation time zero.
        pose: what position3d tells, "estimate" or "truth".
    """
    found: list[Device] = []
    counts: dict[int, int] = {}

    def add(interface: int, name: str, *more: Any) -> None:
        number = counts.get(interface, 0)
        counts[interface] = number + 1
        found.append(Device(interface, number, name, *more))

    for vehicle in dict.fromkeys(path.partition("/")[0] for path in ports):
        source = _pose_of(vehicle, ports, pose)
        if source is not None:
            add(POSITION3D, vehicle, *source, _steering(vehicle))
    for path, port in ports.items():
        for interface, tell in _standard(port, epoch_ns):
            add(interface, path, (path,), tell, _of_imu if interface == IMU else None)
    for path, port in ports.items():
        add(OPAQUE, path, *_opaque(port))
    add(OPAQUE, SERVICES, (), lambda _: None, _service_call)
    return found


# -- position3d -----------------------------------------------------------------------------------------------------------------------------


def _pose_of(
    vehicle: str, ports: Mapping[str, Port], pose: str
) -> tuple[tuple[str, ...], Callable[[Sample], Told | None]] | None:
    """The ports that tell where a vehicle is, and how."""
    if pose == "truth":
        where, how_fast = f"{vehicle}/truth/pose", f"{vehicle}/truth/velocity"
        if where not in ports:
            return None
        newest: dict[str, tuple[Value, ...]] = {}

        def truth(sample: Sample) -> Told | None:
            newest[sample.port] = sample.value
            values = (*newest.get(where, ()), *newest.get(how_fast, ()))
            if sample.port != where or len(values) != 4 or not all(map(_is_whole, values)):
                return None
            return _state(*values)

        return (where, how_fast), truth
    path = f"{vehicle}/autopilot/state"
    if path not in ports:
        return None
    picked = [_index(ports[path], name) for name in ("p_N", "q_NB", "v_N", "w_B")]

    def estimate(sample: Sample) -> Told | None:
        p_N, q_NB, v_N, w_B = (sample.value[k] for k in picked)
        if not all(map(_is_whole, (p_N, q_NB, v_N, w_B))):
            return None
        return _state(p_N, q_NB, rotate(conjugate(q_NB), v_N), w_B)  # type: ignore[arg-type]  # whole

    return (path,), estimate


def _index(port: Port, name: str) -> int:
    return [field.name for field in port.fields].index(name)


def _is_whole(value: Value) -> bool:
    return isinstance(value, tuple) and None not in value


def _state(p_N: Any, q_NB: Any, v_B: Any, w_B: Any) -> Told:
    """Place in the world, speed in the body: PLAYER_POSITION3D_DATA_STATE."""
    rpy = rpy_from_quat(attitude_enu_flu(q_NB))
    return 1, wire.doubles(*ned_from_enu(p_N), *rpy, *frd_from_flu(v_B), *frd_from_flu(w_B)) + wire.u32(0)


def _steering(vehicle: str) -> Callable[[Message], Ask]:
    """Commands of a position3d: speed and place by the vehicle's autopilot; motor power arms it, either mode makes it follow them."""

    def take(message: Message) -> Ask:
        kind = (message.type, message.subtype)
        if kind == (CMD, SET_VEL):
            x, y, z, _, _, yaw, _ = wire.read(_VELOCITY, message.body)
            value: dict[str, object] = {"v_B": list(frd_from_flu((x, y, z))), "yaw_rate": -yaw}
            return Ask(f"{vehicle}/autopilot/velocity", args=value)
        if kind == (CMD, SET_POS):
            x, y, z, _, _, yaw, *_ = wire.read(_VELOCITY, message.body)
            heading = (math.pi / 2 - yaw) % (2 * math.pi) if math.isfinite(yaw) else yaw
            return Ask(f"{vehicle}/autopilot/position", args={"p_N": list(ned_from_enu((x, y, z))), "heading": heading})
        if kind == (REQ, MOTOR_POWER):
            verb = "arm" if wire.read_u32(message.body) else "disarm"
            return Ask(service=f"{vehicle}/autopilot/{verb}")
        if kind in ((REQ, VELOCITY_MODE), (REQ, POSITION_MODE)):
            return Ask(service=f"{vehicle}/autopilot/set_mode", args={"mode": GUIDED})
        raise Refused(
            "unknown_service", f"position3d takes speeds, places and motor power, not subtype {message.subtype}"
        )

    return take


# -- sensors --------------------------------------------------------------------------------------------------------------------------------


def _standard(port: Port, epoch_ns: int) -> Iterator[tuple[int, Callable[[Sample], Told | None]]]:
    names = [field.name for field in port.fields]
    if port.direction != "sensor":
        return
    if port.kind == "imu" and {"f_S", "w_S"} <= set(names):
        yield IMU, _imu(names.index("f_S"), names.index("w_S"))
    elif port.kind == "gps" and {"latitude", "longitude", "height", "v_NS"} <= set(names):
        yield GPS, _gps(names, epoch_ns)
    elif RANGES.get(port.kind, "") in names:
        yield RANGER, _ranger(names.index(RANGES[port.kind]))


def _imu(force: int, rate: int) -> Callable[[Sample], Told | None]:
    def tell(sample: Sample) -> Told | None:
        f_S, w_S = sample.value[force], sample.value[rate]
        if not (_is_whole(f_S) and _is_whole(w_S)):
            return None
        numbers = (*frd_from_flu(f_S), *frd_from_flu(w_S))  # type: ignore[arg-type]  # whole
        return _CALIB, wire.floats(*map(_short, numbers), math.nan, math.nan, math.nan)

    return tell


def _short(number: float) -> float:
    """A number that four bytes can hold."""
    return max(-_LARGEST_FLOAT, min(number, _LARGEST_FLOAT)) if math.isfinite(number) else number


def _of_imu(message: Message) -> Ask:
    if (message.type, message.subtype) == (REQ, _SET_DATATYPE) and wire.read_u32(message.body) == _CALIB:
        return Ask()
    raise Refused("bad_argument", "an imu tells calibrated data (datatype 2) here, and takes nothing else")


def _gps(names: Sequence[str], epoch_ns: int) -> Callable[[Sample], Told | None]:
    def tell(sample: Sample) -> Told | None:
        of = dict(zip(names, sample.value, strict=True))
        latitude, longitude, height, v_NS = (of[name] for name in ("latitude", "longitude", "height", "v_NS"))
        seconds, rest = divmod(epoch_ns + sample.t_ns, NANOSECONDS)
        time = wire.u32(seconds & 0xFFFFFFFF, rest // 1000)
        numbers = [each for each in (latitude, longitude, height) if isinstance(each, float) and math.isfinite(each)]
        if len(numbers) < 3 or not _is_whole(v_NS):
            return 1, time + struct.pack(">3i4d4I2d", 0, 0, 0, 0, 0, math.nan, math.nan, 0, 0, 0, 0, math.nan, math.nan)
        v: Any = v_NS
        place = [_whole(deg(numbers[0]) * 1e7), _whole(deg(numbers[1]) * 1e7), _whole(numbers[2] * 1e3)]
        speed = math.hypot(v[0], v[1])
        course = math.atan2(v[1], v[0]) % (2 * math.pi) if speed > _TURN_ONLY else 0.0
        errors = [_or_nan(of.get(name)) for name in ("horizontal_accuracy", "vertical_accuracy")]
        satellites = of.get("satellites")
        seen = satellites if isinstance(satellites, int) else 0
        return 1, time + struct.pack(
            ">3i4d4I2d", *place, speed, course, math.nan, math.nan, 1, seen & 0xFFFF, 0, 0, *errors
        )

    return tell


def _whole(number: float) -> int:
    """A number that four bytes can hold."""
    return round(max(-(2.0**31), min(number, 2.0**31 - 1)))


def _or_nan(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def _ranger(index: int) -> Callable[[Sample], Told | None]:
    def tell(sample: Sample) -> Told:
        value = sample.value[index]
        return 1, wire.rows([_or_nan(each) for each in (value if isinstance(value, tuple) else (value,))])

    return tell


# -- all others -----------------------------------------------------------------------------------------------------------------------------


def _opaque(port: Port) -> tuple[tuple[str, ...], Callable[[Sample], Told | None], Callable[[Message], Ask] | None]:
    """A port as JSON, as on every wire of text."""
    if port.direction == "sensor":
        form = SampleForm(port)

        def tell(sample: Sample) -> Told:
            said = {"t_ns": sample.t_ns, "seq": sample.seq, "valid": sample.valid, "value": form.value(sample)}
            return 1, wire.octets(msgspec.json.encode(said))

        return (port.path,), tell, None

    def take(message: Message) -> Ask:
        if message.type not in (CMD, REQ):
            raise Refused("invalid_request", "an actuator takes commands, or requests, which are answered")
        return Ask(port.path, args=_object(message))

    return (), lambda _: None, take


def _object(message: Message) -> dict[str, object]:
    said = decode(wire.read_octets(message.body).rstrip(b"\0"), "json")
    if not isinstance(said, dict):
        raise Refused("bad_argument", "the data are a JSON object, {...}")
    return said


def _service_call(message: Message) -> Ask:
    said = _object(message)
    service, args = said.get("service"), said.get("args", {})
    if not isinstance(service, str) or not isinstance(args, dict) or set(said) - {"service", "args"}:
        raise Refused("bad_argument", 'a call is {"service": "world/pause", "args": {}}')
    return Ask(service=service, args=args)
