"""Who may reach an adapter: its address and token, hosts that try tokens, and TLS. Errors say what to do."""

from __future__ import annotations

import errno
import logging
import os
import secrets
import ssl
import stat
from pathlib import Path
from typing import NamedTuple

from uwserver.adapter.contract import AdapterContext, AdapterTable
from uwserver.adapter.listening import CannotListen, is_loopback
from uwserver.adapter.peers import RateMeter
from uwserver.ports import Fault
from uwserver.table import Name, Positive

log = logging.getLogger(__name__)

TOKEN_VARIABLE = "UWSERVER_TOKEN"
"""Environment variable with the token of clients, and of adapters whose table has none."""
WRONG_TOKENS = 10
"""Wrong tokens that a host may show in `LOCKOUT_S`; after that it is not heard until this time is over."""
LOCKOUT_S = 10.0
LOCKOUT_HOSTS = 1024
"""Hosts whose wrong tokens are counted at a time."""
MOST_BYTES = 1 << 20
"""Largest size of a file with certificates or a key."""


class TokenTable(AdapterTable, kw_only=True, frozen=True):
    """The keys of adapters whose clients show a token, and that can use TLS.

    Attributes:
        bind: address to listen at; anything but loopback needs a token.
        token: clients must show it; default: the environment's UWSERVER_TOKEN. If there is none and bind is not loopback, a token is generated and
            printed.
        allowed_origins: pages that may connect by WebSocket: an origin ("http://localhost:8000"), an origin with ":*" for any port, or "*" for all;
            by default none may.
        allowed_hosts: names of this server that WebSocket clients other than browsers may use, besides its addresses and localhost; "*" for any.
        tls_cert: certificate (PEM); with it, TCP and WebSocket are served over TLS only. A relative path starts from the folder in which the
            server was started; so do the next two.
        tls_key: its key (PEM); default: in the file of the certificate.
        tls_client_ca: authorities (PEM) of client certificates, which are then required.
        hello_timeout_s: wall time in which a client must be admitted, s; it has as long before that for a TLS handshake.
    """

    bind: Name = "127.0.0.1"
    token: Name | None = None
    allowed_origins: tuple[Name, ...] = ()
    allowed_hosts: tuple[Name, ...] = ()
    tls_cert: Name | None = None
    tls_key: Name | None = None
    tls_client_ca: Name | None = None
    hello_timeout_s: Positive = 10.0

    def tls(self) -> ssl.SSLContext | None:
        """Return the context of TLS, or None without a certificate. Raises `CannotListen` as `tls_context` does."""
        return tls_context(self.tls_cert, self.tls_key, self.tls_client_ca)


class OpenTable(AdapterTable, kw_only=True, frozen=True):
    """The keys of adapters whose protocol has no token.

    Attributes:
        bind: address to listen at. The protocol has no token: anything but loopback needs allow_network.
        allow_network: allow another address: whoever reaches it may read and command everything.
    """

    bind: Name = "127.0.0.1"
    allow_network: bool = False

    def check_bind(self, protocol: str) -> None:
        """Raise `CannotListen` if other machines can reach the address, and the table does not allow that."""
        if not (is_loopback(self.bind) or self.allow_network):
            text = f"{protocol} knows no token: whoever reaches {self.bind} could read and command all"
            raise CannotListen(f"{text}. Say allow_network = true if that is wanted")


class NodeTable(OpenTable, kw_only=True, frozen=True):
    """The keys of adapters that tell other programs of the network where to find this one.

    Attributes:
        host: name or address by which others reach this machine; default: bind, which must then lead here.
    """

    host: Name | None = None

    def reached_at(self) -> str:
        """Return the name or address by which others reach this machine.

        Raises:
            CannotListen: the table does not say it, and `bind` is every address.
        """
        if self.host is None and self.bind in ("0.0.0.0", "::"):
            text = f"{self.bind} is every address of this machine, and leads nobody here"
            raise CannotListen(f'{text}. Say host = "..." with the name or address by which others reach it')
        return self.host or self.bind


class Token(NamedTuple):
    """The token that clients must show.

    Attributes:
        text: the token; None if none is needed.
        is_new: whether it was made for this run, so that the user must be told.
    """

    text: str | None
    is_new: bool = False

    def announce(self, context: AdapterContext, reason: str, advice: str) -> None:
        """Tell the user in the log of a token that was made for this run.

        Args:
            context: the context of the adapter.
            reason: why a token is needed: what follows the name of the adapter in the sentence.
            advice: what to do with the token.
        """
        if self.is_new:
            text = "%s %s, and no token is set (token, or %s): one was made for this run. %s"
            log.warning(text, context.name, reason, TOKEN_VARIABLE, advice)


def known_token(configured: str | None) -> str | None:
    """Return the token of a table, or else of the environment; None if neither has one."""
    return configured or os.environ.get(TOKEN_VARIABLE) or None


def new_token() -> str:
    """Return a token that nobody can guess. It is hexadecimal, because a command line would take a token with a leading hyphen for an option."""
    return secrets.token_hex(24)


def token_for(known: str | None, needed: bool) -> Token:
    """Return the known token, or a new one if one is needed and none is known."""
    return Token(known) if known or not needed else Token(new_token(), True)


class Lockout:
    """Hosts that try tokens. After too many wrong ones a host is not heard for a while, whatever it sends; its admitted clients stay.

    Attributes:
        fault: the fault that such a host is told.
    """

    fault = Fault(
        "denied",
        f"more than {WRONG_TOKENS} wrong tokens of one host: it is not heard for up to {LOCKOUT_S:g} s",
        "token",
    )

    def __init__(self) -> None:
        self._hosts: dict[object, RateMeter] = {}

    def wrong(self, host: object, now: float) -> bool:
        """Count a wrong token; return whether it is the first one too many."""
        meter = self._hosts.pop(host, None) or RateMeter(WRONG_TOKENS, LOCKOUT_S)
        while len(self._hosts) >= LOCKOUT_HOSTS:
            # The first one is the host whose last wrong token is the oldest.
            del self._hosts[next(iter(self._hosts))]
        self._hosts[host] = meter
        return not meter.take(now) and meter.count == meter.most + 1

    def is_out(self, host: object, now: float) -> bool:
        """Return whether a host is not heard now."""
        meter = self._hosts.get(host)
        return meter is not None and meter.is_flooded(now)


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
