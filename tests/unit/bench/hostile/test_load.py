"""An attacker that finds nobody, or is sent away, goes on and tells why: a bench ends with a result."""

from __future__ import annotations

import socket
import threading

import pytest
from uwserver_bench.hostile import load
from uwserver_bench.hostile.floods import FLOODS, HELLO

TCP = next(name for name, flood in FLOODS.items() if not flood.is_udp)
UDP = next(name for name, flood in FLOODS.items() if flood.first == HELLO)


def attack(flood: str, port: int) -> dict[str, object]:
    return load.attack({"flood": flood, "address": f"127.0.0.1:{port}", "seconds": 0.5})


def test_nobody_answers_a_hello(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(load, "_GREETINGS", 1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as deaf:
        deaf.bind(("127.0.0.1", 0))
        result = attack(UDP, deaf.getsockname()[1])
    assert (result["bytes"], result["opened"], result["reason"]) == (0, 0, "nobody answered a hello by UDP")


def test_who_is_sent_away_comes_again() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        over = threading.Event()

        def refuse() -> None:
            while not over.is_set():
                server.accept()[0].close()

        thread = threading.Thread(target=refuse, daemon=True)
        thread.start()
        result = attack(TCP, server.getsockname()[1])
        over.set()
        socket.create_connection(server.getsockname()).close()
        thread.join(5)
    assert result["opened"] > 3  # type: ignore[operator]
    assert result["reason"]


def test_nobody_listens() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    result = attack(TCP, port)
    assert result["bytes"] == 0
    assert result["reason"]
