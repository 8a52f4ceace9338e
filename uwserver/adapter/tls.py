"""TLS of an adapter that listens, from the files that its table names. Errors say what to do."""

from __future__ import annotations

import errno
import os
import ssl
import stat
from pathlib import Path

from uwserver.adapter.listening import CannotListen

MOST_BYTES = 1 << 20
"""Largest size of a file with certificates or a key."""


def tls_context(cert: str | None, key: str | None, client_ca: str | None) -> ssl.SSLContext | None:
    """Return a context for TLS 1.2 and later, or None if no certificate is configured.

    Args:
        cert, key: PEM files; a relative path starts from the folder in which the server was started.
        client_ca: PEM file with the authorities of client certificates, which are then required.

    Raises:
        CannotListen: a file is missing, unreadable or wrong.
    """
    if cert is None:
        if key is not None or client_ca is not None:
            raise CannotListen(
                "tls_key and tls_client_ca need tls_cert: name the certificate (PEM), or leave all three out"
            )
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    for setting, file in (("tls_cert", cert), ("tls_key", key), ("tls_client_ca", client_ca)):
        _check_readable(setting, file)
    try:
        # The empty password keeps OpenSSL from asking for one at the terminal.
        context.load_cert_chain(cert, key, password="")
    except (ssl.SSLError, OSError) as error:
        pair = f' and tls_key "{key}"' if key else " (which must hold the key too: tls_key is not set)"
        raise CannotListen(
            f'tls_cert "{cert}"{pair} are no pair of certificate and key in PEM, or the key has a passphrase ({_reason(error)}): '
            "make both anew, or remove it"
        ) from error
    if client_ca is not None:
        try:
            context.load_verify_locations(client_ca)
        except (ssl.SSLError, OSError) as error:
            text = f'tls_client_ca "{client_ca}" holds no certificates in PEM ({_reason(error)})'
            raise CannotListen(
                f"{text}: give the file of the authority that signed the clients' certificates"
            ) from error
        context.verify_mode = ssl.CERT_REQUIRED
    return context


_PLAIN = ("HTTP_REQUEST", "WRONG_VERSION_NUMBER", "UNKNOWN_PROTOCOL", "RECORD_LAYER_FAILURE", "PACKET_LENGTH_TOO_LONG")
_TOO_OLD = ("UNSUPPORTED_PROTOCOL", "VERSION_TOO_LOW")
_NO_CERTIFICATE = ("PEER_DID_NOT_RETURN_A_CERTIFICATE", "CERTIFICATE_VERIFY_FAILED")
_REMEDIES = (
    (_PLAIN, "plain client", "this port speaks TLS only, connect with TLS (wss:// in a browser)"),
    (_TOO_OLD, "old version", "TLS 1.2 is the least"),
    (_NO_CERTIFICATE, "client certificate", "a client needs a certificate of tls_client_ca"),
    (("TIMEOUT",), "timeout", "it took too long"),
)


def handshake_refusal(reason: str) -> tuple[str, str]:
    """Return the cause and the text of a failed handshake, for `Refusals.note`.

    Args:
        reason: the reason that OpenSSL gives, or ``TIMEOUT``.
    """
    unknown = ((), "failure", "check the client's TLS settings and its trust in tls_cert")
    _, cause, remedy = next((entry for entry in _REMEDIES if reason in entry[0]), unknown)
    return f"tls {cause}", f"a TLS handshake failed ({reason.lower()}): {remedy}"


def _check_readable(setting: str, file: str | None) -> None:
    if file is None:
        return
    path = Path(file)
    try:
        # OpenSSL would wait for a pipe, and read a device for ever.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
        try:
            status = os.fstat(descriptor)
        finally:
            os.close(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is no plain file (a folder, a pipe or a device)")
        if status.st_size > MOST_BYTES:
            raise OSError(errno.EFBIG, f"it has {status.st_size} bytes: at most {MOST_BYTES}")
    except ValueError as error:
        # There is a NUL in the name.
        raise CannotListen(f"{setting}: no file can have this name: {error}") from error
    except OSError as error:
        text = f'{setting}: cannot read "{path.absolute()}" ({error.strerror})'
        raise CannotListen(f"{text}; a relative path starts from the folder in which the server was started") from error


def _reason(error: Exception) -> str:
    return str(getattr(error, "reason", None) or error)
