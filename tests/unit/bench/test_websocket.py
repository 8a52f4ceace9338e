"""The WebSocket of load processes understands a server of the websockets library: short, medium and long messages."""

from __future__ import annotations

import socket
import threading

import pytest
from uwserver_bench.websocket import BINARY, WebSocket
from websockets.sync.server import ServerConnection, serve


def test_messages_of_all_lengths_are_read() -> None:
    def answer(peer: ServerConnection) -> None:
        said = peer.recv()
        for content in (said, bytes(300), bytes(70_000)):
            peer.send(content)
        peer.recv()

    with serve(answer, "127.0.0.1", 0, compression=None) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        port = server.socket.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port), 10.0) as stream:
            client = WebSocket(stream, f"127.0.0.1:{port}", "/live")
            client.send("hello")
            found: list[tuple[int, bytes]] = []
            while len(found) < 3:
                found += client.read()
            client.send("enough")
        server.shutdown()
    assert found[0][1] == b"hello"
    assert [(first == BINARY, len(content)) for first, content in found] == [(False, 5), (True, 300), (True, 70_000)]
    assert client.received == 2 + 5 + 4 + 300 + 10 + 70_000


def test_a_refusal_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as here:
        there, _ = server.accept()
        with there:
            there.sendall(b"HTTP/1.1 403 Forbidden\r\n\r\n")
            with pytest.raises(ValueError, match="403 Forbidden"):
                WebSocket(here, "localhost")
