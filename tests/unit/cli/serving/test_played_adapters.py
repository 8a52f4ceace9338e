"""Which adapters of a recording are served: none that opens files or sets the pace, and on this machine alone unless they are asked for by name."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import pytest
from playback_rig import pool

from uwserver.adapter import AdapterTable, installed_adapters
from uwserver.cli.serving.played_adapters import with_played_adapters


def with_adapters(**tables: dict[str, Any]) -> Any:
    resolved = pool()
    return replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, adapters=tables))


def test_adapters_of_a_recording_are_served_but_those_that_name_files_or_set_the_pace(
    caplog: pytest.LogCaptureFixture,
) -> None:
    known = installed_adapters()
    clock = msgspec.structs.replace(pool().scenario.world.clock, mode="lockstep", lockstep_clients=("sub",))
    resolved = with_adapters(
        tcp={"kind": "sockets", "port": 7811}, tls={"kind": "sockets", "tls_cert": "/etc/passwd"},
        odd={"kind": "of_an_extension"}, bad={"kind": "sockets", "port": "x"}, sub={"kind": "ardusub"}, none=3,
    )  # fmt: skip
    scenario = resolved.scenario
    world = msgspec.structs.replace(scenario.world, clock=clock)
    resolved = replace(resolved, scenario=msgspec.structs.replace(scenario, world=world))
    kept = with_played_adapters(resolved, known, None).scenario.adapters
    assert list(kept) == ["tcp"]
    assert isinstance(kept["tcp"], AdapterTable)
    assert kept["tcp"].port == 7811  # type: ignore[attr-defined]
    text = caplog.text
    for name in ("tls", "odd", "bad", "sub", "none"):
        assert f'adapter "{name}" of the recording is left out' in text
    assert "names files or devices (tls_cert)" in text


def test_without_adapters_it_is_served_by_sockets() -> None:
    kept = with_played_adapters(with_adapters(), installed_adapters(), 0).scenario.adapters
    assert list(kept) == ["sockets"]
    assert kept["sockets"].port == 0


def served(port: int | None = None, chosen: tuple[str, ...] = (), **tables: dict[str, Any]) -> dict[str, Any]:
    return with_played_adapters(
        with_adapters(**tables), {**installed_adapters(), "of_an_extension": Extension}, port, chosen
    ).scenario.adapters


def test_a_recording_does_not_choose_the_network() -> None:
    kept = served(
        a={"kind": "sockets", "bind": "0.0.0.0", "allowed_origins": ["*"], "allowed_hosts": ["*"], "port": 7921},
        w={"kind": "web", "bind": "::", "allowed_hosts": ["*"], "frame_ancestors": ["*"]},
    )
    assert [config.bind for config in kept.values()] == ["127.0.0.1"] * 2
    assert kept["a"].port == 7921
    assert kept["a"].allowed_origins == kept["a"].allowed_hosts == kept["w"].allowed_hosts == ()
    assert "*" not in kept["w"].frame_ancestors


@pytest.mark.parametrize(
    "table",
    [
        {"kind": "morse", "bind": "0.0.0.0", "allow_network": True},
        {"kind": "zenoh", "connect": ["tcp/192.0.2.1:7447"]},
        {"kind": "zenoh", "listen": ["tcp/0.0.0.0:7447"]},
        {"kind": "zenoh", "scouting": True},
        {"kind": "ros2", "listen": ["tcp/127.0.0.1:7447", "udp/192.0.2.1:7447"]},
        {"kind": "ros2", "transport": "dds", "allow_network": True},
        {"kind": "ros1", "master": "http://192.0.2.1:11311"},
        {"kind": "ros1", "master": "http://127.0.0.1:80"},
        {"kind": "ros1", "host": "robot"},
        {"kind": "yarp", "name_server": "127.0.0.1:25"},
        {"kind": "yarp", "bind": "0.0.0.0", "allow_network": True},
        {"kind": "player", "allow_network": True},
        {"kind": "moos", "communities": {"a": {"port": 9000}, "b": {"host": "192.0.2.1"}}},
        {"kind": "moos", "communities": {"a": {"port": 25}}},
        {"kind": "mavlink", "links": ["udpin:127.0.0.1:14550", "udpout:192.0.2.1:14550"]},
        {"kind": "mavlink", "links": ["udpout:127.0.0.1:53"]},
        {"kind": "mavlink", "links": ["udpin:0.0.0.0:14550"]},
        {"kind": "mavlink", "links": ["tcpout:127.0.0.1:25"]},
        {"kind": "mavlink", "links": ["zenoh:tcp/127.0.0.1:7447"]},
        {"kind": "video", "mavlink": ["192.0.2.1:14550"]},
        {"kind": "video", "streams": {"a": {"port": "rov/eye", "rtp": "192.0.2.1:5600"}}},
        {"kind": "video", "streams": {"a": {"port": "rov/eye", "rtp": ["127.0.0.1:5600", "127.0.0.1:53"]}}},
        {"kind": "devices", "device": {"gps": {"kind": "nmea0183", "gps": "a", "udp_to": ["192.0.2.1:10110"]}}},
        {"kind": "of_an_extension"},
    ],
)
def test_those_that_reach_others_are_left_out(table: dict[str, Any], caplog: pytest.LogCaptureFixture) -> None:
    assert list(served(far=table, near={"kind": "sockets"})) == ["near"]
    assert 'adapter "far" of the recording is left out' in caplog.text


class Extension(AdapterTable, tag="of_an_extension", kw_only=True, frozen=True):
    """Nobody here knows whom it calls."""


def test_those_that_call_this_machine_at_usual_addresses_are_served() -> None:
    kept = served(
        r={"kind": "ros1", "bind": "0.0.0.0", "allowed_hosts": ["robot"]},
        y={"kind": "yarp", "bind": "0.0.0.0", "allowed_hosts": ["robot"]},
        m={"kind": "moos", "communities": {"a": {"port": 9001, "host": "localhost"}}},
        g={"kind": "mavlink", "links": ["udpout:127.0.0.1:14550", "tcpin:127.0.0.1:5760"]},
        v={"kind": "video", "bind": "::", "streams": {"a": {"port": "rov/eye", "rtp": "127.0.0.1:5600"}}},
        p={"kind": "player", "bind": "0.0.0.0"},
        d={"kind": "devices", "device": {"b": {"kind": "nmea0183", "bind": "0.0.0.0", "gps": "a", "tcp_port": 10110}}},
    )
    assert list(kept) == ["r", "y", "m", "g", "v", "p", "d"]
    assert {kept[name].bind for name in "ryvp"} == {"127.0.0.1"}
    assert kept["d"].device["b"].bind == "127.0.0.1"
    assert kept["r"].allowed_hosts == kept["y"].allowed_hosts == ()
    assert kept["r"].master == "http://127.0.0.1:11311", "not the environment's"


@pytest.mark.parametrize("kind", ["px4_hil", "ardupilot_json"])
def test_autopilots_in_the_loop_fly_no_recording(kind: str, caplog: pytest.LogCaptureFixture) -> None:
    assert list(served(None, ("loop",), loop={"kind": kind}, near={"kind": "sockets"})) == ["near"]
    assert "it is for an autopilot that flies the vehicle" in caplog.text


def test_a_serial_line_among_links_is_not_opened(caplog: pytest.LogCaptureFixture) -> None:
    served(None, ("gcs",), gcs={"kind": "mavlink", "links": ["serial:/dev/ttyS1"]})
    assert "names files or devices (links)" in caplog.text


def test_a_nested_serial_line_is_not_opened(caplog: pytest.LogCaptureFixture) -> None:
    device = {"kind": "modem", "tcp_port": 0, "serial": "/dev/ttyS1"}
    served(None, ("bad",), bad={"kind": "devices", "device": {"modem": device}})
    assert "names files or devices (serial)" in caplog.text


def test_one_that_is_named_does_what_its_table_says() -> None:
    kept = served(
        None,
        ("z", "a"),
        z={"kind": "zenoh", "connect": ["tcp/192.0.2.1:7447"]},
        a={"kind": "sockets", "bind": "0.0.0.0"},
    )
    assert kept["z"].connect == ("tcp/192.0.2.1:7447",)
    assert kept["a"].bind == "0.0.0.0"
    with pytest.raises(ValueError, match='no adapter "y"; there are: a'):
        served(None, ("y",), a={"kind": "sockets"})


def test_health_is_told_to_this_machine_alone() -> None:
    resolved = with_adapters()
    server = msgspec.structs.replace(resolved.scenario.server, metrics_bind="0.0.0.0", allowed_hosts=("*",))
    resolved = replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, server=server))
    found = with_played_adapters(resolved, installed_adapters(), 0).scenario.server
    assert (found.metrics_bind, found.metrics_port, found.allowed_hosts) == ("127.0.0.1", 0, ())


def test_free_ports_are_taken_everywhere() -> None:
    kept = served(
        0,
        a={"kind": "sockets", "port": 7921, "udp_port": 7922},
        r={"kind": "ros2"},
        m={"kind": "morse", "stream_port": 7923},
        g={"kind": "mavlink", "links": ["tcpin:127.0.0.1:5760", "udpout:127.0.0.1:14550"]},
        d={"kind": "devices", "device": {"b": {"kind": "nmea0183", "gps": "a", "tcp_port": 10110}}},
    )
    assert (kept["a"].port, kept["a"].udp_port) == (0, 0)
    assert kept["r"].listen == ("tcp/127.0.0.1:0",)
    assert (kept["m"].port, kept["m"].stream_port) == (0, 0)
    assert kept["g"].links == ("tcpin:127.0.0.1:0", "udpout:127.0.0.1:14550")
    assert kept["d"].device["b"].tcp_port == 0
