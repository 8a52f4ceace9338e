"""The words of rmw_zenoh: keys, tokens, identities, attachments."""

from __future__ import annotations

import pytest
from uwserver_adapters.ros2.config import Ros2Config
from uwserver_adapters.ros2.graph import LATCHED, RELIABLE, Attachment, Endpoint, Names, attachment, gid, parsed_token

from uwserver.adapter import CannotServe

NAMES = Names(0, "aac3178e146ba6f1fc6e6a4085e77f21", "uwserver")
IMU = ("sensor_msgs/msg/Imu", "RIHS01_7d9a00ff")


def test_a_key_has_domain_topic_type_and_hash():
    assert NAMES.key("/rov/imu", *IMU) == "0/rov/imu/sensor_msgs::msg::dds_::Imu_/RIHS01_7d9a00ff"


def test_tokens():
    assert NAMES.node_token() == "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/uwserver"
    assert NAMES.token(7, "MP", "/rov/imu", *IMU, RELIABLE) == (
        "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/7/MP/%/%/uwserver/%rov%imu/sensor_msgs::msg::dds_::Imu_/RIHS01_7d9a00ff/1:2:1,10:,:,:,,"
    )
    assert LATCHED.startswith("1:1:1,1:")


def test_the_identity_of_a_token_is_that_of_rmw_zenoh():
    """The value that its own C++ code gives for this token."""
    assert gid(NAMES.node_token()).hex() == "85cff0da26aa9db797addd2f5b0c3777"


def test_tokens_of_others_are_read_also_with_more_parts():
    token = NAMES.token(7, "SC", "/ns/add", "a/srv/Add", "RIHS01_00", RELIABLE)
    wanted = Endpoint(NAMES.zid, "SC", "/uwserver", "/ns/add", "a::srv::dds_::Add_", "RIHS01_00")
    assert parsed_token(token) == wanted
    assert parsed_token(token + "/cuda") == wanted
    assert NAMES.parsed(token) == wanted._replace(type="a/srv/Add")
    spaced = token.replace("/%/%/uwserver/", "/%/%ns/talker/")
    assert parsed_token(spaced).node == "/ns/talker"
    for none in (NAMES.node_token(), "", "@ros2_lv", "x/" * 13, token.replace("/SC/", "/XX/")):
        assert parsed_token(none) is None


def test_attachments_go_both_ways():
    made = Attachment(5, 1_700_000_000_000_000_000, bytes(range(16)))
    data = made.packed()
    assert len(data) == 33
    assert data[:8] == (5).to_bytes(8, "little")
    assert data[16] == 16
    assert attachment(data) == made
    for wrong in (None, b"", data[:-1], data + b"\0", data[:16] + b"\x0f" + data[17:]):
        assert attachment(wrong) is None


def test_the_domain_is_that_of_the_environment(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert Ros2Config().its_domain == 42
    assert Ros2Config(domain=7).its_domain == 7
    monkeypatch.setenv("ROS_DOMAIN_ID", "900")
    with pytest.raises(CannotServe, match="0 to 232"):
        _ = Ros2Config().its_domain
    monkeypatch.delenv("ROS_DOMAIN_ID")
    assert Ros2Config().its_domain == 0
