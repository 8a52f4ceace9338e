"""Addresses on which adapters listen, as users write them, and errors that say what to do if one is not available."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import re
import socket
from collections.abc import Iterator, Sequence
from typing import Literal

from uwserver.adapter.base import CannotServe
from uwserver.adapter.contract import AdapterContext, Subscriber

IN_USE = "is in use"
"""The words of `cannot_listen` for an address that another program has."""
ANOTHER = "another uwserver"
"""The program that most likely has an address that is in use."""

Kind = Literal["tcp", "udp"]


class CannotListen(CannotServe):
    """The address is not available, or the certificate cannot be used; the text says why, and what to do."""


def is_loopback(bind: str) -> bool:
    """Tell whether only this machine can reach an address."""
    try:
        return ipaddress.ip_address(bind).is_loopback
    except ValueError:
        return bind == "localhost"


def may_connect(host: str, allowed: Sequence[str]) -> bool:
    """Tell whether this server may connect to a host that a peer has named: this machine, or an allowed host."""
    return host in allowed or host == socket.gethostname() or is_loopback(host)


def host_here(bind: str) -> str:
    """Return an address at which this machine reaches a server that listens at `bind`, which may mean all addresses."""
    return {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(bind, bind)


_HOST = re.compile(r"(?:\[([^\[\]/@\s]+)\]|([^:\[\]/@\s]+))(?::[0-9]*)?")


def host_name(host: str) -> str:
    """Return the name or address in an HTTP ``Host``, without the port; "" if it is none, such as ``127.0.0.1:80@evil.example``."""
    found = _HOST.fullmatch(host)
    return "" if found is None else found[1] or found[2]


def is_host_known(host: str, names: Sequence[str] = ()) -> bool:
    """Tell whether an HTTP ``Host`` names this server: by an address, as localhost, or by one of the names; "*" stands for every name.

    This check stops DNS rebinding. A page whose name was made to point at this machine has the origin of this server for its browser, but its
    requests carry its own name.
    """
    name = host_name(host.strip().lower())
    if name == "localhost" or "*" in names or name in (known.lower() for known in names):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def address_text(bind: str, port: int) -> str:
    """Return ``host:port`` as a user would type it."""
    return f"[{bind}]:{port}" if ":" in bind else f"{bind}:{port}"


def cannot_listen(
    error: OSError, bind: str, port: int, kind: Kind = "tcp", *, key: str = "port", rival: str = ANOTHER
) -> CannotListen:
    """Return an exception that says what is wrong with an address.

    Args:
        error: error of the operating system.
        bind, port: the address.
        kind: whether it is a TCP or a UDP port.
        key: key of the adapter's table that sets the port.
        rival: the program that most likely has the port when it is in use.
    """
    where = f"{bind} {kind.upper()} port {port}"
    if error.errno == errno.EADDRINUSE:
        options = "ltnp" if kind == "tcp" else "lunp"
        return CannotListen(
            f"{where} {IN_USE}, perhaps by {rival}: stop it (`ss -{options} 'sport = :{port}'` names it), or give this adapter "
            f"another port ({key} = 0 takes a free one)"
        )
    if error.errno == errno.EACCES:
        return CannotListen(f"{where} needs rights that this process has not: take a port above 1023")
    if error.errno == errno.EADDRNOTAVAIL:
        return CannotListen(
            f"{where}: this machine has no such address; bind = 127.0.0.1 is always there, 0.0.0.0 means all"
        )
    return CannotListen(f"cannot listen at {where}: {error}")


def bound_socket(bind: str, port: int, kind: Kind, *, rival: str = ANOTHER) -> socket.socket:
    """Return a non-blocking socket at an address, for datagrams or to accept connections, for example for a `Driver`.

    Raises:
        CannotListen: the address is not available.
    """
    stream = socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM
    try:
        family, _, _, _, address = socket.getaddrinfo(bind, port, type=stream)[0]
        endpoint = socket.socket(family, stream)
        try:
            endpoint.setblocking(False)
            if kind == "tcp":
                endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            endpoint.bind(address)
            if kind == "tcp":
                endpoint.listen(8)
        except OSError:
            endpoint.close()
            raise
    except OSError as error:
        raise cannot_listen(error, bind, port, kind, rival=rival) from error
    return endpoint


@contextlib.contextmanager
def serving(context: AdapterContext, subscriber: Subscriber, address: str, ready: asyncio.Event) -> Iterator[None]:
    """Report that an adapter runs, and where, and deliver samples and events while the context is open.

    Args:
        context: the context of the adapter.
        subscriber: receives samples and events.
        address: where a peer finds the adapter, as a user would type it.
        ready: the event that `Adapter.run` got.
    """
    stats = context.stats
    detach = context.attach(subscriber)
    try:
        stats.address = address
        stats.state = "running"
        ready.set()
        yield
    finally:
        detach()
        stats.state = "stopped"
