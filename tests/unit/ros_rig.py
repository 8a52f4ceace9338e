"""One port of each kind, with fixed samples and mounts: what tests of the ROS dialects share."""

from __future__ import annotations

import math

import numpy as np
from msgspec import UNSET
from uwserver_adapters.ros.messages import Catalogue, Facts, Mount, Types

from uwserver.ports import Argument, BeamView, Buffer, FanView, Field, Layout, Port, Propulsor, Sample, Service
from uwserver.recording.channels import message_of
from uwserver.testing.fake_context import SERVICES, FakeContext

EPOCH_NS = 1_767_225_600_000_000_000
T_NS = 12_345_678_901
NAN = math.nan
DEG = math.pi / 180


def sensor(path, kind, rate_hz=10.0, **fields):
    """A sensor; fields as name=(unit, frame, shape, type)."""
    made = []
    for name, described in fields.items():
        unit, frame, shape, kind_of = (*described, *("1", "", (), "float")[len(described) :])
        made.append(Field(name, unit, f"{name} of a test", frame, shape, kind_of))
    message = message_of({"kind": kind}) or UNSET
    return Port(path, "sensor", kind, tuple(made), "A sensor of a test.", rate_hz=rate_hz, message=message)


V3 = ("1", "S", (3,))
TEXT, FLAG, WHOLE = ("1", "", (), "str"), ("1", "", (), "bool"), ("1", "", (), "int")

