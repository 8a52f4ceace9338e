"""What devices tell and take, in Player's axes and units."""

from __future__ import annotations

import math
import struct

import pytest
from msgspec import structs
from uwserver_adapters.player import wire
from uwserver_adapters.player.codec import SERVICES, Ask, Device, devices_of
from uwserver_adapters.player.wire import CMD, GPS, IMU, OPAQUE, POSITION3D, RANGER, REQ, PlayerMessage

from uwserver.frames import quat_from_rpy
from uwserver.ports import Field, Port, Refused, Sample, Value
from uwserver.recording.channels import message_of
from uwserver.testing.fake_context import IMU as IMU_PORT
from uwserver.testing.fake_context import THRUSTERS


def sensor(path: str, kind: str, *fields: Field) -> Port:
    return Port(path, "sensor", kind, fields, "x", rate_hz=10.0, message=message_of({"kind": kind}))


STATE = sensor(
    "rov/autopilot/state", "autopilot", Field("mode", "1", "x", type="str"), Field("p_N", "m", "x", "N", (3,)), Field("v_N", "m/s", "x", "N", (3,)),
    Field("q_NB", "1", "x", "NB", (4,)), Field("w_B", "rad/s", "x", "B", (3,)),
)  # fmt: skip
POSE = sensor("rov/truth/pose", "truth_pose", Field("p_NB", "m", "x", "N", (3,)), Field("q_NB", "1", "x", "NB", (4,)))
VELOCITY = sensor(
    "rov/truth/velocity",
    "truth_velocity",
    Field("v_NB_B", "m/s", "x", "B", (3,)),
    Field("w_NB_B", "rad/s", "x", "B", (3,)),
)
FIX = sensor(
    "rov/gps", "gps", Field("latitude", "rad", "x"), Field("longitude", "rad", "x"), Field("height", "m", "x"), Field("v_NS", "m/s", "x", "N", (3,)),
    Field("horizontal_accuracy", "m", "x"), Field("vertical_accuracy", "m", "x"), Field("satellites", "1", "x", type="int"),
)  # fmt: skip
ALTIMETER = sensor("rov/altimeter", "altimeter", Field("range", "m", "x"), Field("confidence", "1", "x"))
DVL = sensor("rov/dvl", "dvl", Field("beam_ranges", "m", "x", shape=(4,)))
OTHER = sensor("auv/altimeter", "altimeter", Field("range", "m", "x"))
PORTS = {each.path: each for each in (STATE, POSE, VELOCITY, IMU_PORT, FIX, ALTIMETER, DVL, THRUSTERS, OTHER)}
EPOCH_NS = 1_700_000_000_000_000_000


def devices(pose: str = "estimate") -> dict[tuple[int, str], Device]:
    return {(each.interface, each.name): each for each in devices_of(PORTS, EPOCH_NS, pose)}


def sample(port: Port, *value: Value, valid: bool = True) -> Sample:
    return Sample(port.path, 3, 1_500_000_000, 1_600_000_000, valid, value)


def test_devices_are_numbered_in_each_interface() -> None:
    found = {
        name: (each.interface, each.number) for (interface, name), each in devices().items() if interface != OPAQUE
    }
    assert found == {
        "rov": (POSITION3D, 0), "rov/imu": (IMU, 0), "rov/gps": (GPS, 0), "rov/altimeter": (RANGER, 0), "rov/dvl": (RANGER, 1),
        "auv/altimeter": (RANGER, 2),
    }  # fmt: skip
    opaque = [each.name for each in devices_of(PORTS, EPOCH_NS, "estimate") if each.interface == OPAQUE]
    assert opaque == [*PORTS, SERVICES]


def test_position3d_is_east_north_up_and_forward_left_up() -> None:
    """At 2 north, 3 east, 4 down, heading east, with the nose 0.1 up; 1 m/s forward."""
    q_NB = quat_from_rpy(0.0, 0.1, math.pi / 2)
    told = devices()[POSITION3D, "rov"].tell(
        sample(STATE, "guided", (2.0, 3.0, 4.0), (0.0, 1.0, 0.0), q_NB, (0.1, 0.2, 0.3))
    )
    assert told is not None
    subtype, body = told
    numbers = struct.unpack(">12dI", body)
    assert subtype == 1
    assert numbers[:6] == pytest.approx((3.0, 2.0, -4.0, 0.0, -0.1, 0.0))
    assert numbers[6:9] == pytest.approx((math.cos(0.1), 0.0, -math.sin(0.1)))
    assert numbers[9:] == pytest.approx((0.1, -0.2, -0.3, 0))
    assert devices()[POSITION3D, "rov"].tell(sample(STATE, "x", (None,) * 3, (0.0,) * 3, q_NB, (0.0,) * 3)) is None


def test_place_and_speed_of_the_same_moment_are_told_together() -> None:
    device = devices("truth")[POSITION3D, "rov"]
    level = (1.0, 0.0, 0.0, 0.0)
    pose, speed = sample(POSE, (1.0, 2.0, 3.0), level), sample(VELOCITY, (0.5, 0.25, 0.125), (0.0, 0.0, 1.0))
    assert device.tell(structs.replace(speed, t_ns=1_000_000_000)) is None
    assert device.tell(pose) is None
    told = device.tell(speed)
    assert told is not None
    assert struct.unpack(">12dI", told[1]) == pytest.approx(
        (2.0, 1.0, -3.0, 0.0, 0.0, math.pi / 2, 0.5, -0.25, -0.125, 0.0, 0.0, -1.0, 0)
    )


