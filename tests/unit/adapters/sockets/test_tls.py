"""TLS for TCP and WebSocket: who gets in, who does not, and what a wrong configuration says."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import ssl
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from kernel_buffers import shorten_suite
from uwserver_adapters.sockets import SocketsAdapter
from uwserver_adapters.sockets.connection import SocketsConfig
from websockets.asyncio.client import connect

from uwserver.adapter import CannotListen
from uwserver.testing import FakeContext, Requests, TcpPeer, check_adapter
from uwserver.testing.adapters import CHECKS, PASSED

Serving = Callable[..., Any]
PING = b'{"id":1,"method":"ping","params":5}\n'


def play(serving: Serving, certificate: tuple[str, str], scene: Callable[[Any], Any], **config: Any) -> None:
    async def whole() -> None:
        async with serving(tls_cert=certificate[0], tls_key=certificate[1], **config) as context:
            await asyncio.wait_for(scene(context), 120)

    asyncio.run(whole())


async def dial(context: Any, tls: ssl.SSLContext | None) -> TcpPeer:
    host, _, port = context.stats.address.rpartition(":")
    return TcpPeer(*await asyncio.open_connection(host, int(port), ssl=tls))


async def pong(context: Any, tls: ssl.SSLContext) -> None:
    peer = await dial(context, tls)
    await peer.send(PING)
    assert json.loads(await asyncio.wait_for(peer.reader.readline(), 60))["result"] == 5
    await peer.close()


def test_lines_and_websocket(serving: Serving, certificate: Any, trusting: ssl.SSLContext) -> None:
    async def scene(context: Any) -> None:
        await pong(context, trusting)
        async with connect(f"wss://{context.stats.address}", ssl=trusting) as client:
            await client.send(PING.decode())
            assert json.loads(await client.recv())["result"] == 5
        while context.stats.peers:
            await asyncio.sleep(0.01)

    play(serving, certificate, scene)


def test_plain_clients_are_closed_and_logged_once(
    serving: Serving, certificate: Any, trusting: ssl.SSLContext, caplog: pytest.LogCaptureFixture
) -> None:
    async def scene(context: Any) -> None:
        for data in (PING, b"GET / HTTP/1.1\r\n\r\n", b"\x00" * 100, PING):
            peer = await dial(context, None)
            await peer.send(data)
            with contextlib.suppress(ConnectionError):
                await asyncio.wait_for(peer.reader.read(), 60)
            await peer.close()
        await pong(context, trusting)
        assert context.stats.details["refused"] == {"tls plain client": 4}
        assert caplog.text.count("speaks TLS only") == 1

    play(serving, certificate, scene)


def test_a_peer_that_says_nothing_is_ended(serving: Serving, certificate: Any) -> None:
    async def scene(context: Any) -> None:
        peer = await dial(context, None)
        assert await asyncio.wait_for(peer.reader.read(), 60) == b""
        await peer.close()
        assert context.stats.details["refused"] == {"tls timeout": 1}

    play(serving, certificate, scene, hello_timeout_s=0.1)


def test_handshakes_under_way_are_bounded(serving: Serving, certificate: Any) -> None:
    async def scene(context: Any) -> None:
        waits = await dial(context, None)
        await asyncio.sleep(0.05)
        other = await dial(context, None)
        with contextlib.suppress(ConnectionError):
            assert await asyncio.wait_for(waits.reader.read(), 60) == b"", "the oldest makes way"
        assert context.stats.details["refused"] == {"strangers": 1}
        for peer in (waits, other):
            await peer.close()

    play(serving, certificate, scene, max_strangers=1)


def test_old_versions_are_refused(serving: Serving, certificate: Any, trusting: ssl.SSLContext) -> None:
    async def scene(context: Any) -> None:
        old = ssl.create_default_context(cafile=certificate[0])
        old.minimum_version = ssl.TLSVersion.MINIMUM_SUPPORTED
        old.set_ciphers("DEFAULT:@SECLEVEL=0")
        with pytest.warns(DeprecationWarning, match="TLSv1_1"):
            old.maximum_version = ssl.TLSVersion.TLSv1_1
        with pytest.raises((ssl.SSLError, ConnectionError)):
            await dial(context, old)
        await asyncio.sleep(0.05)
        assert context.stats.details["refused"] == {"tls old version": 1}
        trusting.maximum_version = ssl.TLSVersion.TLSv1_2
        await pong(context, trusting)

    play(serving, certificate, scene)


@pytest.mark.parametrize("ciphers", ["NULL", "aNULL", "RC4:3DES:EXPORT"])
def test_nobody_is_talked_into_weak_ciphers(serving: Serving, certificate: Any, ciphers: str) -> None:
    async def scene(context: Any) -> None:
        weak = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        weak.check_hostname, weak.verify_mode = False, ssl.CERT_NONE
        weak.maximum_version = ssl.TLSVersion.TLSv1_2
        try:
            weak.set_ciphers(f"{ciphers}:@SECLEVEL=0")
        except ssl.SSLError:
            pytest.skip("this OpenSSL has none of these")
        weak.set_ciphers(f"{ciphers}:@SECLEVEL=0")
        with pytest.raises((ssl.SSLError, ConnectionError)):
            await dial(context, weak)

    play(serving, certificate, scene)


@pytest.mark.parametrize(("options", "is_taken"), [(["-tls1_2"], True), (["-tls1_2", "-fallback_scsv"], False)])
def test_a_client_that_was_made_to_fall_back_is_told(
    serving: Serving, certificate: Any, options: list[str], is_taken: bool
) -> None:
    """Somebody between the two who breaks the handshakes of TLS 1.3 gets no older one (RFC 7507)."""

    async def scene(context: Any) -> None:
        command = ["openssl", "s_client", "-connect", context.stats.address, "-quiet", *options]
        client = await asyncio.create_subprocess_exec(
            *command, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
        )
        assert client.stdin
        assert client.stdout
        assert client.stderr
        client.stdin.write(b'{"id":1,"method":"ping","params":5}\n')
        answer = await asyncio.wait_for(client.stdout.readline(), 60)
        if is_taken:
            client.kill()  # else it waits for more
        said = await asyncio.wait_for(client.stderr.read(), 60)
        await client.wait()
        client.stdin.close()
        assert (b'"result":5' in answer) is is_taken, said
        assert context.stats.details.get("refused", {}) == ({} if is_taken else {"tls failure": 1})

    play(serving, certificate, scene)


def test_client_certificates(
    serving: Serving, certificate: Any, client_certificate: Any, trusting: ssl.SSLContext
) -> None:
    async def scene(context: Any) -> None:
        peer = await dial(context, trusting)  # with TLS 1.3 a client learns of the refusal when it reads
        answer = b""
        with contextlib.suppress(ssl.SSLError, ConnectionError):
            await peer.send(PING)
            answer = await asyncio.wait_for(peer.reader.read(), 60)
        assert answer == b""
        await peer.close()
        assert context.stats.details["refused"] == {"tls client certificate": 1}
        trusting.load_cert_chain(*client_certificate)
        await pong(context, trusting)

    play(serving, certificate, scene, tls_client_ca=client_certificate[0])


def test_last_words_reach_the_peer(serving: Serving, certificate: Any, trusting: ssl.SSLContext) -> None:
    async def scene(context: Any) -> None:
        peer = await dial(context, trusting)
        await peer.send(b'{"id":1,"method":"hello","params":{"version":1,"token":"x"}}\n')
        assert b'"denied"' in await asyncio.wait_for(peer.reader.read(), 60)
        await peer.close()

    play(serving, certificate, scene, token="sesame")


@pytest.mark.parametrize(
    ("files", "phrase"),
    [
        ({"tls_cert": "nowhere.pem"}, "tls_cert: cannot read"),
        ({"tls_cert": "CERT", "tls_key": "nowhere.key"}, "tls_key: cannot read"),
        ({"tls_cert": "CERT"}, "tls_key is not set"),
        ({"tls_cert": "CERT", "tls_key": "OTHER"}, "no pair"),
        ({"tls_cert": "JUNK", "tls_key": "KEY"}, "PEM"),
        ({"tls_cert": "CERT", "tls_key": "KEY", "tls_client_ca": "JUNK"}, "tls_client_ca"),
        ({"tls_key": "KEY"}, "need tls_cert"),
        ({"tls_cert": "CERT", "tls_key": "KEY", "udp_port": 0}, "not encrypted"),
    ],
)
def test_wrong_files_are_named(
    certificate: Any, client_certificate: Any, tmp_path: Path, files: dict[str, Any], phrase: str
) -> None:
    junk = tmp_path / "junk.pem"
    junk.write_text("no PEM")
    names = {"CERT": certificate[0], "KEY": certificate[1], "OTHER": client_certificate[1], "JUNK": str(junk)}
    config = SocketsConfig(port=0, **{key: names.get(value, value) for key, value in files.items()})

    async def scene() -> None:
        with pytest.raises(CannotListen, match=phrase):
            await SocketsAdapter(config, FakeContext()).run(asyncio.Event())

    asyncio.run(scene())


def test_conformance(certificate: Any, trusting: ssl.SSLContext, monkeypatch: pytest.MonkeyPatch) -> None:
    shorten_suite(monkeypatch)

    async def connect_tls(context: FakeContext) -> TcpPeer:
        host, _, port = context.stats.address.rpartition(":")
        stream = socket.socket()
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stream.setblocking(False)
        await asyncio.get_running_loop().sock_connect(stream, (host, int(port)))
        return TcpPeer(*await asyncio.open_connection(sock=stream, ssl=trusting, server_hostname=host, limit=4096))

    async def scene() -> dict[str, str]:
        table = SocketsConfig(port=0, tls_cert=certificate[0], tls_key=certificate[1])
        greeting = b'{"method":"subscribe","params":{"pattern":"**"}}\n'
        call = b'"method":"call","params":{"service":"world/run_until","args":{"t_s":9}}}\n'
        requests = Requests(
            b'{"id":1,' + call,
            cancel=b'{"id":2,"method":"cancel","params":{"id":1}}\n',
            many=b"{" + call,
            misspelt=b"{" + call.replace(b"until", b"untill"),
        )
        checking = check_adapter(SocketsAdapter, table, connect=connect_tls, greeting=greeting, requests=requests)
        return await asyncio.wait_for(checking, 180)

    unsaid = {"check_time_out": "does not apply: the protocol has no time-out of a call"}
    assert asyncio.run(scene()) == dict.fromkeys(CHECKS, PASSED) | unsaid


@pytest.mark.parametrize("tls", [False, True])
def test_conformance_with_plain_peers(certificate: Any, tls: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Peers that speak no TLS at a TLS port, and ordinary ones while UDP is on."""
    shorten_suite(monkeypatch)
    files = {"tls_cert": certificate[0], "tls_key": certificate[1]} if tls else {"udp_port": 0}

    async def scene() -> None:
        greeting = b'{"method":"subscribe","params":{"pattern":"**"}}\n'
        table = SocketsConfig(port=0, **files)
        await asyncio.wait_for(check_adapter(SocketsAdapter, table, connect=TcpPeer.connect, greeting=greeting), 180)

    asyncio.run(scene())
