"""The state of a world as bytes, in pieces that fit into a message: ``world/save`` and ``world/load``."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping
from typing import Any

import msgspec

from uwserver.ports import Argument, Json, Refused, Service
from uwserver.world.state import snapshot
from uwserver.world.state.snapshot import MAX_BYTES
from uwserver.world.world import World

PIECE = 256 * 1024
"""Bytes of a piece, if the caller gives no size."""
MAX_KEPT = 4
"""Most states that are kept at once, saved or coming in, so that several clients can save or load at the same time."""

SAVE = Service(
    "world/save",
    "The whole state as bytes, to be kept and loaded later or elsewhere; in pieces, or into a file of the server's state folder.",
    (
        Argument(
            "offset", "int", "0 saves the state now; the next pieces follow", minimum=0, required=False, default=0
        ),
        Argument("length", "int", "bytes of a piece", minimum=1, maximum=MAX_BYTES, required=False, default=PIECE),
        Argument(
            "sha256", "str", "of the state whose next piece is wanted; needed if offset > 0", required=False, default=""
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
    """The states that are being sent or received, by their SHA-256."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._saved: dict[str, tuple[int, int, bytes]] = {}
        self._incoming: dict[str, bytearray] = {}

    def save(self, args: Mapping[str, Json]) -> Json:
        """Return a piece of a state: of the present one at offset 0, else of one that is kept."""
        _refuse_name(args)
        world, offset, digest = self._world, _int_argument(args, "offset"), str(args["sha256"])
        if offset == 0:
            data = snapshot.to_bytes(world, snapshot.take(world))
            digest = hashlib.sha256(data).hexdigest()
            _make_room(self._saved, digest)
            self._saved[digest] = (world.tick, world.t_ns, data)
        if digest not in self._saved:
            raise Refused("bad_argument", "no state of this sha256 is kept: begin again at offset 0", "sha256")
        tick, t_ns, data = self._saved[digest]
        piece = base64.b64encode(data[offset : offset + _int_argument(args, "length")]).decode()
        return {"tick": tick, "t_ns": t_ns, "bytes": len(data), "sha256": digest, "offset": offset, "data": piece}

    def load(self, args: Mapping[str, Json]) -> Json:
        """Take a piece of a state. The last piece puts the world there."""
        _refuse_name(args)
        digest, size, offset = str(args["sha256"]), _int_argument(args, "bytes"), _int_argument(args, "offset")
        piece = _decoded(str(args["data"]))
        if len(digest) != 64 or size == 0:
            text = "a saved state must come with its size (bytes) and the sha256 of the whole state"
            raise Refused("bad_argument", text, "sha256")
        if size > MAX_BYTES:
            raise Refused("out_of_range", f"a saved state has at most {MAX_BYTES} bytes, not {size}", "bytes")
        if offset == 0:
            _make_room(self._incoming, digest)
            self._incoming[digest] = bytearray()
        buffer = self._incoming.get(digest, bytearray())
        if offset != len(buffer):
            raise Refused("bad_argument", f"the next piece belongs at offset {len(buffer)}, not {offset}", "offset")
        if offset + len(piece) > size:
            raise Refused("out_of_range", f"more than the {size} bytes that were announced", "data")
        for other in [each for each in self._incoming if each != digest]:
            # A state that was left half-way makes room for the one that goes on.
            if sum(map(len, self._incoming.values())) + len(piece) > MAX_BYTES:
                del self._incoming[other]
        buffer += piece
        if len(buffer) < size:
            return {"received": len(buffer)}
        del self._incoming[digest]
        if hashlib.sha256(buffer).hexdigest() != digest.lower():
            text = "the pieces do not add up to the sha256: send them again from offset 0"
            raise Refused("bad_argument", text, "sha256")
        world = self._world
        snapshot.from_bytes(world, bytes(buffer))
        world.say("reset", f"the world is at a saved state of tick {world.tick}")
        return {"tick": world.tick, "t_ns": world.t_ns}


def in_one_piece(data: bytes) -> dict[str, Json]:
    """Return the arguments of ``world/load`` for a whole state."""
    text = base64.b64encode(data).decode()
    return {"data": text, "offset": 0, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest(), "name": ""}


def _make_room(kept: dict[str, Any], digest: str) -> None:
    """Remove the oldest states if there are too many."""
    kept.pop(digest, None)
    while len(kept) >= MAX_KEPT:
        del kept[next(iter(kept))]


def _refuse_name(args: Mapping[str, Json]) -> None:
    if args["name"]:
        raise Refused(
            "denied",
            "there are no files here: run a server with [server] state_folder in its scenario, or leave the name out",
            "name",
        )


def _decoded(text: str) -> bytes:
    try:
        return msgspec.convert(text, bytes)  # four times as fast as base64 of the standard library
    except msgspec.ValidationError:
        raise Refused("bad_argument", "data must be base64", "data") from None


def _int_argument(args: Mapping[str, Json], name: str) -> int:
    return int(args[name])  # type: ignore[arg-type]  # checked against the argument
