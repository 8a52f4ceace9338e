"""A vehicle with the sensors that devices serve, and samples whose numbers a test chooses."""

from __future__ import annotations

import math

from uwserver_adapters.devices.device import Device, Reader
from uwserver_adapters.devices.inertial import GPS_ZERO, LEAP_S, WEEK_S, Fix, Readings

from uwserver.frames import Vec3, quat_from_rpy
from uwserver.ports import Argument, Field, Port, Sample, Service, Value
from uwserver.ports.buffer import Layout
from uwserver.testing import FakeContext

EPOCH_NS = 1_704_067_200_000_000_000
"""2024-01-01T00:00:00Z, of `FakeContext`."""
S = 1_000_000_000
ZERO: Vec3 = (0.0, 0.0, 0.0)

DVL = Port(
    "rov/dvl",
    "sensor",
    "dvl",
    (
        Field("v_S", "m/s", "x", "S", (3,)),
        Field("altitude", "m", "x"),
        Field("figure_of_merit", "m/s", "x"),
        Field("covariance_S", "m^2/s^2", "x", "S", (3, 3)),
        Field("beam_velocities", "m/s", "x", shape=(4,)),
        Field("beam_ranges", "m", "x", shape=(4,)),
        Field("beam_locks", "1", "x", shape=(4,), type="bool"),
        Field("v_water_S", "m/s", "x", "S", (3,)),
    ),
    "DVL.",
    8.0,
)
ATTITUDE = Port(
    "rov/attitude",
    "sensor",
    "attitude",
    (Field("q_NS", "1", "x", "NS", (4,)), Field("heading", "rad", "x")),
    "Attitude.",
    50.0,
)
GPS = Port(
    "rov/gps",
    "sensor",
    "gps",
    (
        Field("latitude", "rad", "x"),
        Field("longitude", "rad", "x"),
        Field("height", "m", "x"),
        Field("v_NS", "m/s", "x", "N", (3,)),
        Field("satellites", "1", "x", type="int"),
        Field("fix", "1", "x", type="int"),
    ),
    "GPS.",
    5.0,
)
ALTIMETER = Port(
    "rov/ping",
    "sensor",
    "altimeter",
    (Field("range", "m", "x"), Field("confidence", "1", "x")),
    "Echosounder.",
    10.0,
)
DEPTH = Port(
    "rov/depth", "sensor", "pressure", (Field("depth", "m", "x"), Field("temperature", "degC", "x")), "Depth.", 10.0
)
SONAR = Port(
    "rov/sonar",
    "sensor",
    "scanning_sonar",
    (
        Field("head_angle", "rad", "x"),
        Field("range", "m", "x"),
        Field("gain", "dB", "x"),
        Field("bins", "1", "x", shape=(8,), type="int"),
    ),
    "Sonar.",
    20.0,
)
IMU = Port(
    "rov/imu",
    "sensor",
    "imu",
    (Field("f_S", "m/s^2", "x", "S", (3,)), Field("w_S", "rad/s", "x", "S", (3,)), Field("temperature", "degC", "x")),
    "Inertial unit.",
    200.0,
)
COMPASS = Port("rov/compass", "sensor", "magnetometer", (Field("field_S", "T", "x", "S", (3,)),), "Compass.", 20.0)
USBL = Port(
    "rov/usbl",
    "sensor",
    "usbl",
    (
        Field("beacon", "1", "x", type="str"),
        Field("range", "m", "x"),
        Field("bearing", "rad", "x"),
        Field("elevation", "rad", "x"),
        Field("p_beacon_S", "m", "x", "S", (3,)),
        Field("travel_time", "s", "x"),
    ),
    "USBL.",
    2.0,
)
MULTIBEAM = Port(
    "rov/multibeam",
    "sensor",
    "multibeam",
    (
        Field("image", "1", "x", type="buffer", buffer=Layout("uint8", (-1, -1))),
        Field("range", "m", "x"),
        Field("range_start", "m", "x"),
        Field("azimuth", "rad", "x", type="buffer", buffer=Layout("float32", (-1,))),
    ),
    "Imaging sonar.",
    15.0,
)
HEARD = Port(
    "rov/modem/received",
    "sensor",
    "acoustic_modem",
    (
        Field("event", "1", "x", type="str"),
        Field("source", "1", "x", type="int"),
        Field("destination", "1", "x", type="int"),
        Field("data", "1", "x", type="bytes"),
        Field("range", "m", "x"),
        Field("bearing", "rad", "x"),
        Field("elevation", "rad", "x"),
    ),
    "Modem.",
    1.0,
)
SEND = Port(
    "rov/modem/send",
    "actuator",
    "modem_send",
    (
        Field("destination", "1", "x", minimum=0.0, maximum=15.0),
        Field("data", "1", "x", type="bytes", max_bytes=31),
        Field("acknowledge", "1", "x", minimum=0.0, maximum=1.0),
    ),
    "Modem.",
)
PORTS = (DVL, ATTITUDE, GPS, ALTIMETER, DEPTH, SONAR, IMU, COMPASS, USBL, MULTIBEAM, HEARD, SEND)
SERVICES = (
    Service(
        "rov/dvl/set",
        "Change.",
        (
            Argument("range_mode", "int", "x", required=False, minimum=-1, maximum=4),
            Argument("sound_speed", "float", "x", "m/s", False, minimum=0, maximum=2000),
        ),
    ),
    Service(
        "rov/ping/set",
        "Change.",
        (
            Argument("range", "float", "x", "m", False, minimum=0.3, maximum=100),
            Argument("sound_speed", "float", "x", "m/s", False, minimum=0, maximum=2000),
        ),
    ),
    Service(
        "rov/multibeam/set",
        "Change.",
        (
            Argument("range", "float", "x", "m", False, minimum=0.5, maximum=40),
            Argument("gain", "float", "x", "dB", False, minimum=-60, maximum=60),
            Argument("mode", "str", "x", required=False, choices=("low", "high")),
        ),
    ),
    Service(
        "rov/sonar/set",
        "Change.",
        (
            Argument("range", "float", "x", "m", False, minimum=2, maximum=50),
            Argument("gain", "float", "x", "dB", False, minimum=-60, maximum=60),
            Argument("step", "float", "x", "rad", False, minimum=1e-3, maximum=0.6),
            Argument("sector_center", "float", "x", "rad", False, minimum=-math.pi, maximum=math.pi),
            Argument("sector_width", "float", "x", "rad", False, minimum=1e-3, maximum=2 * math.pi + 1e-9),
        ),
    ),
)
LOCKED: tuple[Value, ...] = (
    (0.5, 0.1, -0.2),
    2.5,
    0.004,
    (1e-5, 2e-6, 0.0, 2e-6, 3e-5, 0.0, 0.0, 0.0, 4e-6),
    (0.1, -0.1, 0.2, None),
    (2.6, 2.7, 2.8, None),
    (True, True, True, False),
    (0.3, 0.0, 0.0),
)
LOST: tuple[Value, ...] = (
    (None,) * 3,
    None,
    None,
    (None,) * 9,
    (None,) * 4,
    (None,) * 4,
    (False,) * 4,
    (None,) * 3,
)


