"""No web page commands a server: what browsers send to every TCP port of one, as recorded bytes and from a real browser."""

from __future__ import annotations

import contextlib
import http.server
import json
import re
import shutil
import socket
import subprocess
import threading
import xmlrpc.client
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import uwclient
from browser_rig import SENT
from nursery import python
from uwserver_adapters.moos import wire
from uwserver_adapters.player import wire as player
from uwserver_adapters.ros1 import wire as tcpros

pymavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")

PATIENCE_S = 60
PORTS = ("tcp", "text", "moosdb", "morse", "mavlink", "ros1", "tcpros", "yarp", "player", "video", "web", "metrics")
ORIGIN = "http://evil.example:8000"
SCENARIO = """
schema = 1
[vehicles.rov]
model = "bluerov2"
[vehicles.rov.autopilot]
[adapters.tcp]
kind = "sockets"
port = 0
[adapters.moosdb]
kind = "moosdb"
port = 0
[adapters.text]
kind = "moos_text"
port = 0
[adapters.mavlink]
kind = "mavlink"
links = ["tcpin:127.0.0.1:0"]
[adapters.morse]
kind = "morse"
port = 0
stream_port = 0
[adapters.ros1]
kind = "ros1"
master = "http://127.0.0.1:9"
[adapters.yarp]
kind = "yarp"
name_server = "127.0.0.1:9"
[adapters.player]
kind = "player"
port = 0
[adapters.video]
kind = "video"
rtsp_port = 0
codec = "jpeg"
[adapters.web]
kind = "web"
port = 0
[server]
metrics_port = 0
"""


class Server:
    """`uwserver run` in a process of its own; ports by adapter, and that of the metrics."""

    def __init__(self, folder: Path) -> None:
        (folder / "all.toml").write_text(SCENARIO)
        self.log = folder / "log"
        with self.log.open("w") as log:
            command = [python(), "-m", "uwserver", "run", str(folder / "all.toml")]
            self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        self.ports: dict[str, int] = {}
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if found := re.search(r"Open http://127\.0\.0\.1:(\d+)/", line):
                self.ports["web"] = int(found[1])
            if found := re.search(r"  (\w+): .*?127\.0\.0\.1:(\d+)", line):
                self.ports[found[1]] = int(found[2])
            if line.startswith("Ctrl-C"):
                break
        else:
            raise AssertionError(self.log.read_text())
        found = re.search(r"http://127.0.0.1:(\d+)/health", self.log.read_text())
        assert found is not None
        self.ports["metrics"] = int(found[1])
        self.ports["tcpros"] = int(self.status()["adapters"]["ros1"]["details"]["tcpros"].rpartition(":")[2])
        self.ports["yarp"] = int(self.status()["adapters"]["yarp"]["details"]["ports"]["/uwserver/world/rpc:i"])

    def status(self) -> dict[str, Any]:
        with uwclient.connect("127.0.0.1", self.ports["tcp"], timeout=PATIENCE_S) as client:
            return dict(client.status())

    def assert_untouched(self) -> None:
        status = self.status()
        assert not status["paused"]
        for name, adapter in status["adapters"].items():
            assert adapter["commands"] == 0, (name, adapter)
            # Asking for the status is the one call that there was.
            assert adapter["calls"] <= (1 if name == "tcp" else 0) * self.asked, (name, adapter)
        self.asked += 1

    asked = 3


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    found = Server(tmp_path_factory.mktemp("browsers"))
    try:
        yield found
    finally:
        found.process.terminate()
        found.process.communicate(timeout=PATIENCE_S)


