"""A server on a zenoh network, seen by plain zenoh sessions, by uwclient, and beside TCP. Loopback and explicit endpoints only."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import uwclient
from nursery import python

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
import zenoh
from zenoh_network import (
    BUS,
    LISTEN,
    PATIENCE_S,
    ROV,
    STILL,
    TCP,
    Server,
    ask,
    ended,
    free_endpoint,
    malformed_key,
    serving,
    session,
    tokens,
    until,
)


@pytest.fixture(scope="module")
def tank(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with serving(tmp_path_factory.mktemp("tank"), ROV + TCP + BUS + LISTEN) as server:
        yield server
        server.end()


@pytest.fixture
def peer(tank: Server) -> Iterator[Any]:
    with session(tank.endpoint) as opened:
        until(lambda: tokens(opened, "uw/uwserver/@alive"), "the server's token")
        yield opened


def test_a_plain_peer_hears_samples_with_encoding_and_attachment(peer):
    samples: list[Any] = []
    peer.declare_subscriber("uw/uwserver/rov/imu", samples.append)
    until(lambda: len(samples) > 50, "samples")
    assert {str(sample.encoding) for sample in samples} == {"application/json"}
    metas = [json.loads(sample.attachment.to_bytes()) for sample in samples]
    assert [meta["seq"] for meta in metas] == list(range(metas[0]["seq"], metas[0]["seq"] + len(metas)))
    assert set(metas[0]) == {"port", "seq", "t_ns", "t_sent_ns", "valid"}
    assert json.loads(samples[0].payload.to_bytes())["f_S"][2] == pytest.approx(-9.8, abs=0.5)


def test_discovery_by_tokens(peer):
    assert tokens(peer, "uw/*/@alive") == {"uw/uwserver/@alive"}
    ports = {"rov/imu", "rov/depth", "rov/pressure", "rov/thrusters", "rov/lights", "rov/camera_tilt"}
    assert tokens(peer, "uw/uwserver/@alive/**") >= {f"uw/uwserver/@alive/{path}" for path in (*ports, "rov")}
    ((kind, description),) = ask(peer, "uw/uwserver/@describe?pattern=rov/*")
    assert kind == "ok"
    assert {port["path"] for port in description["ports"]} == ports


def test_a_late_joiner_gets_the_last_values(peer):
    ((kind, value),) = until(lambda: ask(peer, "uw/uwserver/rov/depth"), "a last value")
    assert kind == "ok"
    assert value["depth"] == pytest.approx(5.0, abs=3.0)
    replies = [reply.ok for reply in peer.get("uw/uwserver/rov/*", timeout=PATIENCE_S)]
    assert {str(reply.key_expr) for reply in replies} == {
        f"uw/uwserver/rov/{name}" for name in ("imu", "depth", "pressure")
    }
    assert all(json.loads(reply.attachment.to_bytes())["t_ns"] > 0 for reply in replies)


def test_services_answer_and_refuse(peer):
    ((kind, status),) = ask(peer, "uw/uwserver/world/status")
    assert kind == "ok"
    assert status["value"]["adapters"]["bus"]["state"] == "running"
    for selector, payload, code in (
        ("world/stepp", None, "unknown_service"),
        ("world/step", b'{"n": 0}', "out_of_range"),
        ("world/step", b'{"m": 1}', "bad_argument"),
        ("world/step", b"{", "parse_error"),
        ("world/step", b"[1]", "invalid_request"),
        ("rov/thrusters", b"", "bad_argument"),
        ("rov/thrusters", b'{"u": [0]}', "bad_shape"),
        ("rov/imu", b'{"f_S": [0, 0, 0]}', "bad_argument"),
        ("world/run_until?timeout_s=0.2", b'{"t_s": 1e6}', "timeout"),
        ("world/run_until?timeout_s=soon", b'{"t_s": 1e6}', "bad_argument"),
    ):
        ((kind, fault),) = ask(peer, f"uw/uwserver/{selector}", payload)
        assert (kind, fault["code"]) == ("err", code), (selector, fault)
        assert fault["message"]
    ((kind, fault),) = ask(peer, "uw/uwserver/rov/thrusters", b"x", encoding="image/png")
    assert (kind, fault["where"]) == ("err", "encoding")


def test_a_put_drives_the_vehicle(peer):
    def depth() -> float:
        return float(ask(peer, "uw/uwserver/rov/depth")[0][1]["depth"])

    before = until(lambda: ask(peer, "uw/uwserver/rov/depth"), "a depth") and depth()

    def put_and_look() -> bool:
        block = zenoh.CongestionControl.BLOCK
        peer.put("uw/uwserver/rov/thrusters", b'{"u": [0, 0, 0, 0, 0.6, 0.6, 0.6, 0.6]}', congestion_control=block)
        return depth() > before + 0.1

    until(put_and_look, "the vehicle dives")


def test_a_refused_put_is_told(peer):
    told: list[tuple[str, Any]] = []
    peer.declare_subscriber(
        "uw/uwserver/@error/**", lambda s: told.append((str(s.key_expr), json.loads(s.payload.to_bytes())))
    )
    cases: list[tuple[str, bytes, dict[str, Any], str]] = [
        ("rov/thrusters", b'{"u": [9, 0, 0, 0, 0, 0, 0, 0]}', {}, "out_of_range"),
        ("rov/thrusters", b'{"u": [0, 0', {}, "parse_error"),
        ("rov/thrusters", b"{}", {"encoding": "image/png"}, "bad_argument"),
        ("rov/thrusters", b"{}", {"attachment": b"\xc1"}, "invalid_request"),
        ("rov/thrusters", b'{"u":"' + b"x" * (1 << 20) + b'"}', {}, "too_large"),
        ("rov/imu", b'{"f_S": [0, 0, 0]}', {}, "bad_argument"),
        ("rov/thruster", b"{}", {}, "unknown_port"),
    ]
    for path, payload, options, code in cases:
        told.clear()

        def put(path: str = path, payload: bytes = payload, options: dict[str, Any] = options) -> list[Any]:
            peer.put(f"uw/uwserver/{path}", payload, congestion_control=zenoh.CongestionControl.BLOCK, **options)
            time.sleep(0.1)
            return told

        assert {fault["code"] for _, fault in until(put, code)} == {code}
    peer.delete("uw/uwserver/rov/thrusters")
    until(lambda: any("deleted" in fault["message"] for _, fault in told), "the refusal of a delete")
    assert ask(peer, "uw/uwserver/world/status")[0][0] == "ok"


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_uwclient_has_the_same_verbs(tank, encoding):
    with tank.client(encoding=encoding, name="pilot") as client:
        assert "rov/imu" in client.ports
        client.subscribe("rov/imu", fields=["w_S"])
        client.subscribe("**", rate_hz=5)
        assert {client.read().port for _ in range(100)} >= {"rov/imu", "rov/depth"}
        assert client.send("rov/thrusters", u=[0.1] * 8).tick > 0
        with pytest.raises(uwclient.CallRefused, match="at most 1"):
            client.send("rov/thrusters", u=[2.0] * 8)
        client.send_nowait("rov/thrusters", u=[2.0] * 8)
        until(lambda: client.latest("rov/imu") and client.refusals, "the refusal of send_nowait")
        client.pause()
        t_ns = client.status()["t_ns"]
        assert client.step(3).t_ns > t_ns
        seen: list[float] = []
        client.call(
            "world/run_until", t_s=client.status()["t_ns"] / 1e9 + 0.5, on_progress=lambda p: seen.append(p.fraction)
        )
        with pytest.raises(uwclient.Timeout):
            client.call("world/run_until", t_s=1e6, timeout=0.3)
        client.resume()
        assert client.wait_until(client.status()["t_ns"] / 1e9 + 0.1) > 0
        assert any(event.event == "paused" for event in client.events)
        for pattern in ("rov/nothing", "rov/thrusters", "rov/i*"):
            with pytest.raises(uwclient.CallRefused):
                client.subscribe(pattern)
        assert client.unsubscribe("**") == 1
    assert seen == sorted(seen)


def test_giving_up_ends_the_call_on_the_server(tank):
    with tank.client() as client:
        client.pause()
        with pytest.raises(uwclient.Timeout):
            client.call("world/run_until", t_s=1e6, timeout=0.2)
        until(lambda: not _moves(client), "the world stands still again")
        client.resume()


def test_a_client_that_goes_takes_its_call_along(tank):
    with tank.tcp_client() as observer:
        observer.pause()
        gone = tank.client()
        gone._link.send(gone._session.request(gone._session.call("world/run_until", {"t_s": 1e6})).data, None)
        until(lambda: _moves(observer), "the call runs")
        gone.close()
        until(lambda: not _moves(observer), "the call ended with its client")
        observer.resume()


def _moves(client: uwclient.Client) -> bool:
    before = client.status()["t_ns"]
    time.sleep(0.1)
    return client.status()["t_ns"] != before


def test_the_command_line_over_zenoh(tank):
    def run(*verb: str) -> subprocess.CompletedProcess[str]:
        command = [python(), "-m", "uwclient", "--zenoh", "--connect", tank.endpoint, *verb]
        return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)

    assert "rov/thrusters" in run("topics").stdout
    assert run("echo", "rov/depth", "-n", "2").stdout.count("depth=") == 2
    assert json.loads(run("call", "world/status").stdout)["server"] == "uwserver"
    wrong = run("--server", "nobody", "--timeout", "1", "topics")
    assert wrong.returncode == 1
    assert "there are: uwserver" in wrong.stderr


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_the_same_story_as_tcp(tmp_path, encoding):
    with serving(tmp_path, ROV + STILL + TCP + BUS + LISTEN + f'encoding = "{encoding}"\n') as server:
        with (
            server.tcp_client() as tcp,
            server.client(encoding=encoding) as bus,
            server.client(encoding="json") as other,
        ):
            for client in (tcp, bus, other):
                client.subscribe("**")
            tcp.send_nowait("rov/thrusters", u=[0.3] * 8)
            tcp.step(120)
            tcp.step(1)  # its reply comes behind all samples of the ticks before
            expected = _story(tcp)
            stories = [expected, _story(bus, len(expected)), _story(other, len(expected))]
        server.end()
    assert len(stories[0]) > 100
    assert stories[0] == stories[1]
    assert stories[0] == stories[2]


def _story(client: uwclient.Client, count: int = 0) -> dict[tuple[str, int], Any]:
    """What was sent in the first 120 ticks: so many samples, or what has come by now."""
    found: dict[tuple[str, int], Any] = {}
    with contextlib.suppress(uwclient.Timeout):
        while not count or len(found) < count:
            sample = client.read(timeout=PATIENCE_S if count else 0.2)
            if sample.t_sent_ns <= 500_000_000:
                found[sample.port, sample.seq] = (sample.t_ns, sample.t_sent_ns, sample.valid, sample.value)
    assert max(t_ns for t_ns, *_ in found.values()) >= 480_000_000
    return found


def test_the_server_is_the_router(tmp_path):
    with serving(tmp_path, ROV + BUS + LISTEN + 'mode = "router"\n') as server:
        with session(server.endpoint, mode="client") as one, session(server.endpoint, mode="client") as two:
            until(lambda: tokens(one, "uw/uwserver/@alive"), "the server's token")
            heard: list[Any] = []
            one.declare_subscriber("talk", heard.append)
            until(lambda: (two.put("talk", b"hello"), heard)[1], "two clients hear each other by the server")
            samples: list[Any] = []
            two.declare_subscriber("uw/uwserver/**", samples.append)
            until(lambda: samples, "samples by the router")
        server.end()


def test_peers_are_counted_once_each_also_in_client_mode_and_behind_a_router(tmp_path):
    def peers(server: Server) -> int:
        with server.tcp_client() as over_tcp:
            return over_tcp.status()["adapters"]["bus"]["peers"]

    with serving(tmp_path, ROV + TCP + BUS + LISTEN + 'mode = "router"\n') as server:
        with server.client(mode="client"), session(server.endpoint, mode="client"), server.client():
            until(lambda: peers(server) == 3, "a named client, a plain one, a peer")
        until(lambda: peers(server) == 0, "all gone")
    endpoint = free_endpoint()
    with session(listen=endpoint, mode="router"):
        behind = f'mode = "client"\nconnect = ["{endpoint}"]\n'
        with serving(tmp_path, ROV + TCP + BUS + behind) as server:
            until(lambda: peers(server) == 1, "the router")
            with uwclient.connect_zenoh("uwserver", [endpoint], mode="client", timeout=PATIENCE_S):
                until(lambda: peers(server) == 2, "the router, and the client behind it by its token")
            until(lambda: peers(server) == 1, "the client gone")


def test_router_restart_and_two_servers_in_one_network(tmp_path):
    endpoint = free_endpoint()
    client_mode = f'mode = "client"\nconnect = ["{endpoint}"]\n'
    with contextlib.ExitStack() as stack:
        router = stack.enter_context(contextlib.ExitStack())
        router.enter_context(session(listen=endpoint, mode="router"))
        alpha = stack.enter_context(serving(tmp_path, ROV + BUS + client_mode + 'server = "alpha"\n'))
        beta = stack.enter_context(serving(tmp_path, ROV + STILL + BUS + client_mode + 'server = "beta"\n'))
        peer = stack.enter_context(session(endpoint, mode="client"))
        until(lambda: tokens(peer, "uw/*/@alive") == {"uw/alpha/@alive", "uw/beta/@alive"}, "both servers")

        samples: list[str] = []
        peer.declare_subscriber("uw/**", lambda sample: samples.append(str(sample.key_expr)))
        until(lambda: samples, "samples of alpha")
        assert ask(peer, "uw/beta/world/status")[0][1]["value"]["t_ns"] == 0
        assert {key.split("/")[1] for key in samples} == {"alpha"}

        third = ended(tmp_path, ROV + BUS + client_mode + 'server = "alpha"\n')
        assert third.returncode == 1
        assert 'another server named "alpha"' in third.stderr

        alive: set[str] = set()
        peer.liveliness().declare_subscriber(
            "uw/*/@alive",
            lambda s: (alive.discard if s.kind == zenoh.SampleKind.DELETE else alive.add)(str(s.key_expr)),
            history=True,
        )
        until(lambda: alive == {"uw/alpha/@alive", "uw/beta/@alive"}, "the subscription is in place")
        beta.end()
        until(lambda: alive == {"uw/alpha/@alive"}, "beta is seen to vanish")

        router.close()
        time.sleep(0.3)
        samples.clear()
        router.enter_context(session(listen=endpoint, mode="router"))
        until(lambda: samples, "samples after the router's restart")
        until(lambda: tokens(peer, "uw/alpha/@alive"), "alpha's token after the router's restart")
        until(lambda: ask(peer, "uw/alpha/world/status"), "calls after the router's restart")
        alpha.end()


def test_uwclient_survives_a_server_restart(tmp_path):
    endpoint = free_endpoint()
    text = ROV + BUS + f'listen = ["{endpoint}"]\n'
    with contextlib.ExitStack() as stack:
        with serving(tmp_path, text) as first:
            client = stack.enter_context(first.client())
            client.subscribe("rov/imu")
            client.read("rov/imu")
        with serving(tmp_path, text) as second:
            until(lambda: _reads(client) and client.reconnects == 1, "samples of the new server")
            second.end()


def _reads(client: uwclient.Client) -> bool:
    with contextlib.suppress(uwclient.UwError):
        return client.read("rov/imu", timeout=2.0).valid
    return False


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ('server = "a/b"\n', "cannot be part of a zenoh key"),
        ('config = {"no/such" = 1}\n', 'zenoh refuses the setting "no/such"'),
        ('config_file = "none.json5"\n', "config_file none.json5"),
        ('listen = ["tcp/192.0.2.1:7447"]\n', "tcp/192.0.2.1:7447"),
    ],
)
def test_a_wrong_table_is_told(tmp_path, table, text):
    done = ended(tmp_path, ROV + BUS + table)
    assert done.returncode == 1
    assert text in done.stderr
    assert "Traceback" not in done.stderr


def test_without_the_package_the_others_still_serve(tmp_path):
    program = (
        "import sys; sys.modules['zenoh'] = None\n"
        "from uwserver.cli import main\n"
        f"main(['run', {str(tmp_path / 'tank.toml')!r}, '--mode', 'freerun', '--until', '0.2'])\n"
    )
    for required, status in (("false", 0), ("true", 1)):
        (tmp_path / "tank.toml").write_text(ROV + TCP + BUS + f"required = {required}\n")
        done = subprocess.run([python(), "-c", program], capture_output=True, text=True, timeout=PATIENCE_S)
        assert done.returncode == status, done.stderr
        assert "pip install uwserver" in done.stderr


def test_the_programs_and_the_command_of_the_guide_run(tmp_path):
    guide = (Path(__file__).parents[2] / "docs" / "how-to" / "zenoh.md").read_text()
    program = re.findall(r"```python\n(.*?)```", guide, re.DOTALL)[0]
    table = re.findall(r"```toml\n(.*?)```", guide, re.DOTALL)[0]
    endpoint = free_endpoint()
    with serving(tmp_path, table.replace("tcp/127.0.0.1:7447", endpoint)) as server:
        text = program.replace("tcp/127.0.0.1:7447", endpoint)
        done = subprocess.run([python(), "-c", text], capture_output=True, text=True, timeout=PATIENCE_S)
        (line,) = re.findall(r"^uwclient (.*)$", guide, re.MULTILINE)
        words = [python(), "-m", "uwclient", *line.replace("tcp/127.0.0.1:7447", endpoint).split()]
        listed = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S)
        sync, later = re.findall(r"^client = (?:await )?(uwclient.*?)  #", guide, re.MULTILINE)
        clients = f"""import asyncio, uwclient
