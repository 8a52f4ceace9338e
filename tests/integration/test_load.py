"""Many clients, slow ones, stopped ones, killed ones, and samples of a megabyte: nothing that matters is lost, and losses are counted.

What is judged here is behaviour; `uwserver bench net` measures the same situations against the clock.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from uwserver_bench.net.net_processes import HAS_ZENOH, WIRE_ADDRESS, Router, Traced, free_endpoint, tracing
from uwserver_bench.net.wires import Peer, ask, connect
from uwserver_bench.processes import loading
from uwserver_bench.server import STATUS

PATIENCE_S = 30.0
LOAD = "uwserver_bench.net.net_load"
ZENOH = pytest.param(
    "zenoh",
    marks=pytest.mark.skipif(not HAS_ZENOH, reason="eclipse-zenoh is not installed"),
)
MEGABYTE_VALUES = 1 << 17


def status(traced: Traced) -> dict[str, Any]:
    value: dict[str, Any] = traced.served.ask(STATUS)["value"]
    return value


def eventually(true: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < end, f"in vain: {what}"
        time.sleep(0.05)


def peer_of(traced: Traced, wire: str) -> Peer:
    return connect(wire, traced.addresses[WIRE_ADDRESS[wire]])


def next_sample(peer: Peer) -> dict[str, Any]:
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        for message in peer.receive(0.1):
            if message.body.get("method") == "sample":
                params: dict[str, Any] = message.body["params"]
                return params
    raise AssertionError("no sample came")


def counted(traced: Traced, adapter: str, what: str) -> int:
    """One of an adapter's numbers in world/status."""
    return int(status(traced)["adapters"][adapter][what])


@pytest.fixture(scope="module")
def traced():
    """Some of its samples have a megabyte: a buffer on the way holds few of them."""
    with tracing(megabyte=True) as server:
        yield server


@pytest.mark.parametrize(
    ("wire", "clients", "pattern"),
    [
        ("TCP JSON", 1, "rov/truth/**"),
        ("TCP msgpack", 10, "rov/truth/**"),
        ("TCP msgpack", 50, "rov/depth"),
        ("WebSocket", 10, "rov/truth/**"),
        pytest.param("zenoh", 10, "rov/truth/**", marks=ZENOH.marks),
    ],
)
def test_every_command_and_call_gets_exactly_one_reply(traced, wire, clients, pattern):
    """While every client takes samples, too."""
    each = 20
    with contextlib.ExitStack() as stack:
        peers = [stack.enter_context(contextlib.closing(peer_of(traced, wire))) for _ in range(clients)]
        for peer in peers:
            ask(peer, "subscribe", pattern=pattern)
        for identity in range(1, each + 1):
            for peer in peers:
                if identity % 2:
                    peer.send("command", {"port": "rov/thrusters", "value": {"u": [0.1] * 8}}, identity)
                else:
                    peer.send("call", {"service": "world/faults"}, identity)
        replies: list[Counter[int]] = [Counter() for _ in peers]
        refused: list[object] = []

        def listen() -> bool:
            for peer, count in zip(peers, replies, strict=True):
                for message in peer.receive(0.005):
                    if "id" in message.body:
                        count[message.body["id"]] += 1
                        refused.extend(message.body.get("error", ()))
            return all(len(count) == each for count in replies)

        eventually(listen, "a reply to every request")
        for _ in range(3):
            listen()
    assert not refused
    assert all(set(count.values()) == {1} for count in replies)


@pytest.mark.slow
def test_a_reader_that_never_reads_loses_samples_and_the_others_none():
    """The world runs free, so that the kernel's buffers are soon full."""
    with tracing("freerun") as server, contextlib.ExitStack() as stack:
        host, _, port = server.addresses["tcp"].rpartition(":")
        for _ in range(3):
            silent = stack.enter_context(socket.create_connection((host, int(port)), timeout=PATIENCE_S))
            silent.sendall(b'{"jsonrpc":"2.0","id":0,"method":"subscribe","params":{"pattern":"**"}}\n')
        active = stack.enter_context(contextlib.closing(peer_of(server, "TCP msgpack")))
        ask(active, "subscribe", pattern="rov/depth", delivery="reliable")
        seqs: list[int] = []

        def listen() -> bool:
            for message in active.receive(0.05):
                if message.body.get("method") == "sample":
                    seqs.append(message.body["params"]["seq"])
            return len(seqs) > 100 and len(seqs) % 7 == 0 and status(server)["adapters"]["tcp"]["dropped"] > 0

        eventually(listen, "drops counted in world/status")
        assert seqs == list(range(seqs[0], seqs[0] + len(seqs)))
        ask(active, "command", port="rov/thrusters", value={"u": [0.2] * 8})


