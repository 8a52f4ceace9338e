"""Autopilots in the loop of a running server: hand-made ones, over the real protocols.

Most share a server: each begins at a reset of the world, as an autopilot that restarts.
"""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from autopilot_server import PATIENCE_S, PRESSURE_50_HZ, SCENARIO, Server, ardusub_scenario, free_port, serving, until
from nursery import python
from uwserver_bench.autopilots.ardupilot_peer import ArduPilotPeer


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with serving(tmp_path_factory.mktemp("shared"), ardusub_scenario()) as running:
        yield running


@pytest.fixture
def server(shared: Server) -> Server:
    shared.call("world/reset")
    return shared


@pytest.fixture
def peer(server: Server) -> Iterator[ArduPilotPeer]:
    with contextlib.closing(ArduPilotPeer(*server.addresses["autopilot"])) as autopilot:
        yield autopilot


def counts(server: Server) -> tuple[int, int, int]:
    """What was no new frame."""
    details = server.stats()["details"]
    return details["duplicates"], details["bad_magic"], details["bad_length"]


def test_a_new_frame_is_exactly_one_tick(server: Server, peer: ArduPilotPeer) -> None:
    before = counts(server)
    for n in range(1, 301):
        state = peer.exchange([1500] * 8)
        assert state["timestamp"][0] == pytest.approx(n / 1200, abs=2e-9)
    assert server.status()["tick"] == 300
    assert counts(server) == before
    peer.send([1500] * 8, 299)  # its answer was lost, it thinks
    again = peer.receive(PATIENCE_S)
    assert again is not None
    assert b'"timestamp":0.250000000' in again
    peer.send_raw(b"garbage")
    peer.send_raw(b"\x1a\x48\0\0")
    until(lambda: counts(server) == tuple(count + 1 for count in before), "garbage was counted")
    assert peer.receive(0.2) is None
    assert server.status()["tick"] == 300
    peer.exchange([1500] * 8)
    assert server.status()["tick"] == 301
    assert (peer.skipped, peer.resets) == (0, 0)


def test_others_see_every_tick_of_the_autopilot(server: Server, peer: ArduPilotPeer) -> None:
    with socket.create_connection(server.addresses["tcp"], timeout=PATIENCE_S) as wire, wire.makefile("r") as lines:
        request = {"id": 1, "method": "subscribe", "params": {"pattern": "rov/truth/pose", "delivery": "reliable"}}
        wire.sendall(json.dumps({"jsonrpc": "2.0", **request}).encode() + b"\n")
        while json.loads(lines.readline()).get("id") != 1:
            pass
        for _ in range(500):
            state = peer.exchange([1700] * 4 + [1500] * 4)
        seen = []
        while len(seen) < 500:
            message = json.loads(lines.readline())
            if message.get("method") == "sample":
                seen.append(message["params"])
        assert [sample["seq"] for sample in seen] == list(range(500))
        assert state["position"] == pytest.approx(seen[-1]["value"]["p_NB"], rel=1e-8, abs=1e-8)


def test_disarmed_is_at_rest_and_driven_moves(server: Server, peer: ArduPilotPeer) -> None:
    for idle in (0, 1500):
        for _ in range(600):
            state = peer.exchange([idle] * 8)
        assert state["position"][:2] == pytest.approx((0.0, 0.0), abs=1e-6)
        assert state["velocity"][:2] == pytest.approx((0.0, 0.0), abs=1e-6)
    for _ in range(1200):
        # Channels 1 and 2 back, 3 and 4 ahead: all four push ahead by the factors of `vectored`.
        state = peer.exchange([1300, 1300, 1700, 1700, 1500, 1500, 1500, 1500])
    assert state["velocity"][0] > 0.2
    assert abs(state["velocity"][1]) < 0.05


