"""Frames and names: each reading against what a vehicle at a known attitude must be told as in MORSE's axes."""

import math

import pytest
from uwserver_adapters.morse import codec

from uwserver.frames import quat_from_rpy, rotate
from uwserver.ports import Field, Port, Refused

POSE = Port(
    "rov/truth/pose", "sensor", "truth_pose",
    (Field("p_NB", "m", "x", "N", (3,)), Field("q_NB", "1", "x", "NB", (4,))), "x", message="TruePose",
)  # fmt: skip
VELOCITY = Port(
    "rov/truth/velocity", "sensor", "truth_velocity",
    (Field("v_NB_B", "m/s", "x", "B", (3,)), Field("w_NB_B", "rad/s", "x", "B", (3,))), "x", message="TrueVelocity",
)  # fmt: skip
IMU = Port(
    "rov/imu", "sensor", "imu",
    (Field("f_S", "m/s^2", "x", "S", (3,)), Field("w_S", "rad/s", "x", "S", (3,)), Field("temperature", "degC", "x")), "x", message="Imu",
)  # fmt: skip


def test_pose_of_a_vehicle_that_heads_east_nose_up() -> None:
    """East is yaw 0 in MORSE's world; a nose that points up is a negative pitch about the left axis."""
    said = codec.reading(POSE, ((10.0, 20.0, 5.0), quat_from_rpy(0.1, 0.2, math.pi / 2)))
    assert (said["x"], said["y"], said["z"]) == (20.0, 10.0, -5.0)
    assert said["yaw"] == pytest.approx(0.0, abs=1e-12)
    assert said["pitch"] == pytest.approx(-0.2)
    assert said["roll"] == pytest.approx(0.1)


def test_the_quaternion_says_the_same_as_the_angles() -> None:
    said = codec.reading(POSE, ((0.0, 0.0, 0.0), quat_from_rpy(0.3, -0.4, 2.5)))
    q = said["orientation"]
    assert isinstance(q, dict)
    assert q["w"] >= 0.0
    forward = rotate((q["w"], q["x"], q["y"], q["z"]), (1.0, 0.0, 0.0))
    yaw, pitch = float(said["yaw"]), float(said["pitch"])  # type: ignore[arg-type]
    assert forward == pytest.approx(
        (math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), -math.sin(pitch))
    )


def test_velocity_in_the_body_and_in_the_world() -> None:
    """Ahead and to starboard at heading east: to the right is minus y in the body, south in the world."""
    east = quat_from_rpy(0.0, 0.0, math.pi / 2)
    said = codec.reading(VELOCITY, ((1.0, 0.5, 0.25), (0.1, 0.2, 0.3)), east)
    assert said["linear_velocity"] == [1.0, -0.5, -0.25]
    assert said["angular_velocity"] == [0.1, -0.2, -0.3]
    assert said["world_linear_velocity"] == pytest.approx([1.0, -0.5, -0.25])
    assert "world_linear_velocity" not in codec.reading(VELOCITY, ((1.0, 0.5, 0.25), (0.1, 0.2, 0.3)))


def test_an_imu_at_rest_feels_gravity_upwards() -> None:
    said = codec.reading(IMU, ((0.0, 0.0, -9.81), (0.0, 0.0, 0.0), 8.0))
    assert said == {"linear_acceleration": [0.0, 0.0, 9.81], "angular_velocity": [0.0, 0.0, 0.0], "temperature": 8.0}


def test_gps_in_degrees_and_battery_in_percent() -> None:
    gps = Port(
        "r/gps",
        "sensor",
        "gps",
        tuple(Field(name, "1", "x") for name in ("latitude", "longitude", "height")),
        "x",
        message="NavSatFix",
    )
    assert codec.reading(gps, (math.pi / 4, -math.pi / 6, 2.0)) == pytest.approx(
        {"latitude": 45.0, "longitude": -30.0, "altitude": 2.0}
    )
    assert codec.reading(gps, (None, None, None)) == {"latitude": None, "longitude": None, "altitude": None}
    battery = Port("r/b", "sensor", "battery", (Field("charge", "1", "x"),), "x", message="BatteryState")
    assert codec.reading(battery, (0.5,)) == {"charge": 50.0}


