"""Names of components, and what clients are told of them."""

from typing import Any

import pytest
from uwserver_adapters.morse.stage import check_names, components, details, places

from uwserver.adapter import CannotServe
from uwserver.ports import Argument, Field, Port, Service


def _port(path: str, direction: Any = "sensor", kind: str = "x") -> Port:
    return Port(path, direction, kind, (Field("a", "1", "x"),), "x")


PORTS = {
    port.path: port
    for port in (
        _port("rov/imu"),
        _port("rov/pose"),
        _port("rov/truth/pose", kind="truth_pose"),
        _port("rov/truth/velocity", kind="truth_velocity"),
        _port("rov/thrusters", "actuator"),
        _port("rov/autopilot/velocity", "actuator"),
    )
}
SERVICES = {
    path: Service(path, "x", (Argument("n", "int", "x"),))
    for path in ("rov/imu/get", "rov/imu/set", "rov/autopilot/goto", "rov/autopilot/arm", "world/reset")
}


def test_usual_names() -> None:
    """Ground truth goes by MORSE's names, unless a sensor has the name."""
    found = components(PORTS, SERVICES)
    assert {name: each.path for name, each in found.items()} == {
        "rov.autopilot_velocity": "rov/autopilot/velocity",
        "rov.imu": "rov/imu",
        "rov.motion": "rov/autopilot/velocity",
        "rov.pose": "rov/pose",
        "rov.thrusters": "rov/thrusters",
        "rov.truth_pose": "rov/truth/pose",
        "rov.velocity": "rov/truth/velocity",
        "rov.waypoint": "rov/autopilot/goto",
    }
    assert {name for name, each in found.items() if each.direction == "OUT"} == {
        "rov.imu",
        "rov.pose",
        "rov.truth_pose",
        "rov.velocity",
    }


def test_names_of_ones_own() -> None:
    found = components(PORTS, SERVICES, {"rov/truth/pose": "rov.pose", "rov/imu": "rov.xsens"})
    assert found["rov.pose"].path == "rov/truth/pose"
    assert found["rov.pose_2"].path == "rov/pose"
    assert found["rov.xsens"].path == "rov/imu"
    assert "rov.imu" not in found


@pytest.mark.parametrize(
    ("names", "text"),
    [
        ({"rov/imu": "auv.imu"}, "rov. and one word"),
        ({"rov/imu": "rov.a b"}, "rov. and one word"),
        ({"rov/imu": "rov.a.b"}, "rov. and one word"),
        ({"rov/imu": "rov.x", "rov/pose": "rov.x"}, "two ports"),
    ],
)
def test_impossible_names(names: dict[str, str], text: str) -> None:
    with pytest.raises(CannotServe, match=text):
        components(PORTS, SERVICES, names)


def test_a_name_for_a_port_that_is_not_there() -> None:
    with pytest.raises(CannotServe, match='did you mean "rov/imu"'):
        check_names({"rov/imy": "rov.x"}, PORTS)
    with pytest.raises(CannotServe, match="truth = true"):
        check_names({"rov/truth/wrench": "rov.x"}, PORTS)


def test_details() -> None:
    found = components(PORTS, SERVICES)
    said: Any = details(found, places(found, SERVICES, ["rov"]), ["rov"], "pool")
    (robot,) = said["robots"]
    assert said["environment"] == "pool"
    assert robot["name"] == "rov"
    assert robot["services"] == ["autopilot_goto", "autopilot_arm"]
    assert robot["components"]["rov.imu"]["services"] == [
        "get_local_data",
        "get_properties",
        "set_property",
        "get_configurations",
    ]
    assert [d for _, d in robot["components"]["rov.motion"]["stream_interfaces"]] == ["IN"]
    assert all(
        name.count(".") == 1 for name in robot["components"]
    )  # pymorse takes a second dot for a component of a component


def test_places() -> None:
    there = places(components(PORTS, SERVICES), SERVICES, ["rov", "bare"])
    assert there["rov"] == {"autopilot_goto": "rov/autopilot/goto", "autopilot_arm": "rov/autopilot/arm"}
    assert there["bare"] == {}
    others = {path for path in SERVICES if not path.startswith("rov/")}
    assert {path for place in there if place not in ("rov", "bare") for path in there[place].values()} == others
