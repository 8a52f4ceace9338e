"""A scenario's table, and the zenoh settings that it makes."""

from __future__ import annotations

import json

import msgspec
import pytest
from uwserver_adapters.zenoh_session.config import ZenohConfig, endpoints, is_exposed, settings


def made(**table: object) -> dict[str, object]:
    config = msgspec.convert({"kind": "zenoh", **table}, ZenohConfig)
    return {path: json.loads(value) for path, value in settings(config, endpoints(config))}


@pytest.mark.parametrize("mode", ["peer", "router", "client"])
def test_nothing_leaves_this_machine_unless_told(mode):
    found = made(mode=mode)
    assert found["mode"] == mode
    assert found["scouting/multicast/enabled"] is False
    assert found["listen/endpoints"] == ([] if mode == "client" else ["tcp/127.0.0.1:7447"])
    assert found["connect/endpoints"] == (["tcp/127.0.0.1:7447"] if mode == "client" else [])


@pytest.mark.parametrize("table", [{"scouting": True}, {"connect": ["tcp/127.0.0.1:7447"]}])
def test_a_peer_that_finds_others_takes_a_free_loopback_port(table):
    found = made(**table)
    assert found["scouting/multicast/enabled"] is table.get("scouting", False)
    (endpoint,) = found["listen/endpoints"]
    assert endpoint.startswith("tcp/127.0.0.1:")
    assert not endpoint.endswith((":0", ":7447"))


def test_a_client_listens_nowhere():
    found = made(mode="client", connect=["tcp/10.0.0.1:7447"])
    assert found["listen/endpoints"] == []
    assert found["connect/endpoints"] == ["tcp/10.0.0.1:7447"]
    assert found["scouting/multicast/enabled"] is False
    assert made(mode="client", scouting=True)["connect/endpoints"] == []


def test_a_sample_hardly_waits():
    assert 0 < made()["transport/link/tx/queue/congestion_control/drop/wait_before_drop"] <= 50  # us


def test_raw_settings_come_last_and_nested_tables_are_paths():
    tls = {"link": {"tls": {"root_ca_certificate": "ca.pem"}}}
    config = msgspec.convert({"kind": "zenoh", "config": {"mode": "client", "transport": tls}}, ZenohConfig)
    pairs = list(settings(config, ()))
    assert pairs[-2:] == [("mode", '"client"'), ("transport/link/tls/root_ca_certificate", '"ca.pem"')]


def test_a_configuration_file_keeps_what_the_table_leaves_out():
    found = made(config_file="zenoh.json5")
    assert not {"listen/endpoints", "connect/endpoints", "scouting/multicast/enabled"} & found.keys()
    assert made(config_file="zenoh.json5", listen=["tcp/[::1]:7447"])["listen/endpoints"] == ["tcp/[::1]:7447"]


@pytest.mark.parametrize(
    "endpoint", ["tcp/127.0.0.1:0", "tls/127.0.0.1:0", "tcp/127.0.0.1:0#so_sndbuf=65000", "tcp/[::1]:0"]
)
def test_free_ports(endpoint):
    try:
        (found,) = endpoints(ZenohConfig(listen=(endpoint,)))
    except OSError:
        pytest.skip("this machine has no such loopback address")
    assert ":0" not in found.replace("::1", "")
    assert found[:4] == endpoint[:4]
    assert found.partition("#")[1:] == endpoint.partition("#")[1:]


@pytest.mark.parametrize(
    ("table", "exposed"),
    [
        ({}, False),
        ({"listen": ("tcp/0.0.0.0:7447",)}, True),
        ({"listen": ("tcp/[::1]:7447", "tcp/localhost:7447")}, False),
        ({"listen": ("tcp/0.0.0.0:7447",), "config": {"access_control": {"enabled": True}}}, False),
        ({"listen": ("tls/0.0.0.0:7447",), "config": {"transport/link/tls/listen_certificate": "c.pem"}}, False),
        ({"listen": ("tcp/0.0.0.0:7447",), "config": {"transport/auth/usrpwd/user": "u"}}, False),
    ],
)
def test_who_can_reach_it(table, exposed):
    config = ZenohConfig(**table)
    assert is_exposed(config, endpoints(config)) is exposed


@pytest.mark.parametrize(
    "table",
    [
        {"mode": "broker"},
        {"listen": ["7447"]},
        {"encoding": "cbor"},
        {"call_timeout_s": 0},
        {"queue_requests": 0},
        {"modes": 1},
    ],
)
def test_wrong_tables(table):
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"kind": "zenoh", **table}, ZenohConfig)
