"""Which adapters of a recording are served: none that opens files or sets the pace, and on this machine alone unless they are asked for by name."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import pytest
from playback_rig import pool

from uwserver.adapter import AdapterTable, installed_adapters
from uwserver.cli.played_adapters import with_played_adapters


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
    return with_played_adapters(with_adapters(**tables), installed_adapters(), port, chosen).scenario.adapters


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
        {"kind": "ros1"},
        {"kind": "devices", "device": {"gps": {"kind": "x", "udp_to": ["192.0.2.1:10110"]}}},
    ],
)
def test_those_that_reach_others_are_left_out(table: dict[str, Any], caplog: pytest.LogCaptureFixture) -> None:
    assert list(served(far=table, near={"kind": "sockets"})) == ["near"]
    assert 'adapter "far" of the recording is left out' in caplog.text


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
    )
    assert (kept["a"].port, kept["a"].udp_port) == (0, 0)
    assert kept["r"].listen == ("tcp/127.0.0.1:0",)
    assert (kept["m"].port, kept["m"].stream_port) == (0, 0)
