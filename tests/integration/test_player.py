"""The how-to of Player: by hand; and with Player's own library, where `UWSERVER_PLAYERC` names its libplayerc.so."""

from __future__ import annotations

import ctypes
import json
import math
import os
import re
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from nursery import python
from uwserver_bench.processes import Served, serving

ROOT = Path(__file__).parents[2]
LIBRARY = os.environ.get("UWSERVER_PLAYERC", "")
PATIENCE_S = 60
SOCKETS = '[adapters.tcp]\nkind = "sockets"\nport = 0\n[server]\nweb = false\nmetrics = false\n'


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    (found,) = re.findall(r"```toml\n(.*?)```", (ROOT / "docs/how-to/player.md").read_text(), re.DOTALL)
    file = tmp_path_factory.mktemp("player") / "sea.toml"
    file.write_text(found.replace('kind = "player"\n', 'kind = "player"\nport = 0\n') + SOCKETS)
    with serving(file, python=python()) as server:
        yield server


@pytest.fixture(scope="module")
def port(served: Served) -> int:
    status = served.ask('{"id":1,"method":"call","params":{"service":"world/status"}}')
    return int(status["value"]["adapters"]["player"]["address"].rpartition(":")[2])


class Client:
    """A client that knows bytes alone."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        self._stream = self._socket.makefile("rb")
        assert self._stream.read(32).startswith(b"Player v.3")

    def hear(self) -> tuple[list[int], bytes]:
        """Interface, number, type and subtype; body."""
        *head, _, _, size = struct.unpack(">6IdII", self._stream.read(40))
        return head[2:], self._stream.read(size)

    def send(self, interface: int, number: int, kind: int, subtype: int, body: bytes = b"") -> None:
        self._socket.sendall(struct.pack(">6IdII", 0, 0, interface, number, kind, subtype, 0.0, 1, len(body)) + body)

    def ask(self, interface: int, number: int, subtype: int, body: bytes = b"") -> bytes:
        self.send(interface, number, 3, subtype, body)
        while True:
            head, said = self.hear()
            if head == [interface, number, 4, subtype]:
                return said
            assert head[2] == 1, (head, said)

    def open(self, interface: int, number: int) -> None:
        self.ask(1, 0, 3, struct.pack(">7I", 0, 0, interface, number, 1, 0, 0))

    def close(self) -> None:
        self._stream.close()
        self._socket.close()


def octets(data: bytes) -> bytes:
    return struct.pack(">II", len(data), len(data)) + data + b"\0" * (-len(data) % 4)


def test_the_page_by_hand(port: int) -> None:
    client = Client(port)
    said = client.ask(1, 0, 1)
    numbers = struct.unpack(f">{len(said) // 4}I", said)
    addresses = [(numbers[k + 2], numbers[k + 3]) for k in range(2, len(numbers), 4)]
    assert addresses[:3] == [(30, 0), (60, 0), (62, 0)]
    services = addresses[-1]
    client.open(*services)
    call = octets(b'{"service": "world/pause", "args": {}}')
    assert json.loads(client.ask(*services, 1, call)[8:].rstrip(b"\0")) == {"result": None}
    client.open(30, 0)
    client.open(60, 0)
    step = octets(b'{"service": "world/step", "args": {"n": 24}}')
    client.send(*services, 3, 1, step)
    heard: dict[int, bytes] = {}
    while len(heard) < 3:
        head, body = client.hear()
        heard[head[0]] = body
    east, north, up, *_ = struct.unpack(">12dI", heard[30])
    assert (east, north, up) == pytest.approx((4.0, 3.0, -5.0), abs=1.0)
    assert struct.unpack(">9f", heard[60])[2] == pytest.approx(9.81, abs=0.5)
    assert math.isnan(struct.unpack(">9f", heard[60])[8])
    client.ask(*services, 1, octets(b'{"service": "world/resume"}'))
    client.close()


class Opaque(ctypes.Structure):
    """player_opaque_data_t"""

    _fields_ = (("count", ctypes.c_uint32), ("data", ctypes.c_void_p))


@pytest.mark.skipif(not LIBRARY, reason="UWSERVER_PLAYERC names no libplayerc.so")
def test_the_page_with_players_own_library(port: int) -> None:
    library = ctypes.CDLL(LIBRARY, mode=os.RTLD_LAZY)
    for name in ("client_create", "position3d_create", "imu_create", "opaque_create", "client_read"):
        getattr(library, f"playerc_{name}").restype = ctypes.c_void_p
    handle = ctypes.c_void_p(library.playerc_client_create(None, b"127.0.0.1", port))
    assert library.playerc_client_connect(handle) == 0
    assert library.playerc_client_get_devlist(handle) == 0
    for kind, number in (("position3d", 0), ("imu", 0)):
        device = ctypes.c_void_p(getattr(library, f"playerc_{kind}_create")(handle, number))
        assert getattr(library, f"playerc_{kind}_subscribe")(device, 1) == 0
    client = Client(port)
    numbers = client.ask(1, 0, 1)
    number = struct.unpack(">I", numbers[-4:])[0]
    client.close()
    opaque = ctypes.c_void_p(library.playerc_opaque_create(handle, number))
    assert library.playerc_opaque_subscribe(opaque, 1) == 0
    for _ in range(20):
        assert library.playerc_client_read(handle)
    text = ctypes.create_string_buffer(b'{"service":"world/status"}')
    asked = Opaque(len(text.value), ctypes.cast(text, ctypes.c_void_p))
    answer = ctypes.POINTER(Opaque)()
    assert library.playerc_opaque_req(opaque, ctypes.byref(asked), ctypes.byref(answer)) == 0
    said = ctypes.string_at(answer.contents.data, answer.contents.count)
    assert json.loads(said)["result"]["scenario"] == "sea"
    assert library.playerc_client_disconnect(handle) == 0
