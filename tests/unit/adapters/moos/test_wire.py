"""The MOOS wire against bytes that pymoos 2022.1 and MOOSDB 10.5 exchanged, against a table packed by hand, and against garbage."""

from __future__ import annotations

import struct
import tracemalloc

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.wire import Decoder, Hello, Malformed, MoosMessage, Packet

from uwserver.testing import CodecCase, check_codec
from uwserver.testing.codecs import read_all

# -- recorded between pymoos 2022.1 (client "probe") and MOOSDB of core-moos 10.5 (community "tank") ------------------------------------

HELLO = bytes.fromhex("454c4b532043414e27542044414e434520322f382f3130000000000000000000")
NAME = bytes.fromhex(
    "50000000010000000047000000ffffffff69530000000000000000000000000c0000006173796e6368726f6e6f7573df19b34460c0da41000000000000f0bf"
    "000000000000f0bf0500000070726f6265"
)
WELCOME = bytes.fromhex(
    "5a000000010000000051000000ffffffff5744000000000b000000686f73746e616d653d766d0400000074616e6b000000001e8db94460c0da4100000000d8cc"
    "b93f000000000000f0bf0c0000006173796e6368726f6e6f7573"
)
TIMING_AND_REGISTER = bytes.fromhex(
    "90000000020000000043000000ffffffff54440000000000000000000000000d0000005f6173796e635f74696d696e6703edbf4460c0da410000000000000000"
    "000000000000f0bf00000000440000000000000052440500000070726f62650000000000000000090000004e41565f4445505448bbecbf4460c0da41000000"
    "000000e03f000000000000f0bf00000000"
)
TIMING_ECHO = bytes.fromhex(
    "4c000000010000000043000000ffffffff54440000000000000000000000000d0000005f6173796e635f74696d696e6703edbf4460c0da4152f3bf4460c0da41"
    "000000000000000000000000"
)
WILDCARD = bytes.fromhex(
    "7400000001000000006b000000010000002a530500000070726f626500000000000000000500000070726f6265baf5bf4460c0da41000000000000f0bf000000"
    "000000f0bf2b0000004170705061747465726e3d2a2c5661725061747465726e3d4e41565f2a2c496e74657276616c3d302e3235"
)
NOTIFICATIONS = bytes.fromhex(
    "d1000000030000000044000000020000004e440500000070726f62650000000000000000090000004e41565f4445505448882bd34460c0da410000000000000a"
    "40000000000000f0bf0000000043000000030000004e530500000070726f6265000000000000000004000000464c4147c72bd34460c0da41000000000000f0bf"
    "000000000000f0bf040000007472756541000000040000004e420500000070726f6265000000000000000004000000424c4f42d82bd34460c0da410000000000"
    "00f0bf000000000000f0bf0200000000ff"
)
DELIVERED = bytes.fromhex(
    "51000000010000000048000000020000004e440500000070726f6265000000000400000074616e6b090000004e41565f4445505448882bd34460c0da41000000"
    "0000000a40000000000000f0bf00000000"
)


def text(value: bytes) -> bytes:
    return struct.pack("<i", len(value)) + value


def packed(
    type: bytes, kind: bytes, id: int, key: bytes, time: float, number: float, data: bytes, src: bytes = b""
) -> bytes:
    """A packet of one message, packed by hand from the table in reference documents."""
    body = text(src) + text(b"") + text(b"") + text(key) + struct.pack("<ddd", time, number, -1.0) + text(data)
    message = struct.pack("<iicc", 10 + len(body), id, type, kind) + body
    return struct.pack("<iiB", 9 + len(message), 1, 0) + message


def number(data: bytes, at: int) -> float:
    return float(struct.unpack_from("<d", data, at)[0])


T0 = number(NAME, 47)
WRITTEN = number(NOTIFICATIONS, 48)

