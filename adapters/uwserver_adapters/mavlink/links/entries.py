"""Makes the links that the table names: UDP, TCP, serial lines and zenoh."""

from __future__ import annotations

from collections.abc import Callable

from uwserver_adapters.mavlink.links.endpoint import Address, BadLink, Link
from uwserver_adapters.mavlink.links.router import Router
from uwserver_adapters.mavlink.links.serial import SerialLink
from uwserver_adapters.mavlink.links.tcp import TcpIn, TcpOut
from uwserver_adapters.mavlink.links.udp import UdpIn, UdpOut
from uwserver_adapters.mavlink.links.zenoh import ZenohLink

_SOCKETS: dict[str, Callable[[Address, Router], Link]] = {
    "udpout": UdpOut,
    "udpin": UdpIn,
    "tcpin": TcpIn,
    "tcpout": TcpOut,
}


def make(text: str, router: Router) -> Link:
    """Return the link that a text describes.

    Raises:
        BadLink: the text is no link.
    """
    kind, _, rest = text.partition(":")
    if kind == "serial" and rest:
        return SerialLink(rest, router)
    if kind == "zenoh" and "/" in rest:
        return ZenohLink(rest, router)
    host, _, number = rest.rpartition(":")
    host = host.strip("[]")
    if kind not in _SOCKETS or not host or not number.isdecimal() or int(number) > 0xFFFF:
        raise BadLink(
            f'link "{text}": write udpout:host:port, udpin:host:port, tcpin:host:port, tcpout:host:port, serial:/dev/ttyS1, or zenoh:tcp/host:port'
        )
    return _SOCKETS[kind]((host, int(number)), router)