TABLE = {
    sensor("rov/imu", "imu", f_S=V3, w_S=V3, temperature=("degC",)): ((0.1, 0.2, -9.81), (0.01, 0.02, 0.03), 8.5),
    sensor("rov/pressure", "pressure", pressure=("Pa",)): (201_325.0,),
    sensor("rov/depth", "pressure", depth=("m",)): (10.25,),
    sensor("rov/mocap", "motion_capture", p_NS=("m", "N", (3,)), q_NS=("1", "NS", (4,))): (
        (1.0, 2.0, 3.0), (math.cos(15 * DEG), 0.0, 0.0, math.sin(15 * DEG)),
    ),
    sensor(
        "rov/dvl", "dvl", v_S=V3, altitude=("m",), figure_of_merit=("m/s",), covariance_S=("1", "S", (3, 3)),
        beam_velocities=("m/s", "", (4,)), beam_ranges=("m", "", (4,)), beam_locks=("1", "", (4,), "bool"), v_water_S=V3,
    ): (
        (0.5, 0.1, -0.05), 20.0, 0.01, (1e-4, 1e-5, 2e-5, 1e-5, 2e-4, 3e-5, 2e-5, 3e-5, 3e-4),
        (0.2, -0.1, None, 0.1), (21.0, 21.5, None, 22.0), (True, True, False, True), (0.4, 0.1, 0.0),
    ),
    sensor("rov/altimeter", "altimeter", range=("m",), confidence=("1",)): (12.5, 0.9),
    sensor(
        "rov/sonar", "scanning_sonar", head_angle=("rad",), range=("m",), gain=("dB",), bins=("1", "", (4,), "int"),
    ): (0.5, 20.0, 30.0, (0, 10, 200, 255)),
    Port(
        "rov/imaging", "sensor", "multibeam",
        (
            Field("range_start", "m", "x"), Field("range", "m", "x"), Field("gain", "dB", "x"), Field("frequency", "Hz", "x"),
            Field("sound_speed", "m/s", "x"),
            Field("azimuth", "rad", "x", type="buffer", buffer=Layout("float32", (3,))),
            Field("image", "1", "x", type="buffer", buffer=Layout("uint8", (2, 3))),
        ),
        "A sensor of a test.", rate_hz=10.0, message="SonarImage",
    ): (
        0.0, 20.0, 0.0, 750e3, 1500.0, Buffer.of(np.array([-0.5, 0.0, 0.5], np.float32)), Buffer.of(np.array([[0, 1, 2], [3, 4, 5]], np.uint8)),
    ),
    Port(
        "rov/side", "sensor", "side_scan",
        (
            Field("range", "m", "x"), Field("gain", "dB", "x"), Field("frequency", "Hz", "x"), Field("sound_speed", "m/s", "x"),
            Field("port", "1", "x", type="buffer", buffer=Layout("uint8", (3,))),
            Field("starboard", "1", "x", type="buffer", buffer=Layout("uint8", (3,))),
        ),
        "A sensor of a test.", rate_hz=10.0, message="SideScan",
    ): (30.0, 0.0, 450e3, 1500.0, Buffer.of(np.array([1, 2, 3], np.uint8)), Buffer.of(np.array([4, 5, 6], np.uint8))),
    Port(
        "rov/swath", "sensor", "bathymetry",
        (
            Field("max_range", "m", "x"), Field("gain", "dB", "x"), Field("frequency", "Hz", "x"), Field("sound_speed", "m/s", "x"),
            *(Field(name, "1", "x", type="buffer", buffer=Layout("float32", (3,))) for name in ("angle", "range", "quality")),
            Field("hits", "1", "x", type="buffer", buffer=Layout("uint16", (3,))),
            Field("level", "dB", "x", type="buffer", buffer=Layout("float32", (3,))),
        ),
        "A sensor of a test.", rate_hz=10.0, message="Bathymetry",
    ): (
        50.0, 0.0, 400e3, 1500.0,
        *(Buffer.of(np.array(row, np.float32)) for row in ((-1.0, 0.0, 1.0), (20.0, NAN, 21.0), (0.9, 0.0, 0.8))),
        Buffer.of(np.array([7, 0, 8], np.uint16)), Buffer.of(np.array([110.0, NAN, 109.0], np.float32)),
    ),
    sensor(
        "rov/profiler", "profiler", max_range=("m",), gain=("dB",), frequency=("Hz",), sound_speed=("m/s",), head_angle=("rad",),
        range=("m",), level=("dB",), quality=("1",),
    ): (20.0, 0.0, 1e6, 1500.0, 0.5, 8.0, 120.0, 0.9),
    sensor(
        "rov/usbl", "usbl", beacon=TEXT, range=("m",), bearing=("rad",), elevation=("rad",), p_beacon_S=V3, travel_time=("s",),
        hydrophone_ranges=("m", "", (2,)),
    ): ("station", 30.0, 0.5, 0.2, (20.0, 10.0, 5.0), 0.04, (30.1, 29.9)),
    sensor("rov/lbl", "lbl", beacon=TEXT, range=("m",), travel_time=("s",)): ("north", 120.0, 0.16),
    sensor("rov/compass", "magnetometer", field_S=V3): ((1.5e-5, 1e-6, 4.9e-5),),
    sensor("rov/ahrs", "attitude", q_NS=("1", "NS", (4,)), heading=("rad",)): ((1.0, 0.0, 0.0, 0.0), 30 * DEG),
    sensor(
        "rov/gps", "gps", latitude=("rad",), longitude=("rad",), height=("m",), v_NS=("m/s", "N", (3,)), horizontal_accuracy=("m",),
        vertical_accuracy=("m",), velocity_accuracy=("m/s",), satellites=WHOLE, fix=WHOLE,
    ): (63.43 * DEG, 10.4 * DEG, 0.5, (1.0, 0.2, 0.1), 1.5, 2.5, 0.1, 9, 3),
    sensor("rov/ctd", "ctd", conductivity=("S/m",), temperature=("degC",), pressure=("Pa",), salinity=("1",)): (
        3.5, 8.0, 2e5, 34.5,
    ),
    sensor("rov/svs", "sound_speed", sound_speed=("m/s",)): (1490.0,),
    sensor("rov/lasers", "range_array", ranges=("m", "", (3,))): ((1.0, None, 3.0),),
    sensor("rov/bumper", "contact", touching=FLAG, impulse_B=("N s", "B", (3,))): (True, (0.5, 0.1, -0.2)),
    sensor("rov/battery", "battery", voltage=("V",), current=("A",), charge=("1",)): (15.5, 12.0, 0.75),
    sensor("rov/leak", "leak", leak=FLAG): (False,),
    Port(
        "rov/shafts", "sensor", "rpm", (Field("speeds", "rad/s", "shaft speed, order: t1, t2", shape=(2,)),), "Shafts.", rate_hz=20.0,
        message="ShaftSpeeds",
    ): ((100.0, -50.0),),
    sensor("rov/clock", "clock", utc_ns=WHOLE, elapsed=("s",)): (EPOCH_NS + T_NS + 5, 12.345678906),
    sensor("rov/truth/pose", "truth_pose", p_NB=("m", "N", (3,)), q_NB=("1", "NB", (4,))): (
        (1.0, 2.0, 3.0), (math.cos(15 * DEG), 0.0, 0.0, math.sin(15 * DEG)),
    ),
    sensor("rov/truth/velocity", "truth_velocity", v_NB_B=("m/s", "B", (3,)), w_NB_B=("rad/s", "B", (3,))): (
        (1.0, 0.2, -0.1), (0.01, 0.02, 0.3),
    ),
    sensor("rov/truth/acceleration", "truth_acceleration", v_dot_B=("1", "B", (3,)), w_dot_B=("1", "B", (3,))): (
        (0.1, 0.2, 0.3), (0.4, 0.5, 0.6),
    ),
    sensor("rov/truth/wrench", "truth_wrench", force_B=("N", "B", (3,)), torque_B=("N m", "B", (3,))): (
        (1.0, 2.0, 3.0), (4.0, 5.0, 6.0),
    ),
    sensor(
        "rov/autopilot/state", "autopilot", mode=TEXT, armed=FLAG, p_N=("m", "N", (3,)), position_valid=FLAG, v_N=("m/s", "N", (3,)),
        velocity_valid=FLAG, q_NB=("1", "NB", (4,)), w_B=("rad/s", "B", (3,)), failsafe=TEXT,
    ): (
        "depth_hold", True, (1.0, 2.0, 3.0), True, (0.5, 0.5, 0.0), False,
        (math.cos(15 * DEG), 0.0, 0.0, math.sin(15 * DEG)), (0.0, 0.0, 0.1), "",
    ),
    Port(
        "rov/strange", "sensor", "plankton", (
            Field("count", "1", "cells", type="int"), Field("Size", "m", "of each", shape=(2,)), Field("name", "1", "of it", type="str"),
            Field("picture", "1", "of it", type="buffer", buffer=Layout("uint8", (2, -1))),
        ), "Unknown to all standards.", rate_hz=1.0,
    ): (7, (1e-5, None), "diatom", Buffer.of(np.arange(6, dtype=np.uint8).reshape(2, 3))),
}  # fmt: skip
"""Port -> value of its sample."""

