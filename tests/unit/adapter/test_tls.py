"""TLS from the files of a table: what is required of a peer, and what is said of files that do not fit."""

from __future__ import annotations

import ssl
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
