"""Who may enter a zenoh network and what he may do there: real certificates, real access control."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import uwclient
from zenoh_network import BUS, LISTEN, PATIENCE_S, ROV, TCP, Server, ask, ended, serving, session, until

TLS = "transport/link/tls/"
IMPATIENT_S = 3.0


class Authority:
    """Signs certificates for 127.0.0.1."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder = folder
        self.name = name
        self._make(name, "basicConstraints=critical,CA:TRUE", "keyUsage=keyCertSign")

    def sign(self, name: str) -> None:
        signer = ("-CA", self.file(f"{self.name}.pem"), "-CAkey", self.file(f"{self.name}.key"))
        self._make(name, "basicConstraints=critical,CA:FALSE", "subjectAltName=IP:127.0.0.1", *signer)

    def file(self, name: str) -> str:
        return str(self.folder / name)

    def _make(self, name: str, constraints: str, extension: str, *signer: str) -> None:
        command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
        command += ["-days", "2", "-subj", f"/CN={name}", "-addext", constraints, "-addext", extension, *signer]
        command += ["-keyout", self.file(f"{name}.key"), "-out", self.file(f"{name}.pem")]
        subprocess.run(command, check=True, capture_output=True, timeout=PATIENCE_S)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """ca signs server and client, other signs stranger."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make certificates")
    folder = tmp_path_factory.mktemp("certificates")
    ours, theirs = Authority(folder, "ca"), Authority(folder, "other")
    ours.sign("server")
    ours.sign("client")
    theirs.sign("stranger")
    return folder


@pytest.fixture
def guarded(tmp_path: Path, folder: Path) -> Iterator[Server]:
    """A server that speaks TLS and asks for certificates."""
    table = {
        "listen_certificate": "server.pem",
        "listen_private_key": "server.key",
        "root_ca_certificate": "ca.pem",
    }
    lines = [f'"{TLS}{key}" = {json.dumps(str(folder / name))}\n' for key, name in table.items()]
    bus = f'{BUS}listen = ["tls/127.0.0.1:0"]\n[adapters.bus.config]\n"{TLS}enable_mtls" = true\n'
    with serving(tmp_path, ROV + TCP + bus + "".join(lines)) as server:
        yield server


def as_client(folder: Path, authority: str, name: str = "") -> dict[str, object]:
    config: dict[str, object] = {f"{TLS}root_ca_certificate": str(folder / f"{authority}.pem")}
    if name:
        config[f"{TLS}enable_mtls"] = True
        config[f"{TLS}connect_certificate"] = str(folder / f"{name}.pem")
        config[f"{TLS}connect_private_key"] = str(folder / f"{name}.key")
    return config


def test_the_right_certificates_open_and_all_others_are_refused_with_the_reason(guarded, folder):
    right = as_client(folder, "ca", "client")
    with uwclient.connect_zenoh("uwserver", [guarded.endpoint], config=right, timeout=PATIENCE_S) as client:
        client.subscribe("rov/imu")
        seq = client.read("rov/imu").seq
        for config in (
            as_client(folder, "other", "client"),
            as_client(folder, "ca"),
            as_client(folder, "ca", "stranger"),
        ):
            with pytest.raises(uwclient.ConnectionLost):
                uwclient.connect_zenoh("uwserver", [guarded.endpoint], config=config, timeout=IMPATIENT_S)
        plain = guarded.endpoint.replace("tls/", "tcp/")
        with pytest.raises(uwclient.ConnectionLost):
            uwclient.connect_zenoh("uwserver", [plain], timeout=IMPATIENT_S)
        # The one who may be there was not disturbed.
        assert client.send("rov/thrusters", u=[0.1] * 8).tick > 0
        while client.read("rov/imu").seq < seq + 100:
            pass
        assert client.status()["adapters"]["bus"]["peers"] == 1
    log = guarded.end()
    for reason in (
        "received fatal alert: UnknownCA",
        "peer sent no certificates",
        "invalid peer certificate: UnknownIssuer",
        "InvalidContentType",
    ):
        assert reason in log, f"the log does not tell: {reason}"


def test_certificates_that_are_none_stop_the_start(tmp_path, folder):

    bus = f'{BUS}listen = ["tls/127.0.0.1:0"]\n[adapters.bus.config]\n'
    bus += f'"{TLS}listen_certificate" = {json.dumps(str(folder / "none.pem"))}\n'
    bus += f'"{TLS}listen_private_key" = {json.dumps(str(folder / "server.key"))}\n'
    done = ended(tmp_path, ROV + bus)
    assert done.returncode == 1
    assert "zenoh cannot open a session" in done.stderr
    assert "Traceback" not in done.stderr


DENIES = """\
[adapters.bus.config.access_control]
enabled = true
default_permission = "allow"
subjects = [{ id = "everybody" }]
policies = [{ rules = ["no driving"], subjects = ["everybody"] }]
[[adapters.bus.config.access_control.rules]]
id = "no driving"
permission = "deny"
flows = ["ingress"]
messages = ["put", "query"]
key_exprs = ["uw/uwserver/rov/thrusters"]
"""


def test_access_control_denies_a_key_and_nothing_else(tmp_path):
    with serving(tmp_path, ROV + TCP + BUS + LISTEN + DENIES) as server:
        with server.client() as client, server.tcp_client() as over_tcp, session(server.endpoint) as plain:
            client.subscribe("rov/imu")
            with pytest.raises(uwclient.CallRefused, match="access is denied") as caught:
                client.send("rov/thrusters", u=[0.5] * 8)
            assert caught.value.code == "unreachable"
            client.send_nowait("rov/thrusters", u=[0.5] * 8)
            plain.put("uw/uwserver/rov/thrusters", b'{"u": [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]}')
            assert ask(plain, "uw/uwserver/rov/thrusters", b'{"u": [0, 0, 0, 0, 0, 0, 0, 0]}') == []
            assert client.read("rov/imu").valid
            assert client.call("rov/imu/get") is not None
            until(lambda: client.status()["tick"] > 100, "time goes on")
            assert last_command(over_tcp) == {"u": None}, "no command came through"
            over_tcp.send("rov/thrusters", u=[0.25] * 8)
            assert last_command(over_tcp) == {"u": [0.25] * 8}
        server.end()


def last_command(client: uwclient.Client) -> Any:
    properties: Any = client.call("rov/thrusters/get")
    return properties["value"] or {"u": None}
