"""The devices of Player that the world has: the data that they send, made from samples, and the messages that they take.

Player's axes are right-handed with z upwards: here they are east, north, up in the world and forward, left, up in the body. Its angles are in rad,
counted from the world's x.
"""

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
from uwserver_adapters.player.wire import CMD, GPS, IMU, OPAQUE, POSITION3D, RANGER, REQ, PlayerMessage

DataMessage = tuple[int, bytes]
"""Subtype and body of a data message."""
DataMaker = Callable[[Sample], DataMessage | None]
"""Makes the message of a sample; None for no message."""

CALIBRATED = 2
"""Subtype of an IMU's data: accelerations, rates, magnetic field."""

_LARGEST_FLOAT = 3.4028234e38
_STANDS = 1e-9
"""Speed below which the course is unknown, m/s."""
SERVICES = "services"
"""Name of the opaque device by which clients call services."""
RANGES: Mapping[str, str] = {"Range": "range", "LaserScan": "ranges", "Dvl": "beam_ranges"}
"""Standard message of a sensor that is a ranger -> the field with its ranges."""
SET_VEL, SET_POS = 1, 2
MOTOR_POWER, VELOCITY_MODE, POSITION_MODE = 2, 3, 4
GUIDED = "guided"
"""Mode of the autopilot in which it follows velocities and positions."""
_SET_DATATYPE = 1
_VELOCITY = struct.Struct(">6dI")


def timestamp(ns: int) -> float:
    """Return the time of a message, s."""
    return ns / NANOSECONDS


def is_whole(value: Value) -> bool:
    """Return whether an array has all its numbers."""
    return isinstance(value, tuple) and None not in value


def state(p_N: Any, q_NB: Any, v_B: Any, w_B: Any) -> DataMessage:
    """Return PLAYER_POSITION3D_DATA_STATE: position in the world, velocity in the body."""
    rpy = rpy_from_quat(attitude_enu_flu(q_NB))
    return 1, wire.doubles(*ned_from_enu(p_N), *rpy, *frd_from_flu(v_B), *frd_from_flu(w_B)) + wire.u32(0)


def heading(yaw: float) -> float:
    """Return an angle clockwise from north for one counter-clockwise from east, rad."""
    return (math.pi / 2 - yaw) % (2 * math.pi) if math.isfinite(yaw) else yaw


def imu(force: int, rate: int) -> DataMaker:
    """Return what makes PLAYER_IMU_DATA_CALIB from the fields at these places. The magnetic field is NaN."""

    def tell(sample: Sample) -> DataMessage | None:
        f_S, w_S = sample.value[force], sample.value[rate]
        if not (is_whole(f_S) and is_whole(w_S)):
            return None
        numbers = (*frd_from_flu(f_S), *frd_from_flu(w_S))  # type: ignore[arg-type]  # whole
        return CALIBRATED, wire.floats(*map(_short, numbers), math.nan, math.nan, math.nan)

    return tell


