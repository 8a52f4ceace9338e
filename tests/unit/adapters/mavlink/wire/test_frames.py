"""Frames: a table of bytes both ways, garbage, truncation; pymavlink as the other codec."""

from __future__ import annotations

import math

import numpy as np
import pytest
from uwserver_adapters.mavlink.wire.dialect import Dialect
from uwserver_adapters.mavlink.wire.frames import Decoder, Frame, Malformed, pack

from uwserver.testing.codecs import CodecCase, check_codec, read_all

pymavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")

DIALECT = Dialect()
HEARTBEAT = bytes.fromhex("fd 09 00 00 00 01 01 00 00 00 13 00 00 00 0c 03 51 03 03 7a a5")
"""A submarine of ArduSub in MANUAL, sequence 0, from 1/1."""
HEARTBEAT_1 = bytes.fromhex("fe 09 00 ff be 00 00 00 00 00 06 08 00 00 03 e1 0c")
"""MAVLink 1, from a ground station."""


def frames(data: bytes) -> list[Frame]:
    return [event for event in read_all(Decoder(DIALECT), [data], None) if isinstance(event, Frame)]


def crc_right(data: bytes) -> bytes:
    """The bytes with the checksum that pymavlink computes."""
    head = 10 if data[0] == 0xFD else 6
    crc = pymavlink.x25crc(data[1 : head + data[1]])
    crc.accumulate(bytes((50,)))
    return data[: head + data[1]] + crc.crc.to_bytes(2, "little")


def test_the_table():
    heartbeat, old = crc_right(HEARTBEAT), crc_right(HEARTBEAT_1)
    payload = heartbeat[10:19]
    assert pymavlink.MAVLink(None).parse_buffer(heartbeat)[0].type == 12
    assert pymavlink.MAVLink(None).parse_buffer(old)[0].type == 6
    cases = [
        CodecCase("heartbeat", heartbeat, (Frame(heartbeat, 2, 0, 1, 1, 0, payload),), lambda _: pack(DIALECT, 0, payload, 0, 1, 1)),
        CodecCase("version 1", old, (Frame(old, 1, 0, 255, 190, 0, old[6:15]),)),
    ]  # fmt: skip
    garbage = (b"\x00" * 50, b"\r\n\r\n", bytes(range(0xFD)), b"\xfd", b"\xfe\x00")
    check_codec(lambda: Decoder(DIALECT), cases, need_data=None, garbage=garbage)


@pytest.mark.parametrize("junk", [b"\x00", b"hello world", bytes(range(0xFD)) * 3])
def test_it_finds_the_next_frame_after_garbage(junk):
    good = crc_right(HEARTBEAT)
    events = read_all(Decoder(DIALECT), [junk + good], None)
    assert events == [Malformed("garbage", len(junk)), Frame(good, 2, 0, 1, 1, 0, good[10:19])]


def test_a_lost_byte_costs_one_frame():
    good = crc_right(HEARTBEAT)
    for lost in range(1, len(good)):
        broken = good[:lost] + good[lost + 1 :]
        assert len(frames(broken + good * 15)) >= 14, lost


@pytest.mark.parametrize("place", range(1, 21))
def test_a_flipped_bit_is_seen(place):
    good = crc_right(HEARTBEAT)
    for bit in range(8):
        broken = bytearray(good)
        broken[place] ^= 1 << bit
        found = frames(bytes(broken) + good * 14)
        assert bytes(broken) not in [frame.raw for frame in found]


def test_what_is_unknown_or_incompatible_is_told():
    strange = bytes.fromhex("fd 01 00 00 00 01 01 ff ff ff 00 00 00")
    newer = bytes.fromhex("fd 01 80 00 00 01 01 00 00 00 00 00 00")
    assert read_all(Decoder(DIALECT), [strange], None) == [Malformed("unknown", 13)]
    assert {e.reason for e in read_all(Decoder(DIALECT), [newer], None)} == {"incompatible"}


def test_noise_costs_little_and_yields_nothing():
    rng = np.random.default_rng(1)
    for _ in range(20):
        noise = rng.integers(0, 256, 5000, np.uint8).tobytes() + bytes((0xFD,)) * 500
        assert not frames(noise)


def test_every_message_is_written_as_pymavlink_reads_it():
    rng = np.random.default_rng(2)
    parser = pymavlink.MAVLink(None)
    for id, definition in pymavlink.mavlink_map.items():
        layout = DIALECT.by_id[id]
        fields: dict[str, object] = {}
        for name, kind in zip(definition.fieldnames, definition.fieldtypes, strict=True):
            count = definition.array_lengths[definition.ordered_fieldnames.index(name)]
            if kind == "char" and count:
                fields[name] = bytes(rng.integers(65, 90, count, np.uint8))
            else:
                row = tuple(
                    float(x) if kind in ("float", "double") else int(x) for x in rng.integers(0, 100, max(1, count))
                )
                fields[name] = row if count else row[0]
        frame = pack(DIALECT, id, layout.encode(fields), 7, 3, 4)
        read = parser.parse_buffer(frame)[0]
        for name, value in fields.items():
            told = getattr(read, name)
            if isinstance(value, bytes):
                assert told.encode() == value, definition.msgname
            else:
                assert (tuple(told) if isinstance(value, tuple) else told) == value, (definition.msgname, name)
        (event,) = frames(frame)
        assert layout.decode(event.payload, 3, 4).fields == fields, definition.msgname


def test_values_are_kept_within_their_range():
    layout = DIALECT.by_name["GLOBAL_POSITION_INT"]
    fields = {"time_boot_ms": -5, "lat": 1e300, "lon": -math.inf, "alt": math.nan, "vx": 40_000, "hdg": 1.6}
    read = layout.decode(layout.encode(fields), 1, 1).fields
    assert read == {
        "time_boot_ms": 0, "lat": 2**31 - 1, "lon": -(2**31), "alt": 0, "relative_alt": 0, "vx": 32767, "vy": 0, "vz": 0, "hdg": 2,
    }  # fmt: skip
    attitude = DIALECT.by_name["ATTITUDE"]
    read = attitude.decode(attitude.encode({"roll": 1e300, "pitch": math.nan, "yaw": -math.inf}), 1, 1)
    assert read.number("roll") == pytest.approx(3.4028235e38)
    assert math.isnan(read.number("pitch"))
    assert read.number("yaw") == pytest.approx(-3.4028235e38)


def test_a_name_that_the_message_has_not_is_an_error():
    with pytest.raises(KeyError, match="rol"):
        DIALECT.by_name["ATTITUDE"].encode({"rol": 1.0})


def test_a_short_payload_is_filled_and_a_long_one_cut():
    layout = DIALECT.by_name["COMMAND_ACK"]
    assert layout.decode(b"\x90", 1, 1).fields["command"] == 0x90
    assert layout.decode(b"\x90\x01\x00" + b"\xff" * 200, 1, 1).fields["command"] == 0x190