@pytest.mark.slow
def test_start_in_any_order_and_restarts_of_both(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    with contextlib.closing(ArduPilotPeer("127.0.0.1", port)) as peer:
        peer.send([1500] * 8)
        assert peer.receive(0.1) is None
        with serving(tmp_path, ardusub_scenario(port)) as server:
            for _ in range(100):
                peer.exchange([1500] * 8)
            with contextlib.closing(ArduPilotPeer("127.0.0.1", port)) as restarted:
                for _ in range(50):
                    restarted.exchange([1500] * 8)
            stats = server.stats()
            assert (stats["details"]["restarts"], server.status()["tick"]) == (1, 150)
            assert stats["peers"] == 1
        with serving(tmp_path, ardusub_scenario(port)) as server:  # and the old autopilot is still there
            for _ in range(100):
                peer.exchange([1500] * 8)
            assert peer.resets == 1
            assert server.status()["tick"] == 100


def test_a_paused_world_holds_the_autopilot_and_goes_on_with_it(server: Server, peer: ArduPilotPeer) -> None:
    peer.exchange([1500] * 8)
    server.call("world/pause")
    peer.send([1500] * 8)
    for _ in range(2):
        assert peer.receive(0.6) is None
        peer.send([1500] * 8)
    server.call("world/resume")
    answer = peer.receive(PATIENCE_S)
    assert answer is not None
    peer.take(answer)
    assert peer.receive(0.3) is None, "one answer, however often it was asked"
    for _ in range(10):
        peer.exchange([1500] * 8)
    assert server.status()["tick"] == 12


def test_a_reset_of_the_world_is_a_reset_of_its_physics_only(server: Server, peer: ArduPilotPeer) -> None:
    for _ in range(100):
        peer.exchange([1500] * 8)
    server.call("world/reset")
    for _ in range(10):
        peer.exchange([1500] * 8)
    assert peer.resets == 1
    assert server.status()["tick"] == 10


@pytest.mark.slow
def test_real_time_is_ours_with_no_time_sync(tmp_path: Path) -> None:
    text = ardusub_scenario(clock="max_speed = 1.0", adapter="no_time_sync = true")
    with serving(tmp_path, text) as server, contextlib.closing(ArduPilotPeer(*server.addresses["autopilot"])) as peer:
        begun = time.monotonic()
        for _ in range(600):
            state = peer.exchange([1500] * 8)
        assert state["no_time_sync"] == (1.0,)
        assert time.monotonic() - begun > 0.45, "half a second of simulation"


@pytest.mark.slow
def test_two_autopilots_step_one_world_together(tmp_path: Path) -> None:
    text = ardusub_scenario(adapter='vehicle = "rov"').replace('["autopilot"]', '["autopilot", "second"]')
    text += """
[vehicles.other]
model = "bluerov2"
position_ned_m = [5, 0, 5]
[vehicles.other.truth]
rate_hz = 1200
[vehicles.other.sensors.imu]
kind = "imu"
rate_hz = 1200
[adapters.second]
kind = "ardupilot_json"
port = 0
truth = true
vehicle = "other"
"""
    with serving(tmp_path, text) as server:
        with (
            contextlib.closing(ArduPilotPeer(*server.addresses["autopilot"])) as first,
            contextlib.closing(ArduPilotPeer(*server.addresses["second"])) as second,
        ):
            for n in range(1, 101):
                first.send([1500] * 8)
                if n == 1:
                    assert first.receive(0.1) is None, "it waits for the other"
                second.send([1500] * 6)
                for peer, north in ((first, 0.0), (second, 5.0)):
                    answer = peer.receive(PATIENCE_S)
                    assert answer is not None
                    state = peer.take(answer)
                    assert state["timestamp"][0] == pytest.approx(n / 1200, abs=2e-9)
                    assert state["position"][0] == pytest.approx(north, abs=1e-3)


@pytest.mark.parametrize(
    ("wrong", "right", "phrase"),
    [
        ('lockstep_clients = ["autopilot"]', 'lockstep_clients = ["me"]', 'lockstep_clients = ["autopilot"]'),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("truth = true\nkind", "truth = false\nkind", "set truth = true"),
                ("[vehicles.rov.truth]\nrate_hz = 1200", "[vehicles.rov.truth]\nrate_hz = 100", "rate_hz = 1200"),
            )
        ),
    ],
)
def test_what_does_not_fit_is_told_at_the_start(tmp_path: Path, wrong: str, right: str, phrase: str) -> None:
    """All that can be wrong is tried in tests/unit/adapters/sil/test_in_the_loop.py; here, that it ends the command."""
    text = ardusub_scenario()
    assert wrong in text
    file = tmp_path / "wrong.toml"
    file.write_text(text.replace(wrong, right))
    done = subprocess.run(
        [python(), "-m", "uwserver", "run", str(file)], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == 1
    assert phrase in done.stderr


def test_px4_hand_made(tmp_path: Path) -> None:
    mavlink = pytest.importorskip("pymavlink.dialects.v20.common", reason="pymavlink is not installed")
    adapter = 'kind = "px4_hil"\nodometry_hz = 50'
    text = SCENARIO.format(rate=1000, imu=250, port=0, depth=5.0, clock="", sensors=PRESSURE_50_HZ, adapter=adapter)
    with (
        serving(tmp_path, text) as server,
        socket.create_connection(server.addresses["autopilot"], timeout=PATIENCE_S) as stream,
    ):
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        server.follow("rov/truth/velocity")
        mav = mavlink.MAVLink(None, 1, 1)
        inbox: list[Any] = []

        def next_sensor() -> Any:
            while True:
                while inbox:
                    message = inbox.pop(0)
                    if message.get_type() == "HIL_SENSOR":
                        return message
                inbox.extend(mav.parse_buffer(stream.recv(65536)) or [])

        stream.sendall(mav.heartbeat_encode(0, 12, 0, 0, 0).pack(mav))
        for _ in range(20):  # time goes on by itself
            sensor = next_sensor()
        controls = [-0.5, -0.5, 0.5, 0.5] + [0.0] * 12
        stream.sendall(mav.hil_actuator_controls_encode(sensor.time_usec, controls, 129, 1).pack(mav))
        until(lambda: server.stats()["details"]["is_locked"], "locked")
        time.sleep(0.1)
        stream.settimeout(0.3)
        with contextlib.suppress(TimeoutError):
            while True:
                sensor = next_sensor()
        stream.settimeout(10)
        tick = server.status()["tick"]
        time.sleep(0.2)
        assert server.status()["tick"] == tick, "it waits"
        for n in range(1, 251):
            stream.sendall(mav.hil_actuator_controls_encode(sensor.time_usec, controls, 129, 1).pack(mav))
            again = next_sensor()
            assert again.time_usec - sensor.time_usec == 4000
            sensor = again
            assert n == 250 or server.process.poll() is None
        assert server.status()["tick"] == tick + 1000
        assert server.last("rov/truth/velocity")["v_NB_B"][0] > 0.2
