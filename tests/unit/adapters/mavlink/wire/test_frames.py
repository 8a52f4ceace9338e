"""Frames: a table of bytes both ways, garbage, truncation; pymavlink as the other codec.

Signatures: pymavlink signs and checks on the other side; replays, old stamps and strangers are refused.
"""

from __future__ import annotations

import hashlib
import math

import numpy as np
import pytest
from uwserver_adapters.mavlink.wire.dialect import Dialect
from uwserver_adapters.mavlink.wire.frames import STAMPS_PER_S, Decoder, Frame, Malformed, Signing, key_of, pack

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


KEY = bytes(range(32))
NOW = 10**13


def station(stamp: int = NOW, link: int = 3) -> pymavlink.MAVLink:
    mav = pymavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    mav.signing.secret_key = KEY
    mav.signing.link_id = link
    mav.signing.timestamp = stamp
    mav.signing.sign_outgoing = True
    return mav


def heartbeat(mav: pymavlink.MAVLink) -> Frame:
    decoder = Decoder(DIALECT)
    decoder.receive(pymavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(mav))
    frame = decoder.next_event()
    assert isinstance(frame, Frame)
    assert decoder.next_event() is None
    return frame


def test_pymavlink_accepts_ours():
    ours, mav = Signing(KEY, lambda: NOW), station()
    for _ in range(3):
        frame = ours.sign(pack(DIALECT, 0, b"\x01", 0, 1, 1, is_signed=True), 9)
        (message,) = mav.parse_buffer(frame)
        assert message.get_signed()
    assert (mav.signing.goodsig_count, mav.signing.badsig_count) == (3, 0)


def test_ours_accepts_pymavlink_once():
    ours, mav = Signing(KEY, lambda: NOW), station()
    frame = heartbeat(mav)
    assert ours.refusal(frame) == ""
    assert ours.refusal(frame) == "replayed"
    assert ours.refusal(heartbeat(mav)) == ""
    assert ours.refusal(heartbeat(station(NOW, link=4))) == ""


def test_strangers_are_refused():
    ours = Signing(KEY, lambda: NOW)
    plain = pymavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    assert ours.refusal(heartbeat(plain)) == "unsigned"
    wrong = station()
    wrong.signing.secret_key = bytes(32)
    assert ours.refusal(heartbeat(wrong)) == "signature"
    assert ours.refusal(heartbeat(station())) == ""  # a forged frame has not moved the stamps


def test_a_new_sender_may_be_a_minute_behind():
    ours = Signing(KEY, lambda: NOW)
    assert ours.refusal(heartbeat(station(NOW - 59 * STAMPS_PER_S))) == ""
    assert ours.refusal(heartbeat(station(NOW - 61 * STAMPS_PER_S, link=5))) == "stale"


def test_stamps_rise_though_the_clock_falls():
    clock = iter((NOW, NOW - 5, NOW + 7, NOW))
    ours = Signing(KEY, lambda: next(clock))
    stamps = [
        int.from_bytes(ours.sign(pack(DIALECT, 0, b"\x01", 0, 1, 1, True), 0)[-12:-6], "little") for _ in range(4)
    ]
    assert stamps == [NOW, NOW + 1, NOW + 7, NOW + 8]


def test_the_key_of_a_passphrase():
    assert key_of("deep blue") == hashlib.sha256(b"deep blue").digest()


async def test_a_hub_with_a_key(make_bench):
    bench = make_bench(passphrase="deep blue")
    signed, stranger = bench.station(), bench.station(254)
    signed.mav.signing.secret_key = key_of("deep blue")
    signed.mav.signing.timestamp = (1_750_000_000 - 1_420_070_400) * 100_000
    signed.mav.signing.sign_outgoing = True
    assert await signed.command(400, 1.0) == 0
    bench.rov.state["armed"] = False
    stranger.send("COMMAND_LONG", 1, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0)
    data = signed.bytes_of("COMMAND_LONG", 1, 1, 400, 0, 0.0, 0, 0, 0, 0, 0, 0)
    bench.router.receive(signed.channel, data)
    bench.router.receive(signed.channel, data)
    assert not bench.rov.state["armed"]
    assert (bench.counters["signing_unsigned"], bench.counters["signing_replayed"]) == (1, 1)
    bench.run(1.1)
    assert signed.last("HEARTBEAT").get_signed()


async def test_signing_is_set_up_by_a_message_when_disarmed(bench):
    station, other = bench.station(), bench.station(254)
    bench.rov.state["armed"] = True
    station.send("SETUP_SIGNING", 1, 1, list(KEY), 5)
    assert any("armed" in text for text in station.texts())
    bench.run(0.1)
    bench.rov.state["armed"] = False
    bench.run(0.1)
    station.send("SETUP_SIGNING", 1, 1, list(KEY), 5)
    assert not other.of("SETUP_SIGNING")
    station.heard.clear()
    bench.run(1.1)
    assert all(message._msgbuf[2] & 1 for message in station.of("HEARTBEAT"))
    assert await station.command(400, 1.0) is None


async def test_radio_status_needs_no_signature(make_bench):
    bench = make_bench(passphrase="deep blue")
    bench.station(51, 68).send("RADIO_STATUS", 1, 1, 1, 1, 1, 1, 1)
    assert not bench.counters["signing_unsigned"]
