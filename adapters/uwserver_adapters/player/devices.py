"""The devices of Player that the world has, the data that they send, and the messages that they take."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import msgspec

from uwserver.adapter import SampleForm, decode
from uwserver.frames import conjugate, frd_from_flu, ned_from_enu, rotate
from uwserver.ports import Port, Refused, Sample
from uwserver_adapters.player import codec, wire
from uwserver_adapters.player.codec import DataMaker, DataMessage
from uwserver_adapters.player.wire import CMD, GPS, IMU, OPAQUE, POSITION3D, RANGER, REQ, PlayerMessage

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
            return codec.state(*values) if len(values) == 4 and all(map(codec.is_whole, values)) else None

        return (where, how_fast), truth
    path = f"{vehicle}/autopilot/state"
    if path not in ports:
        return None
    names = [field.name for field in ports[path].fields]
    picked = [names.index(name) for name in ("p_N", "q_NB", "v_N", "w_B")]

    def estimate(sample: Sample) -> DataMessage | None:
        p_N, q_NB, v_N, w_B = (sample.value[k] for k in picked)
        if not all(map(codec.is_whole, (p_N, q_NB, v_N, w_B))):
            return None
        return codec.state(p_N, q_NB, rotate(conjugate(q_NB), v_N), w_B)  # type: ignore[arg-type]  # whole

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
            value = {"p_N": list(ned_from_enu((x, y, z))), "heading": codec.heading(yaw)}
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
        yield IMU, codec.imu(names.index("f_S"), names.index("w_S"))
    elif port.message == "NavSatFix" and {"latitude", "longitude", "height", "v_NS"} <= set(names):
        yield GPS, codec.gps(names, epoch_ns)
    elif RANGES.get(port.message or "", "") in names:
        yield RANGER, codec.ranger(names.index(RANGES[str(port.message)]))


def _of_imu(message: PlayerMessage) -> Ask:
    if (message.type, message.subtype) == (REQ, _SET_DATATYPE) and wire.read_u32(message.body) == codec.CALIBRATED:
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
