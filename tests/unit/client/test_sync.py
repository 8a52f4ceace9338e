"""The blocking client against the fake server."""

from __future__ import annotations

import itertools
import math
import socket
import threading
import time

import pytest
from uwclient import CallRefused, Client, ConnectionLost, Progress, ProtocolError, Timeout
from uwclient_fake_server import SERVICES, THRUSTERS, FakeServer

U = [0.1] * 8


def connected(server: FakeServer, **options: object) -> Client:
    return Client.connect(port=server.port, timeout=60.0, **options)


def wait_for(condition: object) -> None:
    deadline = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@pytest.mark.parametrize("piece", [0, 1])
def test_drive_and_read(server: FakeServer, encoding: str, piece: int) -> None:
    server.piece = piece
    with connected(server, encoding=encoding, name="pilot") as client:
        assert set(client.ports) == {"rov/imu", "rov/depth", "rov/thrusters"}
        assert "world/status" in client.services
        subscription = client.subscribe("rov/*", rate_hz=10, fields=["f_S", "depth"], delivery="latest")
        assert subscription.ports == ("rov/imu", "rov/depth")
        assert [client.read().port for _ in range(2)] == ["rov/imu", "rov/depth"]
        assert [client.read("rov/depth").seq for _ in range(4)] == [1, 2, 4, 5]
        assert client.read("rov/imu").vector("f_S")[0] == pytest.approx(0.1)
        ack = client.send("rov/thrusters", u=U)
        assert (ack.tick, ack.t_ns, ack.conflict) == (100, 400_000_000, False)
    assert server.told("hello") == [{"version": 1, "name": "pilot"}]
    assert server.told("subscribe") == [
        {"pattern": "rov/*", "rate_hz": 10, "fields": ["f_S", "depth"], "delivery": "latest"}
    ]
    assert server.told("command") == [{"port": "rov/thrusters", "value": {"u": U}}]


def test_iteration_latest_and_unsubscribe(server: FakeServer) -> None:
    with connected(server) as client:
        client.subscribe("rov/imu")
        assert [sample.seq for sample in itertools.islice(client, 4)] == [0, 1, 2, 4]
        assert client.read().seq == 5
        latest = client.latest("rov/imu")
        assert latest is not None
        assert latest.seq == 5
        assert client.latest("rov/depth") is None
        server.sample("rov/imu", 77)
        wait_for(lambda: client.latest("rov/imu").seq == 77)
        assert client.unsubscribe("rov/imu") == 1
        assert client.read().seq == 77
        with pytest.raises(CallRefused, match="nothing is subscribed"):
            client.read()


def test_read_of_an_unsubscribed_port_and_without_samples(server: FakeServer) -> None:
    server.samples = 0
    with connected(server) as client:
        client.subscribe("rov/imu")
        with pytest.raises(CallRefused, match="rov/depth"):
            client.read("rov/depth")
        with pytest.raises(Timeout, match=r"no sample of rov/imu within 0\.05 s"):
            client.read("rov/imu", timeout=0.05)


def test_what_is_not_read_is_bounded_and_counted(server: FakeServer) -> None:
    server.samples = 4100
    with connected(server) as client:
        client.subscribe("rov/depth")
        wait_for(lambda: client.latest("rov/depth") and client.latest("rov/depth").seq == 4100)
        assert client.dropped == 4
        assert client.read().seq == 5


def test_refusals_name_code_and_place(server: FakeServer) -> None:
    with connected(server) as client:
        with pytest.raises(CallRefused) as caught:
            client.send("rov/thrusters", u=[2.0] * 8)
        assert (caught.value.code, caught.value.where) == ("out_of_range", "u")
        with pytest.raises(CallRefused, match="unknown_port: rov/nothing"):
            client.subscribe("rov/nothing")
        with pytest.raises(CallRefused, match="unknown_service"):
            client.call("rov/fly")
        commands = server.methods().count("command")
        with pytest.raises(CallRefused, match="a list of 8 float"):
            client.send("rov/thrusters", u=[0.0])
        with pytest.raises(CallRefused, match="finite"):
            client.send_nowait("rov/thrusters", u=[math.nan] * 8)
        assert server.methods().count("command") == commands


