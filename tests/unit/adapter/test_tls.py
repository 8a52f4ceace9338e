"""TLS from the files of a table: what is required of a peer, and what is said of files that do not fit."""

from __future__ import annotations

import os
import ssl
import subprocess
import sys
from pathlib import Path

import pytest
from sockets_rig import certificate, client_certificate

from uwserver.adapter import CannotListen, tls_context

__all__ = ["certificate", "client_certificate"]  # fixtures


def test_without_a_certificate_there_is_no_tls():
    assert tls_context(None, None, None) is None


def test_a_pair_serves_anybody_from_version_1_2_on(certificate: tuple[str, str]):
    context = tls_context(*certificate, None)
    assert context is not None
    assert context.minimum_version is ssl.TLSVersion.TLSv1_2
    assert context.verify_mode is ssl.CERT_NONE


def test_an_authority_makes_certificates_of_clients_a_duty(
    certificate: tuple[str, str], client_certificate: tuple[str, str]
):
    context = tls_context(*certificate, client_certificate[0])
    assert context is not None
    assert context.verify_mode is ssl.CERT_REQUIRED
    assert len(context.get_ca_certs()) == 1


def test_one_file_may_hold_both(certificate: tuple[str, str], tmp_path: Path):
    both = tmp_path / "both.pem"
    both.write_text("".join(Path(file).read_text() for file in certificate))
    assert tls_context(str(both), None, None) is not None


@pytest.mark.parametrize("left", [(None, "x.key", None), (None, None, "ca.pem")])
def test_a_key_without_certificate_is_told(left: tuple[str | None, str | None, str | None]):
    with pytest.raises(CannotListen, match="need tls_cert"):
        tls_context(*left)


def test_files_that_do_not_fit_are_named(
    certificate: tuple[str, str], client_certificate: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    cert, key = certificate
    monkeypatch.chdir(tmp_path)
    text = tmp_path / "text.pem"
    text.write_text("no certificate")
    cases = [
        ((str(text), key, None), "are no pair of certificate and key in PEM"),
        ((cert, client_certificate[1], None), "are no pair of certificate and key in PEM"),
        ((cert, None, None), "which must hold the key too: tls_key is not set"),
        (("gone.pem", key, None), f'tls_cert: cannot read "{tmp_path / "gone.pem"}"'),
        ((cert, "gone.key", None), f'tls_key: cannot read "{tmp_path / "gone.key"}"'),
        ((cert, key, "gone.pem"), "tls_client_ca: cannot read"),
        ((cert, key, str(text)), "holds no certificates in PEM"),
    ]
    for files, told in cases:
        with pytest.raises(CannotListen) as refused:
            tls_context(*files)
        assert told in str(refused.value)


@pytest.mark.parametrize("setting", ["tls_cert", "tls_key", "tls_client_ca"])
@pytest.mark.parametrize("what", ["pipe", "folder", "device", "endless", "nul"])
def test_what_is_no_plain_file_is_neither_waited_for_nor_read(
    certificate: tuple[str, str], tmp_path: Path, setting: str, what: str
):
    path = tmp_path / "it.pem"
    if what == "pipe":
        os.mkfifo(path)
    elif what == "folder":
        path.mkdir()
    elif what == "endless":
        with path.open("wb") as file:
            file.truncate(1 << 40)
    name = {"device": "/dev/zero", "nul": "a\0b"}.get(what, str(path))
    files = {"tls_cert": certificate[0], "tls_key": certificate[1], "tls_client_ca": certificate[0]} | {setting: name}
    told = {"endless": "bytes: at most 1048576", "nul": "no file can have this name"}.get(what, "no plain file")
    with pytest.raises(CannotListen, match=f"^{setting}: .*{told}"):
        tls_context(files["tls_cert"], files["tls_key"], files["tls_client_ca"])


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root can become another user")
def test_a_key_that_may_not_be_read_is_named(certificate: tuple[str, str], tmp_path: Path):
    key = Path(certificate[1])
    key.chmod(0o600)
    text = f"""
import os, sys
from uwserver.adapter import CannotListen, tls_context
folder = os.open({str(key.parent)!r}, os.O_RDONLY)
os.fchdir(folder)
os.setuid(65534)
try:
    tls_context({Path(certificate[0]).name!r}, {key.name!r}, None)
except CannotListen as error:
    print(error)
"""
    Path(certificate[0]).chmod(0o644)
    key.parent.chmod(0o755)
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=120, check=False)
    assert "tls_key: cannot read" in done.stdout, done.stderr
    assert "Permission denied" in done.stdout