def command_of(adapter: str) -> bytes:
    """What would pause the world, or arm the vehicle, if it were obeyed."""
    if adapter in ("tcp", "web"):
        return b'{"jsonrpc":"2.0","id":1,"method":"call","params":{"service":"world/pause"}}\n'
    if adapter == "text":
        return b"CALL world/pause {}\nUSM_SIM_PAUSED=1\n"
    if adapter == "morse":
        return b"1 world pause []\n"
    if adapter == "ros1":
        return xmlrpc.client.dumps(("/page", "/rov/thrusters/cmd", [ORIGIN]), "publisherUpdate").encode()
    if adapter == "tcpros":
        return tcpros.header({"service": "/world/pause", "md5sum": "*"}) + tcpros.block(b"")
    if adapter == "yarp":
        return b"CONNECT /page\r\nd\r\npause\r\n"
    if adapter == "player":
        pause = player.octets(b'{"service":"world/pause"}')
        told = b""
        for number in range(64):  # the services are the last of the opaque devices
            wanted = player.u32(0, 0, player.OPAQUE, number) + player.u32(player.OPEN, 0, 0)
            told += player.encode(player.PlayerMessage(player.PLAYER, 0, player.REQ, player.DEV, wanted))
            told += player.encode(player.PlayerMessage(player.OPAQUE, number, player.REQ, 1, pause))
        return told
    if adapter == "video":
        return b"SETUP rtsp://127.0.0.1/rov/camera RTSP/1.0\r\nCSeq: 1\r\nTransport: RTP/AVP/TCP\r\n\r\n"
    if adapter == "moosdb":
        hello = wire.MoosMessage(wire.DATA, "asynchronous", data=b"page", kind=wire.STRING)
        pause = wire.notify("UWSERVER_CALL", "world/pause {}", 0.0, "page")
        return wire.HELLO + wire.packet([wire.encode(hello)]) + wire.packet([wire.encode(pause)])
    arm = pymavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    return bytes(arm.pack(pymavlink.MAVLink(None, 255, 190)))


