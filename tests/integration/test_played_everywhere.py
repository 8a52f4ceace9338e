"""A recording is served over all adapters: each middleware tells what was recorded, and pictures come by RTSP."""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import json
import re
import signal
import struct
import subprocess
import time
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest
import uwclient
from mcap.reader import make_reader
from middlewares import CLIENTS, IMU, POSE, SINGLE, Numbers, moment
from nursery import python

PATIENCE_S = 60.0
END_S = 4.0
EPOCH_S = datetime(2026, 1, 1, tzinfo=timezone.utc).timestamp()
SCENARIO = """
schema = 1
title = "one is recorded"
seed = 4
[world]
rate_hz = 240
[world.clock]
mode = "freerun"
[seabed]
kind = "flat"
depth_m = 8
[vehicles.one]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 2.0]
truth = { rate_hz = 20.0 }
[vehicles.one.sensors.eye]
kind = "camera"
width = 64
height = 48
rate_hz = 5
[vehicles.one.sensors.down]
kind = "altimeter"
rate_hz = 10
[adapters.tcp]
kind = "sockets"
port = 0
truth = true
[adapters.video]
kind = "video"
codec = "jpeg"
rtsp_port = 0
[adapters.devices]
kind = "devices"
device.bridge = { kind = "nmea0183", altimeter = "one/down", tcp_port = 0 }
[adapters.gcs]
kind = "mavlink"
links = ["tcpin:127.0.0.1:0", "udpout:127.0.0.1:14550"]
[adapters.moos]
kind = "moos"
[adapters.px4]
kind = "px4_hil"
[adapters.rosbridge]
kind = "rosbridge"
port = 0
truth = true
[adapters.ros2]
kind = "ros2"
domain = 0
listen = ["tcp/127.0.0.1:0"]
truth = true
[adapters.ros1]
kind = "ros1"
truth = true
[adapters.morse]
kind = "morse"
port = 0
stream_port = 0
truth = true
[adapters.yarp]
kind = "yarp"
ports = ["one/imu", "one/truth/pose", "one/thrusters"]
truth = true
[adapters.player]
kind = "player"
port = 0
truth = true
pose = "truth"
"""


def missing(name: str) -> list[str]:
    return [module for module in CLIENTS[name][1] if importlib.util.find_spec(module) is None]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seconds of a dive, by the command."""
    folder = tmp_path_factory.mktemp("recording")
    (folder / "dive.toml").write_text(SCENARIO)
    command = [python(), "-m", "uwserver", "run", str(folder / "dive.toml"), "--port", "0"]
    command += ["--until", str(END_S), "--record", str(folder / "run.mcap"), "--log-level", "error"]
    subprocess.run(command, check=True, timeout=PATIENCE_S, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return folder / "run.mcap"


@contextlib.contextmanager
def playing(path: Path, *options: str) -> Iterator[tuple[uwclient.Client, dict[str, Any]]]:
    """`uwserver play` without a word about its adapters: a client, and the state of these."""
    command = [python(), "-m", "uwserver", "play", str(path), "--port", "0", "--log-level", "error", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            said = "".join(itertools.takewhile(lambda line: not line.startswith("Ctrl-C"), process.stdout))
            port = re.search(r"tcp: 127\.0\.0\.1:(\d+)", said)
            assert port is not None, said
            with uwclient.connect(port=int(port[1])) as client:
                yield client, client.call("world/status")["adapters"]
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()


@pytest.fixture(scope="module")
def paused(recording: Path) -> Iterator[tuple[uwclient.Client, dict[str, Any]]]:
    """It is played for the tests below as far as they say."""
    with playing(recording, "--paused", "--speed", "max") as player:
        yield player


def recorded(path: Path) -> dict[str, dict[int, Numbers]]:
    """Moment -> numbers of the two ports that the clients hear."""
    found: dict[str, dict[int, Numbers]] = {IMU: {}, POSE: {}}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(topics=[IMU, POSE]):
            said = json.loads(message.data)
            fields = ("f_S", "w_S") if channel.topic == IMU else ("p_NB", "q_NB")
            numbers = tuple(number for field in fields for number in said["value"][field])
            found[channel.topic][moment(said["t_ns"] / 1e9)] = numbers
    return found


def test_all_that_make_sense_are_served_and_autopilots_in_the_loop_are_not(
    paused: tuple[uwclient.Client, dict[str, Any]],
) -> None:
    _, adapters = paused
    assert adapters.keys() >= {"tcp", "video", "devices", "gcs", "moos", "morse", "yarp", "player"}
    assert "px4" not in adapters
    states = {name: adapter["state"] for name, adapter in adapters.items()}
    assert set(states.values()) == {"running"}, states


def test_each_middleware_tells_what_was_recorded(
    recording: Path, paused: tuple[uwclient.Client, dict[str, Any]]
) -> None:
    there = recorded(recording)
    names = [name for name in CLIENTS if not missing(name)]
    single = struct.Struct("<6f")
    player, adapters = paused
    with contextlib.ExitStack() as stack:
        clients = {name: stack.enter_context(contextlib.closing(CLIENTS[name][0](adapters, EPOCH_S))) for name in names}
        for client in clients.values():
            client.again = True
        for k in range(1, 21):  # zenoh tells a publisher a little later that somebody subscribes
            player.call("world/run_until", t_s=0.05 * k)
            for client in clients.values():
                client.pump(0.05)
            if all(client.count() for client in clients.values()):
                break
        player.call("world/run_until", t_s=END_S - 0.5)
        for name, client in clients.items():
            end = time.monotonic() + PATIENCE_S
            while min(map(len, client.told.values())) < 30 and time.monotonic() < end:
                client.pump(0.1)
            assert min(map(len, client.told.values())) >= 30, name
            for moment_, numbers in client.told[IMU].items():
                made = there[IMU][moment_]
                assert numbers == (single.unpack(single.pack(*made)) if name in SINGLE else made), name
            for moment_, numbers in client.told[POSE].items():
                assert numbers[:3] == there[POSE][moment_][:3], name
    with pytest.raises(uwclient.CallRefused, match="playback"):
        player.send("one/thrusters", u=[0.0] * 8)


@pytest.mark.slow
def test_pictures_come_by_rtsp(recording: Path) -> None:
    av = pytest.importorskip("av", reason="PyAV is not installed")
    with playing(recording, "--loop") as (_, adapters):
        url = adapters["video"]["address"] + "one/eye"
        with av.open(url, options={"rtsp_transport": "tcp", "timeout": "20000000"}, timeout=30) as container:
            frame = next(container.decode(video=0))
            assert (frame.width, frame.height) == (64, 48)