def test_a_stopped_reader_goes_on_where_it_can_and_its_losses_are_counted(traced):
    before, dropped = counted(traced, "tcp", "samples_sent"), counted(traced, "tcp", "dropped")
    with loading(LOAD) as load:
        load.begin("flow", **traced.place("TCP msgpack"), pattern="rov/megabyte", clients=2, seconds=4.0)
        eventually(lambda: counted(traced, "tcp", "samples_sent") > before + 4, "a flow of samples")
        os.kill(load.pid, signal.SIGSTOP)
        try:
            eventually(lambda: counted(traced, "tcp", "dropped") > dropped, "drops counted in world/status")
            with contextlib.closing(peer_of(traced, "TCP JSON")) as other:
                for _ in range(20):
                    ask(other, "command", port="rov/thrusters", value={"u": [0.2] * 8})
        finally:
            os.kill(load.pid, signal.SIGCONT)
        assert load.result()["count"] > 0


READS_ALL_OVER_ZENOH = """
import sys, uwclient
client = uwclient.connect_zenoh("uwserver", [sys.argv[1]], encoding="msgpack")
client.subscribe("rov/megabyte")
for sample in client:
    print(sample.seq, flush=True)
"""


@pytest.mark.skipif(not HAS_ZENOH, reason="eclipse-zenoh is not installed")
def test_what_zenoh_drops_for_a_stopped_client_is_told_by_the_client_and_counted(traced):
    """zenoh tells no publisher what it drops, so the client that misses it does."""
    dropped = counted(traced, "zenoh", "dropped")
    command = [sys.executable, "-c", READS_ALL_OVER_ZENOH, traced.addresses["zenoh"]]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as reader:
        try:
            assert reader.stdout is not None
            assert reader.stdout.readline()
            os.kill(reader.pid, signal.SIGSTOP)
            enough = counted(traced, "zenoh", "samples_sent") + 30  # megabytes: more than all buffers on the way
            eventually(
                lambda: counted(traced, "zenoh", "samples_sent") > enough, "samples for a reader that is stopped"
            )
            os.kill(reader.pid, signal.SIGCONT)
            eventually(lambda: counted(traced, "zenoh", "dropped") > dropped, "drops in world/status")
        finally:
            reader.kill()


@pytest.mark.parametrize("wire", ["TCP msgpack", pytest.param("WebSocket", marks=pytest.mark.slow), ZENOH])
def test_killed_clients_are_forgotten_and_new_ones_served(traced, wire):
    adapter = "zenoh" if wire == "zenoh" else "tcp"
    peers = lambda: status(traced)["adapters"][adapter]["peers"]  # noqa: E731
    # A connection that asks for the status is one of the sockets' peers itself.
    asking = int(adapter == "tcp")
    eventually(lambda: peers() == asking, "nobody there before")
    with loading(LOAD) as load:
        load.begin("flow", **traced.place(wire), pattern="rov/imu", clients=5, seconds=PATIENCE_S)
        eventually(lambda: peers() == 5 + asking, "five clients in world/status")
        os.kill(load.pid, signal.SIGKILL)
        eventually(lambda: peers() == asking, "killed clients gone from world/status")
    with contextlib.closing(peer_of(traced, wire)) as successor:
        ask(successor, "subscribe", pattern="rov/imu")
        assert next_sample(successor)["port"] == "rov/imu"


@pytest.mark.slow
@pytest.mark.parametrize("wire", [ZENOH])
def test_a_router_that_was_killed_and_comes_back_serves_the_same_client(wire):
    endpoint = free_endpoint()
    router = Router(endpoint)
    try:
        with tracing(router=endpoint) as server, contextlib.closing(connect(wire, endpoint)) as peer:
            ask(peer, "subscribe", pattern="rov/imu")
            before = next_sample(peer)["t_ns"]
            router.kill()
            eventually(lambda: not peer.receive(0.5), "silence without the router")
            alone = status(server)["t_ns"]
            assert alone > before
            router = Router(endpoint)
            assert next_sample(peer)["t_ns"] >= alone
            ask(peer, "command", port="rov/thrusters", value={"u": [0.2] * 8})
    finally:
        router.kill()


@pytest.mark.parametrize("wire", ["TCP JSON", "TCP msgpack", "WebSocket", ZENOH])
def test_samples_of_a_megabyte_come_whole_and_hold_up_no_command(traced, wire):
    with contextlib.closing(peer_of(traced, wire)) as peer:
        ask(peer, "subscribe", pattern="rov/megabyte")
        for _ in range(5):
            image = next_sample(peer)["value"]["image"]
            assert len(image) == MEGABYTE_VALUES
            assert image[-1] == (MEGABYTE_VALUES - 1) / 7.0
            ask(peer, "command", port="rov/thrusters", value={"u": [0.1] * 8})


def test_a_sample_too_large_for_a_datagram_is_told_and_counted(traced):
    dropped = counted(traced, "tcp", "dropped")
    with contextlib.closing(peer_of(traced, "UDP")) as peer:
        ask(peer, "subscribe", pattern="rov/megabyte")
        errors: list[str] = []

        def listen() -> bool:
            errors.extend(m.body["error"]["data"]["code"] for m in peer.receive(0.1) if "error" in m.body)
            return bool(errors)

        eventually(listen, "the refusal of a sample that is too large")
        assert errors == ["too_large"]
        assert counted(traced, "tcp", "dropped") > dropped