CASES = [
    ("name", NAME, (MoosMessage("i", "asynchronous", data=b"probe", kind="S", time=T0),)),
    (
        "welcome",
        WELCOME,
        (
            MoosMessage(
                "W", "", number(WELCOME, 58), b"asynchronous", src_aux="hostname=vm", community="tank",
                time=number(WELCOME, 50),
            ),
        ),
    ),
    (
        "timing and register",
        TIMING_AND_REGISTER,
        (
            MoosMessage("T", "_async_timing", 0.0, time=number(TIMING_AND_REGISTER, 48)),
            MoosMessage("R", "NAV_DEPTH", 0.5, src="probe", time=number(TIMING_AND_REGISTER, 116), id=0),
        ),
    ),
    (
        "timing echo",
        TIMING_ECHO,
        (MoosMessage("T", "_async_timing", number(TIMING_ECHO, 56), time=number(TIMING_ECHO, 48), number2=0.0),),
    ),
    (
        "wildcard",
        WILDCARD,
        (wire.MoosMessage("*", "probe", data=b"AppPattern=*,VarPattern=NAV_*,Interval=0.25", kind="S", src="probe",
                      time=number(WILDCARD, 45), id=1),),
    ),
    (
        "notifications",
        NOTIFICATIONS,
        (
            MoosMessage("N", "NAV_DEPTH", 3.25, src="probe", time=number(NOTIFICATIONS, 49), id=2),
            MoosMessage("N", "FLAG", data=b"true", kind="S", src="probe", time=number(NOTIFICATIONS, 112), id=3),
            MoosMessage("N", "BLOB", data=b"\x00\xff", kind="B", src="probe", time=number(NOTIFICATIONS, 179), id=4),
        ),
    ),
    (
        "delivered",
        DELIVERED,
        (MoosMessage("N", "NAV_DEPTH", 3.25, src="probe", community="tank", time=number(DELIVERED, 53), id=2),),
    ),
    ("unregister", packed(b"U", b"D", 7, b"X", 1.5, -1.0, b"", b"me"), (MoosMessage("U", "X", src="me", time=1.5, id=7),)),
    (
        "wildcard unregister",
        packed(b"/", b"S", 8, b"me", 1.5, -1.0, b"AppPattern=*,VarPattern=A?,Interval=0", b"me"),
        (MoosMessage("/", "me", data=b"AppPattern=*,VarPattern=A?,Interval=0", kind="S", src="me", time=1.5, id=8),),
    ),
    ("poison", packed(b"K", b"S", -1, b"", 2.0, -1.0, b"no"), (MoosMessage("K", "", data=b"no", kind="S", time=2.0),)),
    ("request", packed(b"Q", b"S", -2, b"ALL", 2.0, -1.0, b""), (MoosMessage("Q", "ALL", kind="S", time=2.0, id=-2),)),
    ("null", packed(b".", b"D", -1, b"", 0.0, 99.5, b""), (MoosMessage(".", "", 99.5),)),
    ("command", packed(b"C", b"S", -1, b"k", 0.0, -1.0, b"v"), (MoosMessage("C", "k", data=b"v", kind="S"),)),
    ("unknown type and kind", packed(b"\xfe", b"~", 1, b"k", 0.0, 0.0, b""), (MoosMessage("þ", "k", 0.0, kind="~", id=1),)),
    (
        "no UTF-8",
        packed(b"N", b"S", 1, b"k\xff", 0.0, -1.0, b"\xfe", b"\x80"),
        (MoosMessage("N", "k\udcff", data=b"\xfe", kind="S", src="\udc80", id=1),),
    ),
    ("no message", struct.pack("<iiB", 9, 0, 0), ()),
]  # fmt: skip


def case(name: str, data: bytes, messages: tuple[MoosMessage, ...]) -> CodecCase:
    return CodecCase(
        name, data, (Packet(messages),), lambda _: wire.packet([wire.encode(message) for message in messages])
    )


GARBAGE = [
    b"\xff" * 64,
    b"GET / HTTP/1.1\r\n\r\n",
    struct.pack("<iiB", 9, 1, 0),
    struct.pack("<iiB", 9, -1, 0),
    struct.pack("<iiB", 9, 0, 1),
    struct.pack("<iiB", 8, 0, 0),
    struct.pack("<iiB", -5, 0, 0),
    struct.pack("<iiB", 2**31 - 1, 2**31 - 1, 0),
    struct.pack("<iiB", 10, 0, 0) + b"x",
]


def test_table():
    check_codec(Decoder, [case(*row) for row in CASES], need_data=None, garbage=GARBAGE)