with {sync} as client: print("blocking", len(client.ports))
async def main():
    async with await {later} as client: print("async", len(client.ports))
asyncio.run(main())""".replace("tcp/127.0.0.1:7447", endpoint)
        used = subprocess.run([python(), "-c", clients], capture_output=True, text=True, timeout=PATIENCE_S)
        server.end()
    assert (listed.returncode, listed.stderr) == (0, "")
    assert "rov/depth" in listed.stdout
    assert re.fullmatch(r"blocking [1-9]\d*\nasync [1-9]\d*\n", used.stdout), used.stderr
    assert done.returncode == 0, done.stderr
    depths = re.findall(r'\{"depth":([\d.]+)', done.stdout)
    assert len(depths) > 5
    assert "real_time_factor" in done.stdout


@pytest.mark.slow
def test_the_shipped_scenario_is_on_the_bus(tmp_path):
    import uwserver_scenarios

    shipped = Path(uwserver_scenarios.__path__[0]) / "one_of_everything.toml"
    with serving(
        tmp_path, shipped.read_text().replace("port = 7600", "port = 0") + "[server]\nmetrics = false\n"
    ) as server:
        until(lambda: _describes(server), "the zenoh adapter is up")
        server.end()


def _describes(server: Server) -> bool:
    with server.tcp_client() as client:
        bus = client.status()["adapters"]["bus"]
    return bus["state"] == "running" and bus["address"].startswith("tcp/127.0.0.1:")


def test_a_session_that_a_peer_breaks_is_opened_again(tmp_path):
    """A malformed key makes the library panic for whoever declares one next; from then on it would answer nobody, and look alive."""
    endpoint = free_endpoint()
    with serving(tmp_path, ROV + TCP + BUS + f'listen = ["{endpoint}"]\n') as server, server.tcp_client() as watcher:

        def restarts() -> int:
            return int(watcher.call("world/status")["adapters"]["bus"]["restarts"])

        with server.client() as client:
            client.subscribe("rov/imu")
            client.read("rov/imu")
            with malformed_key(endpoint):
                until(lambda: restarts() == 1, "the adapter is started again")
            until(lambda: watcher.call("world/status")["adapters"]["bus"]["state"] == "running", "it runs")
            with session(endpoint, mode="client") as late:
                until(lambda: tokens(late, "uw/*/@alive"), "a new session is answered")
            client.read("rov/imu")  # who was there before has come back


def test_ros2_over_zenoh_is_opened_again_too(tmp_path):
    endpoint = free_endpoint()
    ros = f'[adapters.ros]\nkind = "ros2"\nlisten = ["{endpoint}"]\n'
    with serving(tmp_path, ROV + TCP + ros) as server, server.tcp_client() as watcher:

        def status() -> dict[str, object]:
            return watcher.call("world/status")["adapters"]["ros"]

        with session(endpoint, mode="client") as early:
            until(lambda: tokens(early, "@ros2_lv/**"), "the node is there")
            with malformed_key(endpoint):
                until(lambda: status()["restarts"] == 1, "the adapter is started again")
            until(lambda: status()["state"] == "running", "it runs")
            until(lambda: tokens(early, "@ros2_lv/**"), "who was there before finds the node again")
            assert "broken" in str(status()["last_error"])