def make_context() -> FakeContext:
    """Of a rov with all these."""
    return FakeContext(ports={port.path: port for port in PORTS}, services={s.path: s for s in SERVICES})


def sample(port: Port, value: tuple[Value, ...], t_s: float = 0.0, valid: bool = True, late_s: float = 0.0) -> Sample:
    """A sample of a time, delivered so much later."""
    assert len(value) == len(port.fields)
    return Sample(port.path, 0, round(t_s * S), round((t_s + late_s) * S), valid, value)


def ask(device: Device, data: bytes) -> tuple[list[bytes], list[str]]:
    """What a peer that sends these bytes is answered, and what was counted as no message."""
    reader: Reader = device.reader()
    replies: list[bytes] = []
    bad: list[str] = []
    reader.receive(data)
    while (event := reader.next_event()) is not None:
        reason = device.take(event, replies.append)
        if reason:
            bad.append(reason)
    return replies, bad


def inertial_readings(
    rpy_deg: Vec3 = ZERO, f_S: Vec3 = ZERO, w_S: Vec3 = ZERO, gauss: Vec3 = ZERO, temperature: float = 0.0,
    fix: Fix | None = None, week: int = 0, tow: float = 0.0,
) -> Readings:  # fmt: skip
    """What an inertial unit measures at a time of a GPS week (s)."""
    epoch_ns = (int(GPS_ZERO.timestamp()) - LEAP_S + week * WEEK_S) * S
    roll, pitch, yaw = map(math.radians, rpy_deg)
    field_S = (gauss[0] * 1e-4, gauss[1] * 1e-4, gauss[2] * 1e-4)
    q_NS = quat_from_rpy(roll, pitch, yaw)
    return Readings(round(tow * S), epoch_ns, f_S, w_S, field_S, temperature, q_NS, fix or Fix())
