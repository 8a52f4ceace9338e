"""Where an adapter listens: addresses as users write them, and why one cannot be had, in words that say what to do."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import socket
from collections.abc import Iterator, Sequence
from typing import Literal

from uwserver.adapter.contract import AdapterContext, Subscriber
from uwserver.adapter.refusals import CannotServe

IN_USE = "is in use"
"""Words of an address that somebody else holds, in what `cannot_listen` says."""
ANOTHER = "another uwserver"
"""Who most likely holds an address that is in use."""

Kind = Literal["tcp", "udp"]


class CannotListen(CannotServe):
    """The address or the certificate cannot be had; the text says why and what to do."""


def is_loopback(bind: str) -> bool:
    """Whether only this machine reaches an address."""
    try:
        return ipaddress.ip_address(bind).is_loopback
    except ValueError:
        return bind == "localhost"


def may_connect(host: str, allowed: Sequence[str]) -> bool:
    """Whether this server connects to a host that a peer has named: this machine, or one of those that were allowed."""
    return host in allowed or host == socket.gethostname() or is_loopback(host)


def is_host_known(host: str, names: Sequence[str] = ()) -> bool:
    """Whether an HTTP ``Host`` is meant for this server: an address, localhost, or one of the names; "*" stands for every name.

    A page whose name was made to point at this machine (DNS rebinding) is of our origin for its browser, but says its own name.
    """
    name = host.strip().lower()
    name = name[1:].partition("]")[0] if name.startswith("[") else name.partition(":")[0]
    if name == "localhost" or "*" in names or name in (known.lower() for known in names):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def address_text(bind: str, port: int) -> str:
    """``host:port`` as a user would type it."""
    return f"[{bind}]:{port}" if ":" in bind else f"{bind}:{port}"


def cannot_listen(
    error: OSError, bind: str, port: int, kind: Kind = "tcp", *, key: str = "port", rival: str = ANOTHER
) -> CannotListen:
    """What is wrong with an address.

    Args:
        error: of the operating system.
        bind, port: the address.
        kind: of the port.
        key: of the adapter's table that gives the port.
        rival: who most likely holds it when it is in use.
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
    """A non-blocking socket at an address, for datagrams or to accept connections, of a `Driver` say.

    Raises:
        CannotListen: the address cannot be had.
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
    """What every adapter says of itself: that it runs, and where; it hears samples and events while the context is open.

    Args:
        context: as the adapter got it.
        subscriber: takes in samples and events.
        address: where a peer finds it, as a user would type it.
        ready: as `Adapter.run` got it.
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