def gps(names: Sequence[str], epoch_ns: int) -> DataMaker:
    """Return what makes PLAYER_GPS_DATA_STATE from a sensor with these fields, without UTM and dilution of precision."""

    def tell(sample: Sample) -> DataMessage:
        of = dict(zip(names, sample.value, strict=True))
        seconds, rest = divmod(epoch_ns + sample.t_ns, NANOSECONDS)
        time = wire.u32(seconds & 0xFFFFFFFF, rest // 1000)
        angles = [of[name] for name in ("latitude", "longitude", "height")]
        numbers = [each for each in angles if isinstance(each, float) and math.isfinite(each)]
        if len(numbers) < 3 or not is_whole(of["v_NS"]):
            return 1, time + struct.pack(">3i4d4I2d", 0, 0, 0, 0, 0, math.nan, math.nan, 0, 0, 0, 0, math.nan, math.nan)
        v: Any = of["v_NS"]
        place = [_int32(deg(numbers[0]) * 1e7), _int32(deg(numbers[1]) * 1e7), _int32(numbers[2] * 1e3)]
        speed = math.hypot(v[0], v[1])
        course = math.atan2(v[1], v[0]) % (2 * math.pi) if speed > _STANDS else 0.0
        errors = [_or_nan(of.get(name)) for name in ("horizontal_accuracy", "vertical_accuracy")]
        satellites = of.get("satellites")
        seen = satellites & 0xFFFF if isinstance(satellites, int) else 0
        return 1, time + struct.pack(">3i4d4I2d", *place, speed, course, math.nan, math.nan, 1, seen, 0, 0, *errors)

    return tell


def ranger(index: int) -> DataMaker:
    """Return what makes PLAYER_RANGER_DATA_RANGE from the field at this place; NaN without an echo."""

    def tell(sample: Sample) -> DataMessage:
        value = sample.value[index]
        return 1, wire.rows([_or_nan(each) for each in (value if isinstance(value, tuple) else (value,))])

    return tell


def _short(number: float) -> float:
    """Return the nearest number that a float of four bytes can hold."""
    return max(-_LARGEST_FLOAT, min(number, _LARGEST_FLOAT)) if math.isfinite(number) else number


def _int32(number: float) -> int:
    """Return the nearest whole number that four bytes can hold."""
    return round(max(-(2.0**31), min(number, 2.0**31 - 1)))


def _or_nan(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


class Ask(NamedTuple):
    """The request of a message to the world: a command of a port, or a call of a service. Neither where the message is only to be acknowledged."""

    port: str = ""
    service: str = ""
    args: Mapping[str, object] = {}


class Device(NamedTuple):
    """A device.

    Attributes:
        interface, number: its address.
        name: name of its driver: the path of the port behind it, or the vehicle.
        ports: paths of the ports whose samples it sends.
        tell: makes the data of a sample; None for no data.
        take: returns what a message asks, or raises `Refused`; None for a device that takes none.
    """

    interface: int
    number: int
    name: str
    ports: tuple[str, ...] = ()
    tell: DataMaker = lambda _: None
    take: Callable[[PlayerMessage], Ask] | None = None


def devices_of(ports: Mapping[str, Port], epoch_ns: int, pose: str) -> list[Device]:
    """Return all devices, numbered in each interface.

    Args:
        ports: those of the context.
        epoch_ns: UTC of simulation time 0, ns since 1970.
        pose: source of position3d, "estimate" or "truth".
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


def _pose_of(vehicle: str, ports: Mapping[str, Port], pose: str) -> tuple[tuple[str, ...], DataMaker] | None:
    """Return the ports that give the pose of a vehicle, and what makes its data; None where there are none."""
    if pose == "truth":
        where, how_fast = f"{vehicle}/truth/pose", f"{vehicle}/truth/velocity"
        if where not in ports:
            return None
        newest: dict[str, Sample] = {}

        def truth(sample: Sample) -> DataMessage | None:
            newest[sample.port] = sample
            place, speed = newest.get(where), newest.get(how_fast)
            if place is None or speed is None or place.t_ns != speed.t_ns:
                return None  # the other sample of this time is still to come
            values = (*place.value, *speed.value)
            return state(*values) if len(values) == 4 and all(map(is_whole, values)) else None

        return (where, how_fast), truth
    path = f"{vehicle}/autopilot/state"
    if path not in ports:
        return None
    names = [field.name for field in ports[path].fields]
    picked = [names.index(name) for name in ("p_N", "q_NB", "v_N", "w_B")]

    def estimate(sample: Sample) -> DataMessage | None:
        p_N, q_NB, v_N, w_B = (sample.value[k] for k in picked)
        if not all(map(is_whole, (p_N, q_NB, v_N, w_B))):
            return None
        return state(p_N, q_NB, rotate(conjugate(q_NB), v_N), w_B)  # type: ignore[arg-type]  # whole

    return (path,), estimate


def _steering(vehicle: str) -> Callable[[PlayerMessage], Ask]:
    """Return what takes the messages of a position3d. Velocity and position go to the vehicle's autopilot; motor power arms it, and either mode makes
    it follow them."""

    def take(message: PlayerMessage) -> Ask:
        kind = (message.type, message.subtype)
        if message.type == CMD and message.subtype in (SET_VEL, SET_POS):
            x, y, z, _, _, yaw, _ = wire.read(_VELOCITY, message.body)
            if message.subtype == SET_VEL:
                value: dict[str, object] = {"v_B": list(frd_from_flu((x, y, z))), "yaw_rate": -yaw}
                return Ask(f"{vehicle}/autopilot/velocity", args=value)
            value = {"p_N": list(ned_from_enu((x, y, z))), "heading": heading(yaw)}
            return Ask(f"{vehicle}/autopilot/position", args=value)
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


def _standard(port: Port, epoch_ns: int) -> Iterator[tuple[int, DataMaker]]:
    names = [field.name for field in port.fields]
    if port.direction != "sensor":
        return
    if port.message == "Imu" and {"f_S", "w_S"} <= set(names):
        yield IMU, imu(names.index("f_S"), names.index("w_S"))
    elif port.message == "NavSatFix" and {"latitude", "longitude", "height", "v_NS"} <= set(names):
        yield GPS, gps(names, epoch_ns)
    elif RANGES.get(port.message or "", "") in names:
        yield RANGER, ranger(names.index(RANGES[str(port.message)]))


def _of_imu(message: PlayerMessage) -> Ask:
    if (message.type, message.subtype) == (REQ, _SET_DATATYPE) and wire.read_u32(message.body) == CALIBRATED:
        return Ask()
    raise Refused("bad_argument", "an imu tells calibrated data (datatype 2) here, and takes nothing else")


# -- all others -----------------------------------------------------------------------------------------------------------------------------


def _opaque(port: Port) -> tuple[tuple[str, ...], DataMaker, Callable[[PlayerMessage], Ask] | None]:
    """Return ports, `tell` and `take` of a device that stands for a port, with JSON as on every wire of text."""
    if port.direction == "sensor":
        form = SampleForm(port)

        def tell(sample: Sample) -> DataMessage:
            said = {"t_ns": sample.t_ns, "seq": sample.seq, "valid": sample.valid, "value": form.value(sample)}
            return 1, wire.octets(msgspec.json.encode(said))

        return (port.path,), tell, None

    def take(message: PlayerMessage) -> Ask:
        if message.type not in (CMD, REQ):
            raise Refused("invalid_request", "an actuator takes commands, or requests, which are answered")
        return Ask(port.path, args=_object(message))

    return (), lambda _: None, take


def _object(message: PlayerMessage) -> dict[str, object]:
    said = decode(wire.read_octets(message.body).rstrip(b"\0"), "json")
    if not isinstance(said, dict):
        raise Refused("bad_argument", "the data are a JSON object, {...}")
    return said


def _service_call(message: PlayerMessage) -> Ask:
    said = _object(message)
    service, args = said.get("service"), said.get("args", {})
    if not isinstance(service, str) or not isinstance(args, dict) or set(said) - {"service", "args"}:
        raise Refused("bad_argument", 'a call is {"service": "world/pause", "args": {}}')
    return Ask(service=service, args=args)
