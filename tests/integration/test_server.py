"""The product's main job: a server started by its command, driven over a socket by a client that is no part of it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest
import uwclient
from nursery import python

PATIENCE_S = 60


class Server:
    """`uwserver run` in a process of its own, one of `program` or a fork."""

    def __init__(self, *args: str, env: dict[str, str] | None = None, program: str = "") -> None:
        command = [program or python(), "-m", "uwserver", "run", *args]
        environment = os.environ | (env or {})
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
        )
        self.said = ""
        self.host, self.port = "", 0

    def wait_ready(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.said += line
            if found := re.search(r"tcp: ([\d.]+):(\d+)", line):
                self.host, self.port = found[1], int(found[2])
            if line.startswith("Ctrl-C"):
                return
        raise AssertionError(f"the server ended: {self.process.communicate(timeout=PATIENCE_S)}")

    def connect(self, **options) -> uwclient.Client:
        return uwclient.connect(self.host, self.port, timeout=PATIENCE_S, **options)

    def end(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        if self.process.poll() is None:
            self.process.send_signal(number)
        _, errors = self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode, errors


@contextlib.contextmanager
def serving(*args: str, env: dict[str, str] | None = None, program: str = "") -> Iterator[Server]:
    server = Server(*args, "--port", "0", env=env, program=program)
    try:
        server.wait_ready()
        yield server
    finally:
        if server.process.poll() is None:
            server.process.kill()
        server.process.communicate(timeout=PATIENCE_S)


@pytest.fixture(scope="module")
def pool() -> Iterator[Server]:
    with serving("bluerov2_pool", "--speed", "4") as server:
        yield server


def test_it_says_where_to_connect_and_what_to_type(pool):
    assert f"127.0.0.1:{pool.port}" in pool.said
    assert "uwclient" in pool.said
    assert "bluerov2/thrusters" in pool.said


def test_a_client_drives_the_vehicle_and_reads_its_sensors(pool):
    with pool.connect() as client:
        client.reset()
        client.subscribe("bluerov2/depth", rate_hz=20)
        before = client.read("bluerov2/depth").number("depth")
        for _ in range(30):
            client.send("bluerov2/thrusters", u=[0, 0, 0, 0, 0.6, 0.6, 0.6, 0.6])
            client.read("bluerov2/depth")
        after = client.read("bluerov2/depth").number("depth")
        assert after > before + 0.1


def test_truth_is_not_seen_unless_the_scenario_says_so(pool):
    with pool.connect() as client:
        assert not [port for port in client.ports if "/truth/" in port]
        with pytest.raises(uwclient.CallRefused, match="no port"):
            client.subscribe("bluerov2/truth/pose")


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_both_encodings_say_the_same(pool, encoding):
    with pool.connect(encoding=encoding) as client:
        client.pause()
        try:
            client.reset()
            client.subscribe("**", delivery="reliable")
            client.step(240)
            samples = {(s.port, s.seq): s.value for s in _drain(client)}
        finally:
            client.resume()
    assert len(samples) > 260
    assert samples[("bluerov2/imu", 0)]["f_S"][2] == pytest.approx(-9.82, abs=0.5)


def _drain(client):
    samples = []
    with contextlib.suppress(uwclient.Timeout):
        while True:
            samples.append(client.read(timeout=0.5))
    return samples


def test_the_reply_names_the_tick(pool):
    with pool.connect() as client:
        client.pause()
        client.reset()
        client.step(10)
        ack = client.send("bluerov2/thrusters", u=[0.1] * 8)
        assert ack.tick == 10
        client.resume()


def test_two_commanders_of_one_actuator_are_told(pool):
    with pool.connect(name="one") as one, pool.connect(name="two") as two:
        one.send("bluerov2/thrusters", u=[0.1] * 8)
        ack = two.send("bluerov2/thrusters", u=[-0.1] * 8)
        assert ack.conflict
        assert one.status()["conflicts"] >= 1


def test_services_of_time(pool):
    with pool.connect() as client:
        client.pause()
        client.reset()
        assert client.step(24).tick == 24
        client.call("world/run_until", t_s=1.0)
        assert client.status()["t_ns"] == 10**9
        first = client.call("world/state_hash")
        client.reset()
        client.step(240)
        assert client.call("world/state_hash") == first
        client.resume()


@pytest.mark.parametrize(
    "garbage",
    [
        b"\xff" * 4096,
        b"{" * 100_000,
        b"\x00\x00\x00\x05hello",
        b"\x00\xff\xff\xff\xff",
        b"GET / HTTP/1.1\r\n\r\n",
        b'{"jsonrpc"',
        b"x" * 4096,
    ],
    ids=["bytes", "nesting", "no map", "huge frame", "http", "half", "4096"],
)
def test_bad_input_hurts_only_its_sender(pool, garbage):
    with pool.connect() as client:
        client.subscribe("bluerov2/imu")
        with socket.create_connection((pool.host, pool.port), timeout=PATIENCE_S) as bad:
            bad.sendall(garbage)
            bad.shutdown(socket.SHUT_WR)
            bad.settimeout(PATIENCE_S)
            with contextlib.suppress(ConnectionResetError):
                while bad.recv(65536):
                    pass
        assert client.read("bluerov2/imu", timeout=PATIENCE_S).valid


def test_a_person_with_nc_gets_help(pool):
    with socket.create_connection((pool.host, pool.port), timeout=PATIENCE_S) as person:
        lines = person.makefile("rwb")
        lines.write(b"help\n")
        lines.flush()
        error = json.loads(lines.readline())["error"]
        example = re.search(r"\{.*\}", error["message"])
        assert example, error
        lines.write(example[0].encode() + b"\n")
        lines.flush()
        answer = json.loads(lines.readline())
        assert "error" not in answer
        lines.write(b'{"jsonrpc":"2.0","id":1,"method":"describe"}\n')
        lines.flush()
        ports = {port["path"]: port for port in json.loads(lines.readline())["result"]["ports"]}
        assert ports["bluerov2/imu"]["fields"][0] == {
            "name": "f_S", "unit": "m/s^2", "doc": "specific force at the mount; (0, 0, -g) at rest and level", "frame": "S",
            "shape": [3], "type": "float", "minimum": None, "maximum": None,
        }  # fmt: skip


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_in_order(number):
    with serving("bluerov2_pool", program=sys.executable) as server:
        client = server.connect(reconnect=False)
        client.subscribe("**")
        status, errors = server.end(number)
        assert status == 0
        assert "Traceback" not in errors
        client.close()


def test_shutdown_by_service_and_recording_intact(tmp_path):
    file = tmp_path / "dive.mcap"
    with serving("bluerov2_pool", "--speed", "20", "--record", str(file)) as server:
        with server.connect(reconnect=False) as client:
            client.send("bluerov2/thrusters", u=[0.5] * 8)
            client.wait_until(2.0, timeout=PATIENCE_S)
            client.call("world/shutdown")
        assert server.process.wait(PATIENCE_S) == 0
    replay = subprocess.run(
        [python(), "-m", "uwserver", "replay", str(file)], capture_output=True, text=True, timeout=120
    )
    assert replay.returncode == 0, replay.stdout + replay.stderr


def test_health_and_metrics(tmp_path):
    scenario = tmp_path / "tank.toml"
    scenario.write_text(
        'schema = 1\n[vehicles.rov]\nmodel = "bluerov2_heavy"\nposition_ned_m = [0, 0, 5]\n'
        '[adapters.tcp]\nkind = "sockets"\nport = 0\n[server]\nmetrics_port = 0\n'
    )
    command = [python(), "-m", "uwserver", "run", str(scenario), "--log-json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if found := re.search(r"http://([\d.]+:\d+)/health", line.strip()):
                assert json.loads(line)["level"] == "info"
                break
        else:
            pytest.fail("it did not say where /health is")
        health = json.load(urllib.request.urlopen(f"http://{found[1]}/health", timeout=PATIENCE_S))
        assert health["failure"] == ""
        text = urllib.request.urlopen(f"http://{found[1]}/metrics", timeout=PATIENCE_S).read().decode()
        assert "uwserver_tick_lateness_seconds_bucket" in text
        assert re.search(r'uwserver_adapter_peers\{adapter="tcp"\} 0', text)
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"http://{found[1]}/", timeout=PATIENCE_S)
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0


def test_a_port_in_use_is_told(pool):
    ended = subprocess.run(
        [python(), "-m", "uwserver", "run", "bluerov2_pool", "--port", str(pool.port)],
        capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert ended.returncode == 1
    assert str(pool.port) in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_faulty_scenario_is_told_with_its_place(tmp_path):
    scenario = tmp_path / "tank.toml"
    scenario.write_text('schema = 1\n[world]\nrate_hzz = 240\n[vehicles.rov]\nmodel = "bluerov3"\n')
    ended = subprocess.run(
        [python(), "-m", "uwserver", "run", str(scenario)], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert ended.returncode == 1
    assert 'tank.toml:3:1: world: unknown key "rate_hzz" (did you mean "rate_hz"?)' in ended.stderr
    assert "bluerov2" in ended.stderr


def test_freerun_until_ends_by_itself():
    ended = subprocess.run(
        [python(), "-m", "uwserver", "run", "bluerov2_open_sea", "--port", "0", "--mode", "freerun", "--until", "2"],
        capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr


def test_lockstep_with_two_clients(tmp_path):
    scenario = tmp_path / "tank.toml"
    scenario.write_text(
        'schema = 1\n[world.clock]\nmode = "lockstep"\nlockstep_clients = ["a", "b"]\n'
        '[vehicles.rov]\nmodel = "bluerov2_heavy"\nposition_ned_m = [0, 0, 5]\n[adapters.tcp]\nkind = "sockets"\n[server]\nmetrics = false\n'
    )
    with serving(str(scenario)) as server, server.connect(name="a") as a, server.connect(name="b") as b:
        ticks: list[int] = []
        other = threading.Thread(target=lambda: ticks.append(b.step(10).tick))
        other.start()
        assert a.step(10).tick == 10
        other.join(PATIENCE_S)
        assert ticks == [10]
        with server.connect(name="c") as stranger, pytest.raises(uwclient.CallRefused, match="barrier"):
            stranger.step(1)


def test_it_serves_on_uvloop_too(tmp_path):
    pytest.importorskip("uvloop")
    scenario = tmp_path / "tank.toml"
    scenario.write_text(
        'schema = 1\n[vehicles.rov]\nmodel = "bluerov2_heavy"\nposition_ned_m = [0, 0, 5]\n'
        '[adapters.tcp]\nkind = "sockets"\n[server]\nmetrics = false\nuvloop = true\n'
    )
    with serving(str(scenario)) as server:
        with server.connect(reconnect=False) as client:
            client.subscribe("rov/imu")
            assert client.read("rov/imu").valid
        status, errors = server.end()
        assert status == 0, errors


def test_a_client_by_tls(tmp_path):
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate")
    subprocess.run(
        [
            *("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=127.0.0.1"),
            *("-addext", "subjectAltName=IP:127.0.0.1", "-keyout", "key.pem", "-out", "cert.pem"),
        ],
        cwd=tmp_path, check=True, capture_output=True, timeout=PATIENCE_S,
    )  # fmt: skip
    scenario = tmp_path / "tank.toml"
    scenario.write_text(
        'schema = 1\n[vehicles.rov]\nmodel = "bluerov2_heavy"\nposition_ned_m = [0, 0, 5]\n[server]\nmetrics = false\n'
        f'[adapters.tcp]\nkind = "sockets"\ntls_cert = "{tmp_path}/cert.pem"\ntls_key = "{tmp_path}/key.pem"\n'
    )
    ca = str(tmp_path / "cert.pem")
    with serving(str(scenario)) as server:
        with server.connect(tls=uwclient.tls_context(ca=ca)) as client:
            client.subscribe("rov/imu", delivery="latest")
            assert client.read("rov/imu").valid
            client.pause()
            ack = client.step(24)
            assert client.latest("rov/imu").t_ns <= ack.t_ns
        with pytest.raises(uwclient.ConnectionLost, match="not trusted here"):
            server.connect(tls=uwclient.tls_context())

        async def asked() -> object:
            options = {"host": server.host, "port": server.port, "tls": uwclient.tls_context(ca=ca)}
            async with await uwclient.AsyncClient.connect(**options) as client:
                return await client.status()

        assert asyncio.run(asked())["paused"]
        command = [python(), "-m", "uwclient", "--port", str(server.port), "--ca", ca, "topics"]
        topics = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
        assert "rov/imu" in topics.stdout, topics.stderr