def said(port: int, data: bytes) -> bytes:
    """All that a port answers until it closes."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as peer:
        peer.sendall(data)
        answer = b""
        with contextlib.suppress(ConnectionResetError):
            while piece := peer.recv(1 << 16):
                answer += piece
    return answer


@pytest.mark.parametrize("adapter", PORTS)
@pytest.mark.parametrize("sent", SENT, ids=lambda sent: sent.name)
def test_recorded_requests_are_answered_with_an_error_and_obeyed_by_none(server: Server, adapter: str, sent: Any):
    port = server.ports[adapter]
    answer = said(port, sent.bytes_of(f"127.0.0.1:{port}", ORIGIN, command_of(adapter)))
    # A MAVLink peer hears heartbeats from its first moment on, one of Player its banner.
    speaks_first = adapter in ("mavlink", "player")
    assert re.search(rb"HTTP/1\.1 4\d\d ", answer) if speaks_first else answer.startswith(b"HTTP/1.1 4"), answer
    assert b"Access-Control" not in answer
    server.assert_untouched()


@pytest.mark.parametrize("adapter", PORTS)
def test_a_tls_hello_ends_a_plain_port(server: Server, adapter: str):
    import ssl

    with socket.create_connection(("127.0.0.1", server.ports[adapter]), timeout=PATIENCE_S) as peer:
        with pytest.raises((ssl.SSLError, ConnectionError)):
            ssl.create_default_context().wrap_socket(peer, server_hostname="localhost")
    server.assert_untouched()


def test_it_is_told_once_an_adapter(server: Server):
    log = server.log.read_text()
    for adapter in ("tcp", "text", "moosdb", "morse", "mavlink", "ros1", "yarp", "player", "video"):
        assert len(re.findall(rf"{adapter} refused \(http\)", log)) <= 1, adapter


@pytest.mark.parametrize(
    ("head", "code"),
    [
        ("GET /health HTTP/1.1\r\nHost: 127.0.0.1:{port}", 200),
        ("GET /health HTTP/1.1\r\nHost: LOCALHOST", 200),
        ("GET /health HTTP/1.1\r\nHost: [::1]:{port}", 200),
        ("GET /health HTTP/1.0", 200),
        ("GET /health HTTP/1.1\r\nHost: evil.example:{port}", 421),
        ("GET /health HTTP/1.1\r\nHost: localhost.evil.example", 421),
        ("GET /health HTTP/1.1\r\nHost: localhost\r\nHost: evil.example", 421),
        ("POST /health HTTP/1.1\r\nHost: localhost", 405),
        ("OPTIONS /metrics HTTP/1.1\r\nHost: localhost", 405),
        ("DELETE * HTTP/1.1\r\nHost: localhost", 405),
    ],
)
def test_the_health_port_answers_its_own_names_and_two_methods(server: Server, head: str, code: int):
    port = server.ports["metrics"]
    answer = said(port, head.format(port=port).encode() + b"\r\n\r\n")
    assert answer.startswith(b"HTTP/1.1 %d " % code), answer


PAGE = """<!doctype html><body><iframe name=f></iframe><script>
const ports = %s, bodies = %s, report = {sockets: []}
async function attack(name) {
  const at = 'http://127.0.0.1:' + ports[name], body = bodies[name]
  for (const mode of ['no-cors', 'cors']) {
    try { await fetch(at, {method: 'POST', mode, body}); report[name + mode] = 'sent' } catch (e) { report[name + mode] = 'failed' }
  }
  try { await fetch(at + '/health', {method: 'PUT', headers: {'X-A': '1'}, body}); report[name + 'put'] = 'read' } catch (e) {}
  for (const path of ['/', '/health', '/world.json']) {
    try { await (await fetch(at + path)).text(); report[name + path] = 'read' } catch (e) {}
  }
  navigator.sendBeacon(at, body)
  const form = document.createElement('form'), input = document.createElement('input')
  form.method = 'POST'; form.enctype = 'text/plain'; form.action = at; form.target = 'f'
  const cut = body.indexOf('='); input.name = cut < 0 ? body.trim().slice(0, -1) + ',"a":"' : body.slice(0, cut)
  input.value = cut < 0 ? '"}' : body.slice(cut + 1)
  form.append(input); document.body.append(form); form.submit()
  await new Promise(done => {
    const ws = new WebSocket('ws://127.0.0.1:' + ports[name] + '/live')
    ws.onopen = () => { report.sockets.push(name); ws.send(body) }
    ws.onerror = ws.onclose = done
    setTimeout(done, 5000)
  })
}
(async () => {
  for (const name in ports) await attack(name)
  await new Promise(done => setTimeout(done, 500))
  await fetch('/done', {method: 'POST', body: JSON.stringify(report)})
})()
</script>"""


@contextlib.contextmanager
def site(page: str) -> Iterator[tuple[int, list[dict[str, Any]], threading.Event]]:
    """A web site with this page: its port, what the page reported, and when it did."""
    reports: list[dict[str, Any]] = []
    done = threading.Event()

    class Site(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self._answer(page.encode())

        def do_POST(self) -> None:
            reports.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self._answer(b"")
            done.set()

        def _answer(self, body: bytes) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Site) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.server_address[1], reports, done
        finally:
            server.shutdown()
            thread.join()


BROWSERS = {
    "chromium": ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome"),
    "firefox": ("firefox-esr", "firefox"),
}


@pytest.mark.slow
@pytest.mark.parametrize("browser", BROWSERS)
def test_a_page_in_a_real_browser_neither_commands_nor_reads(server: Server, browser: str, tmp_path: Path):
    program = next((found for name in BROWSERS[browser] if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"no {browser} on this machine: install {BROWSERS[browser][0]}")
    bodies = {name: command_of(name).decode() for name in ("tcp", "text", "morse", "ros1", "yarp", "video", "web")} | {
        "player": "a=b",
        "mavlink": "a=b",
        "moosdb": "a=b",
        "metrics": "a=b",
        "tcpros": "a=b",
    }
    with site(PAGE % (json.dumps(server.ports), json.dumps(bodies))) as (port, reports, done):
        # Chromium takes the page for one of another site; Firefox for one of this machine, which was let in once.
        if browser == "chromium":
            options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}", "--remote-debugging-port=0",
                       "--host-resolver-rules=MAP evil.example 127.0.0.1", f"http://evil.example:{port}/"]  # fmt: skip
        else:
            options = ["--headless", "--no-remote", "--profile", str(tmp_path), f"http://localhost:{port}/"]
        with subprocess.Popen(
            [program, *options],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={"HOME": str(tmp_path), "PATH": "/usr/bin:/bin"},
        ) as process:
            try:
                assert done.wait(2 * PATIENCE_S), "the page did not end"
            finally:
                process.kill()
    (report,) = reports
    assert report["sockets"] == []
    assert "read" not in report.values(), report
    assert report["tcpno-cors"] == "sent", f"the attack must have reached the port: {report}"
    server.assert_untouched()