def test_an_imu_tells_calibrated_data_and_no_magnetometer() -> None:
    told = devices()[IMU, "rov/imu"].tell(sample(IMU_PORT, (1.0, 2.0, -9.75), (0.25, 0.5, 1e308), 10.0))
    assert told is not None
    numbers = struct.unpack(">9f", told[1])
    assert told[0] == 2
    assert numbers[:5] == (1.0, -2.0, 9.75, 0.25, -0.5)
    assert numbers[5] == pytest.approx(-3.4028234e38)
    assert all(map(math.isnan, numbers[6:]))
    assert devices()[IMU, "rov/imu"].tell(sample(IMU_PORT, (None,) * 3, (None,) * 3, None, valid=False)) is None


def test_gps() -> None:
    value = (math.radians(63.44), math.radians(-10.36), -0.25, (3.0, -4.0, 0.0), 1.5, 2.5, 9)
    told = devices()[GPS, "rov/gps"].tell(sample(FIX, *value))
    assert told is not None
    sec, usec, lat, lon, alt, speed, course, e, n, quality, satellites, hdop, vdop, horizontal, vertical = (
        struct.unpack(">2I3i4d4I2d", told[1])
    )
    assert (sec, usec, lat, lon, alt) == (1_700_000_001, 500_000, 634_400_000, -103_600_000, -250)
    assert (speed, course) == (5.0, pytest.approx(2 * math.pi - math.atan2(4, 3)))
    assert (quality, satellites, hdop, vdop, horizontal, vertical) == (1, 9, 0, 0, 1.5, 2.5)
    assert math.isnan(e)
    assert math.isnan(n)
    for bad in ((None, None, None, (None,) * 3, None, None, 0), (math.inf, 0.0, 0.0, (0.0,) * 3, 0.0, 0.0, 0)):
        told = devices()[GPS, "rov/gps"].tell(sample(FIX, *bad))
        assert told is not None
        assert struct.unpack(">2I3i4d4I2d", told[1])[9] == 0
    assert devices()[GPS, "rov/gps"].tell(sample(FIX, 1e308, 1e308, 1e308, (1e308,) * 3, 0.0, 0.0, 2**40)) is not None


def test_rangers() -> None:
    assert devices()[RANGER, "rov/altimeter"].tell(sample(ALTIMETER, 7.5, 1.0)) == (1, wire.rows([7.5]))
    told = devices()[RANGER, "rov/dvl"].tell(sample(DVL, (1.0, None, 3.0, 4.0)))
    assert told is not None
    assert math.isnan(struct.unpack(">II4d", told[1])[3])


def test_steering() -> None:
    take = devices()[POSITION3D, "rov"].take
    assert take is not None
    speed = PlayerMessage(POSITION3D, 0, CMD, 1, struct.pack(">6dI", 1.0, 2.0, 3.0, 9.0, 9.0, 0.5, 1))
    assert take(speed) == Ask("rov/autopilot/velocity", args={"v_B": [1.0, -2.0, -3.0], "yaw_rate": -0.5})
    place = PlayerMessage(POSITION3D, 0, CMD, 2, struct.pack(">6dI6d", 1.0, 2.0, -3.0, 0.0, 0.0, 0.0, 1, *[0.0] * 6))
    assert take(place) == Ask("rov/autopilot/position", args={"p_N": [2.0, 1.0, 3.0], "heading": math.pi / 2})
    assert take(PlayerMessage(POSITION3D, 0, REQ, 2, b"\0\0\0\1")) == Ask(service="rov/autopilot/arm")
    assert take(PlayerMessage(POSITION3D, 0, REQ, 2, b"\0\0\0\0")) == Ask(service="rov/autopilot/disarm")
    assert take(PlayerMessage(POSITION3D, 0, REQ, 3, b"\0\0\0\1")) == Ask(
        service="rov/autopilot/set_mode", args={"mode": "guided"}
    )
    nan = PlayerMessage(POSITION3D, 0, CMD, 2, struct.pack(">6dI", 0.0, 0.0, 0.0, 0.0, 0.0, math.nan, 1))
    assert math.isnan(take(nan).args["heading"])  # type: ignore[arg-type]  # the world refuses it
    for wrong in (
        PlayerMessage(POSITION3D, 0, CMD, 1, b"\0" * 8),
        PlayerMessage(POSITION3D, 0, REQ, 5),
        PlayerMessage(POSITION3D, 0, CMD, 9, bytes(52)),
    ):
        with pytest.raises(Refused):
            take(wrong)


def test_opaque_devices_are_json() -> None:
    of = devices()
    told = of[OPAQUE, "rov/altimeter"].tell(sample(ALTIMETER, 7.5, None))
    assert told is not None
    assert (
        wire.read_octets(told[1]) == b'{"t_ns":1500000000,"seq":3,"valid":true,"value":{"range":7.5,"confidence":null}}'
    )
    thrusters, services = of[OPAQUE, "rov/thrusters"].take, of[OPAQUE, SERVICES].take
    assert thrusters is not None
    assert services is not None
    assert thrusters(PlayerMessage(OPAQUE, 0, CMD, 1, wire.octets(b'{"u": [1]}'))) == Ask(
        "rov/thrusters", args={"u": [1]}
    )
    call = wire.octets(b'{"service": "world/step", "args": {"n": 2}}\0')
    assert services(PlayerMessage(OPAQUE, 0, REQ, 1, call)) == Ask(service="world/step", args={"n": 2})
    for body in (
        b"[]",
        b"{",
        b'{"args": {}}',
        b'{"service": 1}',
        b'{"service": "x", "other": 1}',
        b'{"service": "x", "args": []}',
    ):
        with pytest.raises(Refused):
            services(PlayerMessage(OPAQUE, 0, REQ, 1, wire.octets(body)))
    with pytest.raises(Refused):
        thrusters(PlayerMessage(OPAQUE, 0, REQ, 1, wire.octets(b"[]")))