def test_a_port_of_another_make_keeps_its_names() -> None:
    port = Port(
        "r/imu",
        "sensor",
        "imu",
        (Field("a_S", "1", "x", "S", (3,)), Field("mode", "1", "x", type="str")),
        "x",
        message="Imu",
    )
    assert codec.reading(port, ((1.0, 2.0, 3.0), "ok")) == {"a_S": [1.0, -2.0, -3.0], "mode": "ok"}


def test_covariances_turn_on_both_sides() -> None:
    port = Port("r/x", "sensor", "x", (Field("P_S", "1", "x", "S", (3, 3)), Field("P_N", "1", "x", "N", (3, 3))), "x")
    matrix = (1.0, 2.0, 3.0, 2.0, 4.0, 5.0, 3.0, 5.0, 6.0)
    said = codec.reading(port, (matrix, matrix))
    assert said["P_S"] == [[1.0, -2.0, -3.0], [-2.0, 4.0, 5.0], [-3.0, 5.0, 6.0]]
    assert said["P_N"] == [[4.0, 2.0, -5.0], [2.0, 1.0, -3.0], [-5.0, -3.0, 6.0]]


WRENCH = Port(
    "r/wrench", "actuator", "force_torque", (Field("force_B", "N", "x", "B", (3,)), Field("torque_B", "N m", "x", "B", (3,))), "x", message="Wrench"
)  # fmt: skip
PLACE = Port(
    "r/place",
    "actuator",
    "teleport",
    (Field("p_NB", "m", "x", "N", (3,)), Field("q_NB", "1", "x", "NB", (4,))),
    "x",
    message="Teleport",
)


def test_a_wrench_by_the_names_of_morse() -> None:
    said = codec.command(WRENCH, {"force": [1, 2, 3], "torque_B": [0.0, 0.0, 1.0], "timestamp": 3})
    assert said == {"force_B": [1, -2, -3], "torque_B": [0.0, -0.0, -1.0]}


def test_what_a_pose_says_can_be_commanded() -> None:
    q = quat_from_rpy(0.3, -0.4, 2.5)
    said = codec.reading(POSE, ((1.0, 2.0, 3.0), q))
    back = codec.command(PLACE, {"p": [said["x"], said["y"], said["z"]], "q": said["orientation"]})
    assert back["p_NB"] == [1.0, 2.0, 3.0]
    sign = math.copysign(1.0, back["q_NB"][0] * q[0])  # type: ignore[index]
    assert [sign * each for each in back["q_NB"]] == pytest.approx(list(q))  # type: ignore[attr-defined]


@pytest.mark.parametrize("said", [{"forse": [1, 2, 3]}, {}, {"timestamp": 1}])
def test_an_unknown_or_empty_command_is_refused(said: dict[str, object]) -> None:
    with pytest.raises(Refused, match=r"force"):
        codec.command(WRENCH, said)


@pytest.mark.parametrize("given", [[1, 2], "x", [1, None, 3], {"x": 1}, [1e400, 0, 0], None])
def test_shapes_are_left_for_the_world_to_refuse(given: object) -> None:
    assert codec.command(WRENCH, {"force": given}) == {"force_B": given}


def test_motion() -> None:
    assert codec.motion({"v": 0.5, "w": 0.2}) == {"v_B": [0.5, -0.0, -0.0], "yaw_rate": -0.2}
    assert codec.motion({"x": 0.5, "y": 0.1, "z": 0.3, "w": 0}) == {"v_B": [0.5, -0.1, -0.3], "yaw_rate": -0.0}


@pytest.mark.parametrize(
    "said", [{"v": "fast"}, {"v": math.nan}, {"v": True}, {"v": 10**400}, {"v": 1, "x": 1}, {"speed": 1}]
)
def test_no_motion(said: dict[str, object]) -> None:
    with pytest.raises(Refused):
        codec.motion(said)
