"""The state of a world as bytes, in pieces that fit into one message: ``world/save`` and ``world/load``."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping
from typing import Any

import msgspec

from uwserver.ports import Argument, Json, Refused, Service
from uwserver.world import snapshot
from uwserver.world.snapshot import MAX_BYTES
from uwserver.world.world import World

PIECE = 256 * 1024
"""Bytes of a piece, where the caller names no other size."""
MAX_KEPT = 4
"""States, saved or coming in, that are kept at once: as many clients may be at it."""

SAVE = Service(
    "world/save",
    "The whole state as bytes, to be kept and loaded later or elsewhere; in pieces, or into a file of the server's state folder.",
    (
        Argument(
            "offset", "int", "0 saves the state now; the next pieces follow", minimum=0, required=False, default=0
        ),
        Argument("length", "int", "bytes of a piece", minimum=1, maximum=MAX_BYTES, required=False, default=PIECE),
        Argument(
            "sha256", "str", "of the state whose next piece is meant; with offset > 0", required=False, default=""
        ),
        Argument("name", "str", "file in [server] state_folder, without folders", required=False, default=""),
    ),
)
LOAD = Service(
    "world/load",
    "Go to a saved state of this scenario, bit for bit; given in pieces, or as a file of the server's state folder.",
    (
        Argument("data", "str", "a piece, in base64", required=False, default=""),
        Argument("offset", "int", "where the piece belongs", minimum=0, required=False, default=0),
        Argument("bytes", "int", "of the whole state", minimum=0, maximum=MAX_BYTES, required=False, default=0),
        Argument("sha256", "str", "of the whole state", required=False, default=""),
        Argument("name", "str", "file in [server] state_folder, without folders", required=False, default=""),
    ),
)


def offer_state_services(world: World) -> None:
    """Add ``world/save`` and ``world/load`` to a finished world."""
    exchange = _Exchange(world)
    world.offer(SAVE, exchange.save)
    world.offer(LOAD, exchange.load)


class _Exchange:
    """States on their way out and in, by their SHA-256."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._saved: dict[str, tuple[int, int, bytes]] = {}
        self._coming: dict[str, bytearray] = {}

    def save(self, args: Mapping[str, Json]) -> Json:
        """A piece of the state: of now at offset 0, else of one that is kept."""
        _refuse_name(args)
        world, offset, digest = self._world, _whole(args, "offset"), str(args["sha256"])
        if offset == 0:
            data = snapshot.to_bytes(world, snapshot.take(world))
            digest = hashlib.sha256(data).hexdigest()
            _make_room(self._saved, digest)
            self._saved[digest] = (world.tick, world.t_ns, data)
        if digest not in self._saved:
            raise Refused("bad_argument", "no state of this sha256 is kept: begin again at offset 0", "sha256")
        tick, t_ns, data = self._saved[digest]
        piece = base64.b64encode(data[offset : offset + _whole(args, "length")]).decode()
        return {"tick": tick, "t_ns": t_ns, "bytes": len(data), "sha256": digest, "offset": offset, "data": piece}

    def load(self, args: Mapping[str, Json]) -> Json:
        """Take a piece in; the last one puts the world there."""
        _refuse_name(args)
        digest, size, offset = str(args["sha256"]), _whole(args, "bytes"), _whole(args, "offset")
        piece = _decoded(str(args["data"]))
        if len(digest) != 64 or size == 0:
            text = "nothing is no saved state: give the size (bytes) and the sha256 of the whole state"
            raise Refused("bad_argument", text, "sha256")
        if size > MAX_BYTES:
            raise Refused("out_of_range", f"{size} bytes are no saved state: one has at most {MAX_BYTES}", "bytes")
        if offset == 0:
            _make_room(self._coming, digest)
            self._coming[digest] = bytearray()
        buffer = self._coming.get(digest, bytearray())
        if offset != len(buffer):
            raise Refused("bad_argument", f"the next piece belongs at offset {len(buffer)}, not {offset}", "offset")
        if offset + len(piece) > size:
            raise Refused("out_of_range", f"more than the {size} bytes that were announced", "data")
        for other in [each for each in self._coming if each != digest]:
            # One that was left half-way makes room for the one that goes on.
            if sum(map(len, self._coming.values())) + len(piece) > MAX_BYTES:
                del self._coming[other]
        buffer += piece
        if len(buffer) < size:
            return {"received": len(buffer)}
        del self._coming[digest]
        if hashlib.sha256(buffer).hexdigest() != digest.lower():
            text = "the pieces do not add up to the sha256: send them again from offset 0"
            raise Refused("bad_argument", text, "sha256")
        world = self._world
        snapshot.from_bytes(world, bytes(buffer))
        world.say("reset", f"the world is at a saved state of tick {world.tick}")
        return {"tick": world.tick, "t_ns": world.t_ns}


def in_one_piece(data: bytes) -> dict[str, Json]:
    """Arguments of ``world/load`` for a whole state."""
    text = base64.b64encode(data).decode()
    return {"data": text, "offset": 0, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest(), "name": ""}


def _make_room(kept: dict[str, Any], digest: str) -> None:
    """Forget the oldest of too many."""
    kept.pop(digest, None)
    while len(kept) >= MAX_KEPT:
        del kept[next(iter(kept))]


def _refuse_name(args: Mapping[str, Json]) -> None:
    if args["name"]:
        raise Refused("denied", "files are for a server with [server] state_folder in its scenario", "name")


def _decoded(text: str) -> bytes:
    try:
        return msgspec.convert(text, bytes)  # four times as fast as the standard library
    except msgspec.ValidationError:
        raise Refused("bad_argument", "data must be base64", "data") from None


def _whole(args: Mapping[str, Json], name: str) -> int:
    return int(args[name])  # type: ignore[arg-type]  # checked against the argument
