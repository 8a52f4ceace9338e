"""Where everything is on the zenoh network. Another dialect (ROS 2, MAVLink) is another class with these methods."""

from __future__ import annotations

import re

_CHUNK = re.compile(r"[^/*$?#@\x00-\x20][^/*$?#\x00-\x20]*")


class BadName(ValueError):
    """A name that cannot be part of a key; the text says why and what to do."""


class KeyScheme:
    """Keys of one server: ``<prefix>/<server>/<path>`` for ports and services, levels that begin with ``@`` for everything else.

    zenoh's wildcards never match a level that begins with ``@``: who subscribes to ``uw/<server>/**`` gets samples and commands alone.

    Raises:
        BadName: server or prefix cannot be part of a key.
    """

    def __init__(self, prefix: str, server: str) -> None:
        for what, chunks in (("prefix", prefix.split("/")), ("server", [server])):
            for chunk in chunks:
                if not _CHUNK.fullmatch(chunk):
                    raise BadName(
                        f'{what} = "{prefix if what == "prefix" else server}" cannot be part of a zenoh key: use letters, digits, "-", "_" and "."'
                    )
        self.root = f"{prefix}/{server}"
        self.everything = f"{self.root}/**"
        self.describe = f"{self.root}/@describe"
        self.hello = f"{self.root}/@hello"
        self.cancel = f"{self.root}/@cancel"
        self.event = f"{self.root}/@event"
        self.identities = f"{self.root}/@id/*"
        self.clients = f"{self.root}/@client/*"
        self.losses = f"{self.root}/@lost/*"
        self.requests = (self.everything, self.describe, self.hello, self.cancel)

    def of(self, path: str) -> str:
        """Key of a port's samples and commands, or of a service."""
        return f"{self.root}/{path}"

    def path(self, key: str) -> str | None:
        """Path of the port or service with this key; None for other keys."""
        path = key.removeprefix(f"{self.root}/")
        return None if path == key or path.startswith("@") else path

    def alive(self, path: str = "") -> str:
        """Token of the server, a vehicle or a port."""
        return f"{self.root}/@alive/{path}" if path else f"{self.root}/@alive"

    def jpeg(self, path: str) -> str:
        """Key of a port's pictures as JPEG."""
        return f"{self.root}/@jpeg/{path}"

    def identity(self, zid: str) -> str:
        """Token that tells apart two servers of one name."""
        return f"{self.root}/@id/{zid}"

    def error(self, client: str, path: str) -> str:
        """Where the refusal of a put is told."""
        return f"{self.root}/@error/{client}/{path}"

    def progress(self, client: str, request: int) -> str:
        """Where a client hears how far its call is."""
        return f"{self.root}/@progress/{client}/{request}"