def test_hello_comes_first_from_a_client():
    events = (Hello(), Packet((MoosMessage("i", "asynchronous", data=b"probe", kind="S", time=T0),)))
    check_codec(
        lambda: Decoder(expects_hello=True),
        [CodecCase("hello", HELLO + NAME, events)],
        need_data=None,
        garbage=GARBAGE,
    )
    assert wire.HELLO == HELLO


@pytest.mark.parametrize("wrong", [b"ELKS CAN'T SWIM", b"x", b"\0" * 32, HELLO[:-1] + b"x"])
def test_a_wrong_hello_is_refused_at_its_first_wrong_byte(wrong):
    events = read_all(Decoder(expects_hello=True), [wrong[i : i + 1] for i in range(len(wrong))], None)
    assert [type(event) for event in events] == [Malformed]
    assert "ELKS CAN'T DANCE" in events[0].text


def mutated(at: int, value: int) -> bytes:
    data = bytearray(DELIVERED)
    struct.pack_into("<i", data, at, value)
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (mutated(0, 8), "its header alone has 9"),
        (mutated(0, wire.PACKET_LIMIT + 1), "the longest that is taken"),
        (mutated(4, -1), "-1 messages in a packet"),
        (mutated(4, 2), "2 messages in a packet of 81 bytes"),
        (mutated(4, 0), "72 bytes behind the last of 0 messages"),
        (DELIVERED[:8] + b"\1" + DELIVERED[9:], "a compressed packet"),
        (mutated(9, 10), "a message of 10 bytes"),
        (mutated(9, 5000), "a message of 5000 bytes in a packet with 72 left"),
        (mutated(19, 2**31 - 1), "a text of 2147483647 bytes in a message with"),
        (mutated(19, -1), "a text of -1 bytes"),
        (mutated(77, 1), "a text of 1 bytes in a message with 0 left"),
        (wire.packet([wire.encode(MoosMessage(wire.NULL, ""))] * (wire.MESSAGES_LIMIT + 1)), "the most that are taken"),
        (
            wire.packet([wire.encode(MoosMessage(wire.NOTIFY, "\udcff" * (wire.NAMES_LIMIT + 1)))]),
            "a name of 1025 bytes",
        ),
    ],
)
def test_each_fault_is_named_and_ends_the_connection(data, text):
    decoder = Decoder()
    events = read_all(decoder, [data, NAME], None)
    assert [type(event) for event in events] == [Malformed]
    assert text in events[0].text


def test_a_packet_of_many_messages_is_read_in_pieces():
    """So many a call, and one packet at the end: a fault in the last message leaves none of the others."""
    said = [wire.notify("A", float(k), 0.0, "x") for k in range(3 * wire.AT_ONCE + 1)]
    data = wire.packet([wire.encode(message) for message in said])
    decoder = Decoder()
    decoder.receive(data + NAME)
    events = [decoder.next_event() for _ in range(5)]
    assert events[:3] == [wire.Reading()] * 3
    assert events[3] == Packet(tuple(said))
    assert isinstance(events[4], Packet)
    broken = Decoder()
    broken.receive(data[:-1] + b"\xff")
    events = list(iter(broken.next_event, None))
    assert events[:-1] == [wire.Reading()] * 3
    assert isinstance(events[-1], Malformed)


def test_what_a_database_sends_may_be_long_and_many():
    """A client's decoder passes over what is too long, in pieces of any size, and counts no messages; what is no packet still ends it."""
    long = wire.packet([wire.encode(wire.notify("A", "x" * wire.PACKET_LIMIT, 0.0))])
    many = wire.packet([wire.encode(MoosMessage(wire.NULL, ""))] * (wire.MESSAGES_LIMIT + 1))
    decoder = Decoder(skips=True)
    found = []
    for start in range(0, len(long), 100_000):
        decoder.receive(long[start : start + 100_000] + (many + NAME if start + 100_000 >= len(long) else b""))
        found += [event for event in iter(decoder.next_event, None) if not isinstance(event, wire.Reading)]
    assert [type(event) for event in found] == [wire.Skipped, Packet, Packet]
    assert len(found[1].messages) == wire.MESSAGES_LIMIT + 1
    decoder.receive(struct.pack("<i", wire.SKIP_LIMIT + 1))
    assert isinstance(decoder.next_event(), Malformed)


