"""What a modem takes at its port, and what it tells who sends something else."""

from __future__ import annotations

import pytest
from modem_rig import listen, modem, world_of, world_with

from uwserver.ports import Refused
from uwserver.sensors import ModemTable
from uwserver.sensors.modem import MOST_QUEUE
from uwserver.world.state import snapshot

PLACES = {"a": (0.0, 0.0, 20.0), "b": (100.0, 0.0, 20.0)}


def told(world, **value):
    """What the sender is told: "" where nothing is wrong."""
    replies = []
    world.command("a/modem/send", **value)
    world.requests.posted[-1].on_reply = replies.append
    world.step()
    return "" if replies[0].fault is None else replies[0].fault.text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ({"data": b"x"}, ""),
        ({"destination": 2, "data": b"x"}, ""),
        ({"destination": 77, "data": b"nobody has it"}, ""),
        ({"destination": 255, "data": b"x"}, ""),
        ({"destination": 2, "acknowledge": 1}, ""),
        ({"destination": 1.5, "data": b"x"}, "needs a whole number as destination"),
        (
            {"destination": 101, "data": b"x"},
            "has addresses up to 100, and 255 for all: no modem can have the address 101",
        ),
        ({"data": b"x", "acknowledge": 1}, "ask one address"),
        ({"destination": 2}, "needs data, or acknowledge = 1"),
    ],
)
def test_what_it_takes(value, text):
    found = told(world_of(PLACES, highest_address=100), **value)
    assert text in found
    assert bool(text) == bool(found)


def test_a_payload_that_is_too_long_is_refused_before_it_is_sent():
    world = world_of(PLACES, max_bytes=8)
    with pytest.raises(Refused, match="has 9 bytes; at most 8 are allowed") as refused:
        world.command("a/modem/send", destination=2, data=b"123456789")
    assert refused.value.fault.code == "too_large"
    assert world.parts["world/modems"].save().packets == ()


def test_a_make_that_answers_nothing_says_so():
    assert "never answers" in told(world_of(PLACES, acknowledges=False), destination=2, data=b"x", acknowledge=1)


def test_two_senders_are_no_conflict():
    """Of other actuators the last command wins; of a modem each is sent."""
    world = world_of(PLACES)
    for source in ("one", "two"):
        world.command("a/modem/send", destination=2, data=b"x")
        posted = world.requests.posted[-1]
        world.requests.posted[-1] = type(posted)(type(posted.item)(posted.item.port, posted.item.value, source), None)
    output = world.advance()
    assert [event for event in output.events if event.event == "conflict"] == []
    world.step(240)
    assert world.call("b/modem/received/get")["counts"]["heard"] == 2


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"address": 5, "broadcast_address": 5}, "the one for all"),
        ({"address": 300, "highest_address": 299}, "the highest of this modem"),
    ],
)
def test_tables_that_cannot_be(keys, text):
    with pytest.raises(ValueError, match=text):
        modem(**({"address": 1} | keys))


def test_the_port_names_its_limits():
    table: ModemTable = modem(1, max_bytes=31, broadcast_address=0, highest_address=15)
    world = world_with(PLACES, {"a": table, "b": modem(2)})
    port = world.ports["a/modem/send"]
    assert port.direction == "actuator"
    assert {field.name: (field.maximum, field.max_bytes or None) for field in port.fields} == {
        "destination": (15.0, None), "data": (None, 31), "acknowledge": (1.0, None),
    }  # fmt: skip
    assert world.ports["a/modem/received"].fields[3].type == "bytes"


def test_busy_is_a_code_and_not_only_a_text():
    world = world_of(PLACES, queue=0, overhead_s=1.0)
    assert told(world, destination=2, data=b"x") == ""
    replies = []
    world.command("a/modem/send", destination=2, data=b"y")
    world.requests.posted[-1].on_reply = replies.append
    world.step()
    assert replies[0].fault.code == "busy"
    assert "is busy" in replies[0].fault.text


def test_a_make_without_addresses_sends_to_all_and_tells_no_sender():
    places = PLACES | {"c": (0.0, 100.0, 20.0)}
    keys = {"addressed": False, "acknowledges": False, "broadcast_address": 255}
    world = world_of(places, **keys)
    assert "without addresses, which sends to all: leave destination out" in told(world, destination=2, data=b"x")
    assert told(world, data=b"x") == ""
    heard = listen(world, 1.0)
    assert [(m.by, m.source, m.destination, m.data) for m in heard] == [("b", 255, 255, b"x"), ("c", 255, 255, b"x")]
    with pytest.raises(ValueError, match="acknowledges = true needs addressed = true"):
        modem(1, addressed=False)


def test_no_more_answers_are_waited_for_than_a_state_can_keep():
    """Of a quick modem whose answers are late."""
    world = world_of(PLACES, overhead_s=0.0, bits_per_s=1e6, max_range_m=1e5, queue=64)
    faults = [told(world, destination=9, data=b"x", acknowledge=1) for _ in range(MOST_QUEUE + 2)]
    assert faults[:MOST_QUEUE] == [""] * MOST_QUEUE
    assert all(f"{MOST_QUEUE} messages wait for their answers" in fault for fault in faults[MOST_QUEUE:])
    snapshot.from_bytes(world, snapshot.to_bytes(world, snapshot.take(world)))
    assert told(world, destination=9, data=b"x") == ""
