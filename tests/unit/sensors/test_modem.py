"""The inbox of a modem: messages are told one a reading, when they have come, and the oldest is lost where nobody fetches them."""

from __future__ import annotations

import pytest
from modem_rig import modem
from msgspec import msgpack

from uwserver.sensors import Pose
from uwserver.sensors.modem import MOST_INBOX, ModemMemory, ModemReport, Waiting


def device(**keys):
    return modem(1, **keys).build(Pose())


def message(k, over=1.0):
    return ModemReport("data", 2, 1, bytes([k % 256]), over - 0.25, over)


def test_messages_are_told_in_their_order_when_they_have_come(scope):
    sensor = device(processing_s=0.125)
    for k, over in enumerate((1.0, 1.0, 2.0)):
        sensor.tell(message(k, over))
    assert sensor.wake == 1.0
    assert sensor.sense(scope(t_ns=10**9 - 1000)) is None
    first = sensor.sense(scope(t_ns=10**9 + 4_000_000))
    assert (first.values[3].data, first.since_ns, first.delay_ns) == (b"\0", 254_000_000, 375_000_000)
    assert sensor.sense(scope(t_ns=10**9)).values[3].data == b"\1"
    assert sensor.sense(scope(t_ns=10**9)) is None
    assert sensor.wake == 2.0


def test_a_full_inbox_loses_the_oldest():
    sensor = device()
    for k in range(MOST_INBOX + 3):
        sensor.tell(message(k))
    assert len(sensor.memory.inbox) == MOST_INBOX
    assert sensor.memory.inbox[0].data == b"\3"
    assert sensor.properties()["counts"]["dropped"] == 3


def test_how_long_a_packet_is():
    assert device(overhead_s=0.5, bits_per_s=80.0).duration(bytes(10)) == pytest.approx(1.5)
    assert device(bits_per_s=64.0, fixed_bytes=8).duration(b"x") == pytest.approx(1.0)


def test_addresses():
    sensor = device(broadcast_address=0)
    assert [sensor.is_for_me(k) for k in (0, 1, 2)] == [True, True, False]
    sensor.change({"address": 2})
    assert [sensor.is_for_me(k) for k in (0, 1, 2)] == [True, False, True]


def test_a_memory_from_outside_keeps_its_limits():
    memory = ModemMemory(inbox=(message(1),))
    device().valid(memory)
    assert msgpack.decode(msgpack.encode(memory), type=ModemMemory) == memory
    raw = msgpack.encode({"waiting": [{"message": {"id": 1, "destination": 10**9}, "over": 1.0, "until": 2.0}]})
    with pytest.raises(ValueError, match="65535"):
        msgpack.decode(raw, type=ModemMemory)
    assert Waiting.__struct_fields__ == ("message", "over", "until")