ACTUATORS = (
    Port(
        "rov/thrusters", "actuator", "thrusters", (Field("u", "1", "command", shape=(3,), minimum=-1.0, maximum=1.0),), "All.",
        timeout_s=1.0, propulsors=tuple(Propulsor(name, (0, 0, 0), (1, 0, 0)) for name in ("t1", "t2", "t3")),
    ),
    Port("rov/fin", "actuator", "fin", (Field("angle_rad", "rad", "angle", minimum=-0.5, maximum=0.5),), "Fin."),
    Port(
        "rov/tow", "actuator", "force_torque", (
            Field("force_B", "N", "force", "B", (3,)), Field("torque_B", "N m", "moment", "B", (3,)),
        ), "Rope.", message="Wrench",
    ),
    Port(
        "rov/teleport", "actuator", "teleport", (
            Field("p_NB", "m", "place", "N", (3,)), Field("q_NB", "1", "attitude", "NB", (4,)),
        ), "Elsewhere.", message="Teleport",
    ),
    Port(
        "rov/autopilot/velocity", "actuator", "autopilot", (
            Field("v_B", "m/s", "speed", "B", (3,)), Field("v_N", "m/s", "speed", "N", (3,)), Field("yaw_rate", "rad/s", "turn"),
        ), "Fly.",
    ),
    Port(
        "rov/autopilot/position", "actuator", "autopilot", (Field("p_N", "m", "place", "N", (3,)), Field("heading", "rad", "heading")),
        "Go.",
    ),
    Port("rov/autopilot/depth", "actuator", "autopilot", (Field("depth", "m", "depth"),), "Depth."),
    Port("rov/autopilot/pilot", "actuator", "autopilot", (Field("u", "1", "sticks", shape=(6,)),), "Sticks."),
    Port(
        "rov/lamp", "actuator", "lamp", (Field("power", "1", "part"), Field("colour", "1", "word", type="str")), "Light.",
    ),
)  # fmt: skip

