"""States in pieces: `world/save` and `world/load`."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable
from typing import Any

import pytest

from uwserver.ports import Call, Refused, Reply
from uwserver.world.state import snapshot
from uwserver.world.state.saving import MAX_KEPT, in_one_piece
from uwserver.world.world import World


def fetched(world: World, length: int = 1000) -> bytes:
    """A state, piece by piece, while the world goes on."""
    answer: Any = world.call("world/save", length=length)
    data = base64.b64decode(answer["data"])
    while len(data) < answer["bytes"]:
        world.step()
        piece: Any = world.call("world/save", offset=len(data), length=length, sha256=answer["sha256"])
        assert piece["offset"] == len(data)
        data += base64.b64decode(piece["data"])
    assert hashlib.sha256(data).hexdigest() == answer["sha256"]
    return data


def given(world: World, data: bytes, length: int = 1000) -> Any:
    answer: Any = None
    for offset in range(0, len(data), length):
        piece = base64.b64encode(data[offset : offset + length]).decode()
        digest = hashlib.sha256(data).hexdigest()
        answer = world.call("world/load", data=piece, offset=offset, bytes=len(data), sha256=digest)
        assert "tick" in answer or answer["received"] == offset + length
    return answer


def refusal(world: World, service: str, **args: object) -> str:
    with pytest.raises(Refused) as caught:
        world.call(service, **args)
    return caught.value.fault.text


def test_in_pieces_out_and_in(make_world: Callable[..., World]) -> None:
    world, other = make_world(), make_world()
    world.step(100)
    digest = snapshot.take(world).hash()
    data = fetched(world)
    assert given(other, data) == {"tick": 100, "t_ns": other.t_ns}
    assert snapshot.take(other).hash() == digest


def test_in_one_piece(make_world: Callable[..., World]) -> None:
    world, other = make_world(), make_world()
    world.step(100)
    answer: Any = world.call("world/save")
    assert len(base64.b64decode(answer["data"])) == answer["bytes"]
    other.call("world/load", **in_one_piece(base64.b64decode(answer["data"])))
    assert snapshot.take(other) == snapshot.take(world)


def test_all_clients_are_told(world: World) -> None:
    data = fetched(world)
    world.step(50)
    world.submit(Call("world/load", in_one_piece(data), "test"))
    events = world.flush().events
    assert [event.event for event in events] == ["reset"]
    assert "saved state of tick 0" in events[0].text


def test_a_state_of_a_lost_sha_or_a_hole_between_pieces_is_refused(world: World) -> None:
    assert "begin again" in refusal(world, "world/save", offset=10, sha256="00")
    data = fetched(world)
    half = base64.b64encode(data[:500]).decode()
    rest = {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    assert "offset 0, not 500" in refusal(world, "world/load", data=half, offset=500, **rest)
    world.call("world/load", data=half, **rest)
    assert "offset 500, not 400" in refusal(world, "world/load", data=half, offset=400, **rest)
    world.call("world/load", data=base64.b64encode(data[500:]).decode(), offset=500, **rest)


@pytest.mark.parametrize(
    ("args", "text"),
    [
        ({"data": "?"}, "base64"),
        ({"data": ""}, "sha256 of the whole"),
        ({"data": "", "bytes": 4, "sha256": "00"}, "sha256 of the whole"),
        ({"data": "AAAAAAAA", "bytes": 4, "sha256": "0" * 64}, "more than the 4 bytes"),
        ({"data": "AAAA", "bytes": 3, "sha256": "0" * 64}, "do not add up"),
        ({"data": "AAAA", "bytes": 2**25, "sha256": "0" * 64}, "at most"),
        ({"name": "x"}, "state_folder"),
    ],
)
def test_wrong_pieces_are_refused(world: World, args: dict[str, object], text: str) -> None:
    world.step(10)
    before = snapshot.take(world).hash()
    assert text in refusal(world, "world/load", **args)
    assert snapshot.take(world).hash() == before


def test_a_bad_state_in_good_pieces_is_refused(world: World) -> None:
    assert "check sum" in refusal(world, "world/load", **in_one_piece(b"x" * 100))


def test_few_are_kept_at_once(world: World) -> None:
    """So memory is bounded whatever clients begin."""
    digests: list[str] = []
    for _ in range(MAX_KEPT + 1):
        world.step()
        answer: Any = world.call("world/save", length=10)
        digests.append(answer["sha256"])
    assert "begin again" in refusal(world, "world/save", offset=10, sha256=digests[0])
    world.call("world/save", offset=10, sha256=digests[1])


def test_an_upload_that_was_left_makes_room_for_others(make_world: Callable[..., World]) -> None:
    world = make_world()
    data, size = fetched(world), 9 * 2**20
    piece = base64.b64encode(bytes(8 * 2**20)).decode()
    for digest in ("1" * 64, "2" * 64, "3" * 64):
        assert world.call("world/load", data=piece, bytes=size, sha256=digest) == {"received": 8 * 2**20}
    assert "offset 0, not" in refusal(world, "world/load", data="AAAA", offset=8 * 2**20, bytes=size, sha256="1" * 64)
    assert given(world, data)["tick"] == 0


def test_a_load_is_one_request_with_one_reply(world: World) -> None:
    data = fetched(world)
    replies: list[Any] = []
    world.submit(Call("world/load", in_one_piece(data), "test"), replies.append)
    for on_reply, reply in world.advance().replies:
        on_reply(reply)
    (reply,) = replies
    assert isinstance(reply, Reply)
    assert reply.fault is None
    assert world.tick == 1, "the tick in which it was carried out goes on from the state"