def test_send_nowait_tells_failures_later(server: FakeServer) -> None:
    with connected(server) as client:
        client.send_nowait("rov/thrusters", {"u": U})
        client.send_nowait("rov/thrusters", u=[3.0] * 8)
        client.status()
        assert [refusal.code for refusal in client.refusals] == ["out_of_range"]
    commands = [request for request in server.requests if request["method"] == "command"]
    assert len(commands) == 2
    assert all("id" not in request for request in commands)


@pytest.mark.parametrize("value", [0, False, None, [], "", {"a": [1]}])
def test_call_returns_the_value_itself(server: FakeServer, value: object) -> None:
    with connected(server) as client:
        assert client.call("echo", x=value, timeout=60) == {"x": value}
        assert client.call("echo", {"timeout": 3, "service": "s", "args": 1}) == {
            "timeout": 3,
            "service": "s",
            "args": 1,
        }


def test_world_verbs(server: FakeServer) -> None:
    with connected(server) as client:
        assert client.pause().tick == 100
        status = client.status()
        assert (status["paused"], status["tick"], status["t_ns"]) == (True, 100, 400_000_000)
        assert client.step().tick == 101
        assert client.step(9).tick == 110
        assert client.wait_until(1.0, timeout=60) == pytest.approx(1.0)
        assert server.told("call")[-2] == {"service": "world/run_until", "args": {"t": 1.0}}
        client.resume()
        client.reset()
        assert client.wait_until(1.2, timeout=60) >= 1.2
        assert client.wait_until(0.5, timeout=60) >= 1.2
        with pytest.raises(Timeout, match="did not reach"):
            client.wait_until(1e6, timeout=0.05)


def test_progress_and_cancel_from_its_callback(server: FakeServer) -> None:
    seen: list[Progress] = []
    with connected(server) as client:

        def on_progress(progress: Progress) -> None:
            seen.append(progress)
            if progress.fraction == 0.5:
                assert client.cancel(progress.id) is True

        with pytest.raises(CallRefused) as caught:
            client.call("rov/goto", on_progress=on_progress)
        assert caught.value.code == "preempted"
        assert [progress.fraction for progress in seen] == [0.25, 0.5]
        assert client.cancel(seen[0].id) is False


def test_giving_up_a_call_cancels_it(server: FakeServer) -> None:
    with connected(server) as client:
        with pytest.raises(Timeout, match="the call of rov/goto"):
            client.call("rov/goto", timeout=0.1)
        client.status()
        (cancelled,) = server.told("cancel")
        goto = next(request for request in server.requests if request.get("params", {}).get("service") == "rov/goto")
        assert cancelled == {"id": goto["id"]}
        assert not server.peers[0].unfinished


def test_an_error_in_the_progress_callback_reaches_the_caller(server: FakeServer) -> None:
    def fail(progress: Progress) -> None:
        raise KeyError(progress.fraction)

    with connected(server) as client:
        with pytest.raises(KeyError):
            client.call("rov/goto", on_progress=fail)
        assert client.status()["paused"] is False
        assert len(server.told("cancel")) == 1


def test_a_late_command_says_what_a_paused_world_needs(server: FakeServer) -> None:
    with connected(server) as client:
        server.silent.add("command")
        client._timeout = 0.1
        with pytest.raises(Timeout, match="no answer within"):
            client.send("rov/thrusters", u=U)


def test_events_arrive_and_new_ports_are_learned(server: FakeServer) -> None:
    with connected(server) as client:
        lamp = {
            **THRUSTERS,
            "path": "rov/lamp",
            "fields": [{"name": "u", "type": "float", "shape": [1], "unit": "1", "frame": "", "doc": ""}],
        }
        server.ports = [lamp]
        server.notify("event", {"event": "ports_changed", "tick": 1, "t_ns": 2, "text": "spawned"})
        wait_for(lambda: client.latest("x") or client.events)
        assert client.events[0].event == "ports_changed"
        client.send("rov/lamp", u=[0.5])
        assert set(client.ports) == {"rov/lamp"}


def test_reconnects_and_subscribes_again(server: FakeServer) -> None:
    with connected(server, name="pilot") as client:
        client.subscribe("rov/imu", rate_hz=5)
        for _ in range(5):
            client.read()
        server.drop()
        assert client.read(timeout=60).seq == 0
        assert client.reconnects == 1
        assert server.told("hello") == [{"version": 1, "name": "pilot"}] * 2
        assert server.told("subscribe") == [{"pattern": "rov/imu", "rate_hz": 5}] * 2
        server.drop()
        wait_for(lambda: not server.peers)
        assert client.send("rov/thrusters", u=U).tick == 100
        assert client.reconnects == 2