def test_a_long_value_that_is_no_ascii_is_not_read_as_a_text():
    for data in (b"\xff" * wire.TEXT_LIMIT, b"x" * (1 << 20)):
        assert MoosMessage(wire.NOTIFY, "A", data=data, kind=wire.STRING).value == data.decode(
            "utf-8", "surrogateescape"
        )
    long = b"\xff" * (wire.TEXT_LIMIT + 1)
    assert MoosMessage(wire.NOTIFY, "A", data=long, kind=wire.STRING).value == long


def test_a_claimed_length_allocates_nothing():
    decoder = Decoder()
    tracemalloc.start()
    try:
        decoder.receive(struct.pack("<iiB", wire.PACKET_LIMIT, 1, 0) + b"x" * 100)
        assert decoder.next_event() is None
        decoder.receive(b"x")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 10_000


words = st.text(st.characters(exclude_categories=()), max_size=20)
messages = st.builds(
    MoosMessage,
    type=st.sampled_from("NRU*/iWKTQ.C^"),
    key=st.text(max_size=20),
    number=st.floats(allow_nan=False),
    data=st.binary(max_size=40),
    kind=st.sampled_from("DSB~"),
    src=st.text(max_size=20),
    src_aux=st.text(max_size=5),
    community=st.text(max_size=5),
    time=st.floats(allow_nan=False),
    number2=st.floats(allow_nan=False),
    id=st.integers(-(2**31), 2**31 - 1),
)


@settings(max_examples=50, deadline=None)
@given(st.lists(messages, max_size=4), st.integers(1, 64))
def test_what_is_written_is_read(said, step):
    data = wire.packet([wire.encode(message) for message in said])
    pieces = [data[i : i + step] for i in range(0, len(data), step)]
    assert read_all(Decoder(), pieces, None) == [Packet(tuple(said))]


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_bytes_changed_at_random_never_raise(data):
    base = bytearray(data.draw(st.sampled_from([row[1] for row in CASES])))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(base) - 1))
        base[at] = data.draw(st.integers(0, 255))
    events = read_all(Decoder(), [bytes(base)], None)
    assert all(isinstance(event, Packet | Malformed) for event in events)


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=200), st.booleans())
def test_any_bytes_never_raise(data, expects_hello):
    read_all(Decoder(expects_hello), [data], None)


@given(words)
@settings(max_examples=40, deadline=None)
def test_any_text_can_be_written(said):
    data = wire.packet([wire.encode(wire.notify(said, said, 0.0, src=said))])
    (event,) = read_all(Decoder(), [data], None)
    assert isinstance(event, Packet)


def test_notify_takes_its_kind_from_the_value():
    assert [wire.notify("X", value, 1.0).kind for value in (1.5, 2, "a", b"a")] == ["D", "D", "S", "B"]
    assert [wire.notify("X", value, 1.0).value for value in (1.5, "ä", b"\xff")] == [1.5, "ä", b"\xff"]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("AppPattern=*,VarPattern=NAV_*,Interval=0.25", ("NAV_*", "*", 0.25)),
        ("varpattern = A , apppattern=b", ("A", "b", 0.0)),
        ("AppPattern=*,VarPattern=X,Interval=nonsense", ("X", "*", 0.0)),
        ("AppPattern=*,VarPattern=X,Interval=-1", ("X", "*", 0.0)),
        ("AppPattern=*,VarPattern=X,Interval=inf", ("X", "*", 0.0)),
        ("", ("", "", 0.0)),
    ],
)
def test_wildcards_are_read_and_written(text, found):
    assert wire.wildcard_of(MoosMessage(wire.WILDCARD_REGISTER, "", data=text.encode())) == found
    made = wire.wildcard("*", "me", 1.0, "NAV_*", "p*", 0.5)
    assert wire.wildcard_of(made) == ("NAV_*", "p*", 0.5)


@pytest.mark.parametrize(
    "bad", [MoosMessage("", "k"), MoosMessage("NN", "k"), MoosMessage("N", "k", id=2**31), MoosMessage("€", "k")]
)
def test_what_cannot_be_written_says_so(bad):
    with pytest.raises(ValueError, match="cannot be written"):
        wire.encode(bad)
