"""A `px4_hil` driver, a world's samples round it, and a PX4 by hand."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import common as mavlink
from uwserver_adapters.px4.driver import COUNTS, Px4Driver
from uwserver_adapters.px4.sensor_messages import Roles, SensorMessages
from uwserver_adapters.sil.in_the_loop import Outputs

from uwserver.adapter import AdapterStats, Order, Readings
from uwserver.ports import Field, Port, Sample

STEP_NS = 4_000_000


def sensor(name: str, *fields: tuple[str, int], rate_hz: float = 250.0) -> Port:
    return Port(
        f"rov/{name}", "sensor", name, tuple(Field(f, "1", f, "N", (n,) if n else ()) for f, n in fields), name, rate_hz
    )


PORTS = {
    port.path: port
    for port in (
        sensor("truth/pose", ("p_NB", 3), ("q_NB", 4)),
        sensor("truth/velocity", ("v_NB_B", 3), ("w_NB_B", 3)),
        sensor("imu", ("f_S", 3), ("w_S", 3), ("temperature", 0)),
        sensor("magnetometer", ("field_S", 3)),
        sensor("depth", ("depth", 0), ("temperature", 0)),
        sensor("altimeter", ("range", 0)),
        sensor(
            "gps", ("latitude", 0), ("longitude", 0), ("height", 0), ("v_NS", 3), ("horizontal_accuracy", 0),
            ("vertical_accuracy", 0), ("velocity_accuracy", 0), ("satellites", 0), ("fix", 0),
        ),
        Port("rov/thrusters", "actuator", "thrusters", (Field("u", "1", "u", shape=(8,), minimum=-1.0, maximum=1.0),), "T."),
    )
}  # fmt: skip
REST: dict[str, tuple[Any, ...]] = {
    "truth/pose": ((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0)),
    "truth/velocity": ((0.5, 0.0, 0.25), (0.0, 0.0, 0.1)),
    "imu": ((0.0, 0.0, -9.8), (0.01, 0.02, 0.03), 15.0),
}


class FakePx4:
    """What PX4's simulator module does, by hand."""

    def __init__(self, address: tuple[str, int]) -> None:
        self.stream = socket.create_connection(address, timeout=60)
        self.stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.mav = mavlink.MAVLink(None, 1, 1)
        self.mav.robust_parsing = True
        self.inbox: list[Any] = []

    def close(self) -> None:
        self.stream.close()

    def greet(self) -> None:
        """The two messages with which it begins."""
        self.send(self.mav.heartbeat_encode(0, 12, 0, 0, 0))
        self.send(self.mav.command_long_encode(0, 0, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 115, 5e3, 0, 0, 0, 0, 0))

    def controls(self, levels: list[float], mode: int = 128 | 1, flags: int = 1, t_us: int = 2**40) -> None:
        """Outputs, those for the newest sensor message unless told otherwise."""
        self.send(self.mav.hil_actuator_controls_encode(t_us, [*levels, *[0.0] * (16 - len(levels))], mode, flags))

    def send(self, message: Any) -> None:
        self.stream.sendall(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256

    def read(self) -> list[Any]:
        """Everything that has come."""
        found: list[Any] = []
        self.stream.settimeout(0.2)
        with contextlib.suppress(TimeoutError):
            while data := self.stream.recv(65536):
                found += self.mav.parse_buffer(data) or []
                self.stream.settimeout(0.02)
        return found

    def names(self) -> list[str]:
        return [message.get_type() for message in self.read()]


class Rig:
    """A driver and the world around it."""

    def __init__(self, listener: socket.socket, extras: bool, odometry_s: float) -> None:
        self.listener = listener
        self.now = 50.0
        self.t_ns = 0
        self.conflicts: list[str] = []
        self.stats = AdapterStats()
        self.stats.details.update(dict.fromkeys((*COUNTS, "is_locked"), 0))
        readings = Readings(PORTS, "rov")
        gps = (
            "latitude",
            "longitude",
            "height",
            "v_NS",
            "horizontal_accuracy",
            "vertical_accuracy",
            "satellites",
            "fix",
        )
        roles = Roles(
            readings.subscribe("imu", "imu", [("w_S", "f_S")]),
            readings.subscribe("pose", "truth/pose", [("p_NB", "q_NB")]),
            readings.subscribe("velocity", "truth/velocity", [("v_NB_B", "w_NB_B")]),
            readings.subscribe("magnetometer", "magnetometer", [("field_S",)]) if extras else None,
            readings.subscribe("depth", "depth", [("depth", "temperature")]) if extras else None,
            readings.subscribe("gps", "gps", [gps], keeps=False) if extras else None,
            ((readings.subscribe("altimeter", "altimeter", [("range",)], keeps=False), (0.3, 50.0)),) if extras else (),
        )
        senses = SensorMessages(readings, roles, (60.0, 5.0), odometry_s, (0.1, 0.02, 0.05))
        outputs = Outputs({}, PORTS, "rov")
        self.driver = Px4Driver(
            listener, outputs, senses, 4, 0.004, lambda: self.now, self.stats, self.conflicts.append
        )

    def connect(self) -> FakePx4:
        return FakePx4(self.listener.getsockname())

    def order(self) -> Order | None:
        """One look, in which the clock goes on by the time that it waits for."""
        for _ in range(40):
            order = self.driver.order(0.0)
            if order is not None:
                return order
            self.now += 0.001
        return None

    def tick(self, **values: tuple[Any, ...]) -> None:
        self.t_ns += STEP_NS
        given = REST | {name.replace("truth_", "truth/"): value for name, value in values.items()}
        self.driver.see(
            self.t_ns, [Sample(f"rov/{name}", 0, self.t_ns, self.t_ns, True, value) for name, value in given.items()]
        )
        self.driver.answer(self.t_ns)


@contextlib.contextmanager
def rig(extras: bool = False, odometry_s: float = 0.0) -> Iterator[Rig]:
    with contextlib.closing(socket.socket()) as listener:
        listener.setblocking(False)
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        r = Rig(listener, extras, odometry_s)
        try:
            yield r
        finally:
            r.driver.close()


@contextlib.contextmanager
def connected(r: Rig) -> Iterator[FakePx4]:
    px4 = r.connect()
    with contextlib.closing(px4.stream):
        px4.greet()
        yield px4