def test_survives_a_restart_of_the_server(server: FakeServer) -> None:
    with connected(server) as client:
        client.subscribe("rov/imu")
        before = [client.read(timeout=60).seq for _ in range(server.samples)]
        server.stop()
        starter = threading.Timer(0.3, lambda: servers.append(FakeServer(server.port)))
        servers: list[FakeServer] = []
        starter.start()
        try:
            assert [client.read(timeout=60).seq for _ in before] == before
            assert client.reconnects == 1
        finally:
            starter.join()
            servers[0].stop()


@pytest.mark.parametrize(
    ("method", "act", "phrase"),
    [
        ("command", lambda client: client.send("rov/thrusters", u=U), "may or may not have been applied"),
        ("step", lambda client: client.step(), "may or may not have been applied"),
        ("call", lambda client: client.call("rov/goto"), "may or may not have been applied"),
        ("call", lambda client: client.call("world/status"), "changes nothing"),
        ("describe", lambda client: client.describe(), "changes nothing"),
    ],
)
def test_a_request_in_flight_at_the_loss_says_what_became_of_it(
    server: FakeServer, method: str, act: object, phrase: str
) -> None:
    with connected(server) as client:
        server.vanish_on.add(method)
        with pytest.raises(ConnectionLost, match=phrase):
            act(client)
        server.vanish_on.clear()
        assert client.step().tick > 0
        assert client.reconnects == 1


def test_a_subscription_lost_by_a_reconnection_is_told_once(server: FakeServer) -> None:
    with connected(server) as client:
        client.subscribe("rov/imu")
        server.refuse_patterns.add("rov/imu")
        server.drop()
        wait_for(lambda: not server.peers)
        with pytest.raises(CallRefused, match="after the reconnection"):
            client.status()
        assert client.status()["paused"] is False


def test_without_reconnect_and_after_close(server: FakeServer) -> None:
    client = connected(server, reconnect=False)
    server.drop()
    wait_for(lambda: not server.peers)
    with pytest.raises(ConnectionLost, match="reconnect is off; nothing was sent"):
        client.send("rov/thrusters", u=U)
    client.close()
    with pytest.raises(ConnectionLost, match="the client is closed"):
        client.status()
    assert list(client) == []


def test_no_server_says_what_to_do(unused_port: int) -> None:
    with pytest.raises(ConnectionLost) as caught:
        Client.connect(port=unused_port, timeout=0.25)
    assert caught.value.code == "unreachable"
    for phrase in ("`uwserver run`", f"127.0.0.1:{unused_port}", "--port", "0.25 s"):
        assert phrase in str(caught.value)


def test_server_that_appears_late(unused_port: int) -> None:
    servers: list[FakeServer] = []
    starter = threading.Timer(0.25, lambda: servers.append(FakeServer(unused_port)))
    starter.start()
    try:
        with Client.connect(port=unused_port, timeout=60.0) as client:
            assert "rov/imu" in client.ports
            assert client.reconnects == 0
    finally:
        starter.join()
        servers[0].stop()


def test_a_server_that_never_answers_is_left_in_time(server: FakeServer) -> None:
    server.silent.add("hello")
    with pytest.raises(ConnectionLost, match="hello"):
        Client.connect(port=server.port, timeout=1.0)


def test_something_else_answers() -> None:
    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            connection.sendall(b"220 mail ready\r\n")
            connection.recv(1000)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(ProtocolError, match="220 mail ready"):
            Client.connect(port=listener.getsockname()[1], timeout=60)
        thread.join(60)


def test_token_by_argument_and_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    with FakeServer(token="secret") as server:
        with pytest.raises(CallRefused, match="token") as caught:
            connected(server)
        assert caught.value.code == "denied"
        assert connected(server, token="secret").close() is None
        monkeypatch.setenv("UWSERVER_TOKEN", "secret")
        client = connected(server)
        assert "secret" not in repr(client._session.settings)
        client.close()
        with pytest.raises(CallRefused):
            connected(server, token="wrong")


def test_fake_services_are_those_described(server: FakeServer) -> None:
    with connected(server) as client:
        assert set(client.services) == {service["path"] for service in SERVICES}
        assert client.describe("rov/imu").ports.keys() == {"rov/imu"}
        assert len(client.ports) == 3