TILT = 30 * DEG
MOUNTS = {
    "rov/imu": Mount((0.1, 0.2, -0.3), (0.0, 0.0, 0.0, 1.0), sigmas={"w_S": 0.01, "f_S": (0.1, 0.2, 0.3)}),
    "rov/depth": Mount((0.0, 0.0, 0.1), sigmas={"depth": 0.05}),
    "rov/altimeter": Mount((0.2, 0.0, 0.2), beams=(BeamView((0.0, 0.0, 1.0), 0.5, 0.3, 50.0),)),
    "rov/dvl": Mount(
        beams=tuple(
            BeamView((math.sin(TILT) * math.cos(a), math.sin(TILT) * math.sin(a), math.cos(TILT)), 0.0, 0.05, 50.0)
            for a in (math.pi / 4, 3 * math.pi / 4, 5 * math.pi / 4, 7 * math.pi / 4)
        )
    ),
    "rov/sonar": Mount((0.1, 0.0, -0.3), fan=FanView(0.05, 0.6, 0.03, (-1.0, 1.0), 4, 0.3, 20.0)),
    "rov/side": Mount(
        beams=tuple(BeamView((0.0, side * math.cos(TILT), math.sin(TILT)), 0.02, 1.0, 30.0) for side in (-1.0, 1.0))
    ),
    "rov/swath": Mount(beams=(BeamView((0.0, 0.0, 1.0), 0.0175, 1.0, 50.0),)),
    "rov/profiler": Mount(fan=FanView(0.03, 0.03, 0.015, (-1.0, 1.0), 1, 0.4, 20.0)),
    "rov/lasers": Mount(
        beams=tuple(BeamView((math.cos(a), math.sin(a), 0.0), 0.0, 0.1, 8.0) for a in (-0.5, 0.0, 0.5))
    ),
}
FACTS = Facts(epoch_ns=EPOCH_NS, tick_s=0.004, mounts=MOUNTS, geoid_m=40.0)


def sample(port, /, valid=True, **changed):
    """The fixed sample of a port; fields replaced by name."""
    values = dict(zip((field.name for field in port.fields), TABLE[port], strict=True))
    return Sample(port.path, 3, T_NS, T_NS, valid, tuple({**values, **changed}.values()))


FLOWN = (
    Service(
        "rov/autopilot/goto", "Go to a place.", (
            Argument("position_ned_m", "float", "place", "m", shape=(3,), minimum=-1e6, maximum=1e6),
            Argument("heading_deg", "float", "heading", required=False), Argument("speed_mps", "float", "speed", required=False, minimum=0.01),
            Argument("radius_m", "float", "nearness", required=False, minimum=0.01),
        ), long_running=True,
    ),
    Service(
        "rov/autopilot/fly_mission", "Fly a mission.", (
            Argument("items", "json", "of it", required=False), Argument("index", "int", "the first", required=False, default=0),
        ), long_running=True,
    ),
)  # fmt: skip
"""What an autopilot does that takes long."""

PORTS = {port.path: port for port in TABLE}


def context():
    """A server with one port of each kind."""
    made = FakeContext(services={service.path: service for service in SERVICES})
    made.ports = {**PORTS, **{port.path: port for port in ACTUATORS}}
    return made


def flying():
    """The same with an autopilot whose ways the test ends."""
    made = context()
    made.services = {**made.services, **{service.path: service for service in FLOWN}}
    made.held |= {service.path for service in FLOWN}
    return made


def catalogue(distro="jazzy", facts=FACTS):
    """All its topics."""
    return Catalogue.of(Types(distro), facts, context())


def messages(made):
    """Topic -> messages of the fixed samples."""
    told = {}
    for sensor_topic in made.sensor_topics:
        for path in sensor_topic.ports:
            message = sensor_topic.make(sample(PORTS[path]))
            if message is not None:
                told.setdefault(sensor_topic.name, []).append(message)
    return told
