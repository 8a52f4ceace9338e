"""Signatures: pymavlink signs and checks on the other side; replays, old stamps and strangers are refused."""

from __future__ import annotations

import hashlib

import pytest
from uwserver_adapters.mavlink.wire.dialect import Dialect
from uwserver_adapters.mavlink.wire.frames import Decoder, Frame, pack
from uwserver_adapters.mavlink.wire.signing import STAMPS_PER_S, Signing, key_of

pymavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
DIALECT = Dialect()
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
