"""The whole state of a world as one immutable value of plain data: for reset, restore, files, and the hash that proves two runs equal."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Set
from typing import Annotated, Any

from msgspec import Meta, Raw, Struct, msgpack

from uwserver.physics import PHYSICS
from uwserver.ports import Refused
from uwserver.world.bodies.bodies_and_water import Bodies, BodiesState
from uwserver.world.parts.part import Part, State
from uwserver.world.world import World

MAX_BYTES = 16 * 2**20
"""Largest file of a state."""
MAX_PARTS = 2**17
"""More parts would not fit into a file."""
FORMAT = "uwserver-state-2"
_DIGEST_SIZE = 32


class Snapshot(Struct, frozen=True, eq=False):
    """The state of a world between two ticks. Commands and calls that are posted but not carried out are not part of it.

    Attributes:
        tick: tick of the world.
        parts: state of each part, by its path, in the order of `World.parts`.
    """

    tick: int
    parts: dict[str, State]

    def hash(self) -> str:
        """Return the SHA-256 of everything that decides how the run goes on. It is equal in every clock mode and process, whichever source
        commanded."""
        deciding = {path: state.deciding() for path, state in self.parts.items()}
        return hashlib.sha256(msgpack.encode((self.tick, deciding))).hexdigest()

    def __eq__(self, other: object) -> bool:
        # Compared as bytes, because NaN does not equal itself.
        return isinstance(other, Snapshot) and _encoded(self) == _encoded(other)

    __hash__ = None  # type: ignore[assignment]  # snapshots are not kept in sets


def _encoded(snapshot: Snapshot) -> bytes:
    return msgpack.encode((snapshot.tick, {path: state.completed() for path, state in snapshot.parts.items()}))


class _File(Struct, frozen=True, forbid_unknown_fields=True):
    format: str
    physics: int
    scenario: str
    seed: int
    tick: int
    parts: Annotated[dict[str, Raw], Meta(max_length=MAX_PARTS)]


def take(world: World) -> Snapshot:
    """Return the state of a world now."""
    return Snapshot(world.tick, {path: part.save() for path, part in world.parts.items()})


def restore(world: World, snapshot: Snapshot) -> None:
    """Put a world back to a snapshot, bit for bit. Bodies that were added since are removed, and bodies that were removed are back.

    Raises:
        Refused: the snapshot is of a world with other bodies or components; nothing has changed.
    """
    _restore(world, snapshot.tick, snapshot.parts, checked=True)


def to_bytes(world: World, snapshot: Snapshot) -> bytes:
    """Return a snapshot as the bytes of a file: msgpack, then 32 bytes SHA-256 of the rest. Waits for readings under computation.

    Raises:
        Refused: it is too large to be loaded again.
    """
    parts = {path: Raw(msgpack.encode(state.completed())) for path, state in snapshot.parts.items()}
    data = msgpack.encode(_File(FORMAT, PHYSICS, world.identity(), world.seed, snapshot.tick, parts))
    if len(data) > MAX_BYTES - _DIGEST_SIZE:
        raise Refused("too_large", f"the state has {len(data)} bytes: at most {MAX_BYTES} can be saved and loaded")
    return data + hashlib.sha256(data).digest()


def from_bytes(world: World, data: bytes) -> None:
    """Put a world to the state in a file, as `restore` does.

    Raises:
        Refused: it is no state of this scenario and version, is damaged, too large or impossible; the text says which. Nothing has changed.
    """
    if len(data) > MAX_BYTES:
        raise _refused(f"a saved state has at most {MAX_BYTES} bytes, not {len(data)}")
    body, digest = data[:-_DIGEST_SIZE], data[-_DIGEST_SIZE:]
    if hashlib.sha256(body).digest() != digest:
        raise _refused("this is no saved state, or it was damaged: its check sum is wrong")
    try:
        file = msgpack.decode(body, type=_File)
    except (ValueError, RecursionError) as error:
        raise _refused(f"this is no saved state of this version: {error}") from None
    for name, theirs, ours in (("format", file.format, FORMAT), ("physics", file.physics, PHYSICS)):
        if theirs != ours:
            raise _refused(f"the state was saved by another version of uwserver ({name} {theirs}, here {ours})")
    if (file.scenario, file.seed) != (world.identity(), world.seed):
        text = "the state is of another scenario: load the scenario and the seed with which it was saved"
        raise _refused(f"{text} (seed {file.seed}, here {world.seed})" if file.seed != world.seed else text)
    if not 0 <= world.ticks.time_of(file.tick) < 2**62:
        raise _refused(f"tick {file.tick} is not possible")
    _restore(world, file.tick, file.parts, checked=False)


def _restore(world: World, tick: int, states: Mapping[str, Any], checked: bool) -> None:
    """Restore the population first, as it says which other parts there are. Until everything has been checked, all changes can be undone."""
    bodies, undo, before = world.population, world.hydro.arrays(), list(world.members.values())
    members = before
    try:
        born = _typed(bodies, states.get(bodies.path))
        here = bodies.is_here(born)
        if not here:
            # Checked by name first, as making bodies takes far longer: none is made for a state that lacks the parts of its bodies.
            bodies.check(born)
            _compare(states.keys(), {part.path for part in world.own_parts} | bodies.parts_of(born))
            rows: BodiesState = _typed(world.parts[Bodies.path], states[Bodies.path])
            world.hydro.check_sizes(rows.arrays, bodies.params_of(born))
            members = bodies.members_of(born)
            world.bind(members)
        _compare(states.keys(), world.parts.keys())
        found = [(part, _typed(part, states[path], checked)) for path, part in world.parts.items()]
    except Exception as error:
        world.hydro.go_back(undo)
        if members is not before:
            world.bind(before)
        if not isinstance(error, ValueError | RecursionError | Refused):
            raise
        raise _refused(f"the state does not fit this world: {error}") from None
    world.jump(tick)
    if not here:
        bodies.admit(born, members)
    for part, state in found:
        part.load(state)
    world.follow_slots("rates or time-outs are as they were saved")


def _compare(given: Set[str], needed: Set[str]) -> None:
    if given != needed:
        raise ValueError(f'it has other vehicles or components, such as "{min(given ^ needed)[:80]}"')


def _typed(part: Part, state: Any, checked: bool = True) -> Any:
    if isinstance(state, Raw):
        state = msgpack.decode(state, type=part.state_type)
    elif type(state) is not part.state_type:
        raise ValueError(f'"{part.path}" is missing, or of another kind')
    if not checked:
        part.check(state)
    return state


def _refused(text: str) -> Refused:
    return Refused("bad_argument", text)
