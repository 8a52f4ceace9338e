"""Lines of text: the grammar without sockets, then users on TCP and on a pseudo-terminal."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import pty
import re
import tracemalloc
from collections.abc import AsyncIterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from uwserver_adapters.moos import MoosTextAdapter
from uwserver_adapters.moos.bridge.bridge import CALLS_PER_S
from uwserver_adapters.moos.config import BridgeTable, MoosTextConfig, NavTable, Target
from uwserver_adapters.moos.db import database
from uwserver_adapters.moos.text import lines, session
from uwserver_adapters.moos.text.adapter import TextConnection
from uwserver_adapters.moos.text.lines import LineDecoder, Malformed, Verb, Write

from uwserver.ports import Sample
from uwserver.testing import CodecCase, check_codec
from uwserver.testing.codecs import read_all

POSE = Sample("auv/truth/pose", 0, 0, 0, True, ((10.0, 20.0, 5.0), (1.0, 0.0, 0.0, 0.0)))

LINES = [
    ("number", b"NAV_DEPTH=3.2\n", Write((("NAV_DEPTH", 3.2),))),
    ("signs and exponents", b"A=-1 B=+2. C=.5 D=1e-3\n", Write((("A", -1.0), ("B", 2.0), ("C", 0.5), ("D", 1e-3)))),
    ("separators", b" A=1,B=2;C=3 , D=4,\r\n", Write((("A", 1.0), ("B", 2.0), ("C", 3.0), ("D", 4.0)))),
    ("words are texts", b"MODE=true X=0x10 Y=nan Z=1.2.3\n", Write((("MODE", "true"), ("X", "0x10"), ("Y", "nan"), ("Z", "1.2.3")))),
    ("quotes", b'USM_RESET="x=1, y=2" N="3.5" E=""\n', Write((("USM_RESET", "x=1, y=2"), ("N", "3.5"), ("E", "")))),
    ("escapes", rb'T="a\"b\\c\n\u00e4" U=1' + b"\n", Write((("T", 'a"b\\c\nä'), ("U", 1.0)))),
    ("equal signs in a quoted text", b'DRIFT="x=1"\n', Write((("DRIFT", "x=1"),))),
    ("UTF-8", "NAMÉ=é\n".encode(), Write((("NAMÉ", "é"),))),
    ("tag", b"#7 NAV_X=1\n", Write((("NAV_X", 1.0),), "7")),
    ("verbs in any case", b"subscribe NAV_* 5\n", Verb("SUBSCRIBE", "NAV_* 5")),
    ("tagged verb", b"#a/b CALL world/step {\"n\": 1}\n", Verb("CALL", 'world/step {"n": 1}', "a/b")),
    ("no number is so long", b"A=" + b"1" * 65 + b"\n", Write((("A", "1" * 65),))),
    ("a variable may be called as a verb", b"LIST=1\n", Write((("LIST", 1.0),))),
]  # fmt: skip
BAD = [
    (b"NAV_X\n", "is neither NAME=value nor one of SUBSCRIBE"),
    (b"=5\n", "is neither NAME=value"),
    (b"A=\n", 'a value is missing: write ""'),
    (b'A="open\n', "a quoted text that does not end"),
    (b'A="x"B=1\n', "separate pairs by spaces"),
    (rb'A="\q"' + b"\n", "quote as in JSON"),
    (b"A=1 nonsense\n", '"nonsense" is neither'),
    (b"USM_RESET=x=0,y=-20\n", 'quote a text with such or with "=" in it'),
    (b"USM_RESET=0,-20\n", '"-20" is neither'),
    (b"A=1e999\n", "1e999 is too large"),
    (b"A=\xff\n", "no UTF-8 at byte 2"),
    (b"#7\n", "nothing behind the tag"),
    (b"x" * 300 + b"=1\n", "is neither NAME=value"),
    (b"A=1 " * 257 + b"\n", "a line writes at most 256 variables"),
]


def test_table():
    cases = [CodecCase(name, data, (event,)) for name, data, event in LINES]
    blank = CodecCase("blank lines", b"\r\n  \n\nGET A\n", (Verb("GET", "A"),))
    check_codec(LineDecoder, [*cases, blank], need_data=None, garbage=[row[0] for row in BAD], resynchronises=True)


@pytest.mark.parametrize(("line", "why"), BAD)
def test_a_bad_line_says_why(line, why):
    (event,) = read_all(LineDecoder(), [line], None)
    assert isinstance(event, Malformed)
    assert event.code == "parse_error"
    assert why in event.text


def test_the_tag_of_a_bad_line_is_kept():
    (event,) = read_all(LineDecoder(), [b"#7 nonsense\n"], None)
    assert (type(event), event.tag) == (Malformed, "7")


def test_a_line_of_10_mb_costs_no_memory_and_is_told_once():
    decoder = LineDecoder()
    tracemalloc.start()
    events = []
    for _ in range(160):
        decoder.receive(b"x" * (1 << 16))
        while (event := decoder.next_event()) is not None:
            events.append(event)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert [event.code for event in events] == ["too_large"]
    assert peak < 1 << 19
    assert read_all(decoder, [b"x\nGET A\n"], None) == [Verb("GET", "A")]


def test_a_long_line_in_one_piece_is_told_too():
    events = read_all(LineDecoder(100), [b"x" * 200 + b"\nGET A\n"], None)
    assert [type(event) for event in events] == [Malformed, Verb]


names = st.from_regex(r"[A-Za-z_*?/.-][^\s=,;\"#\ud800-\udfff]{0,20}", fullmatch=True)
values = st.one_of(st.floats(allow_nan=False, allow_infinity=False), st.text(st.characters(exclude_categories=("Cs",))))


@settings(max_examples=60, deadline=None)
@given(names, values)
def test_what_is_told_can_be_said_back(name, value):
    line = lines.pair_line(name, value)
    assert "\n" not in line
    (event,) = read_all(LineDecoder(), [line.encode() + b"\n"], None)
    if isinstance(event, Write):  # a name may be a verb
        assert event.pairs == ((name, value),)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.binary(max_size=60), max_size=5))
def test_any_bytes_never_raise(pieces):
    read_all(LineDecoder(50), pieces, None)


@given(st.floats(allow_nan=False, allow_infinity=False, width=32))
def test_a_binary_value_is_told_by_its_size(number):
    assert lines.pair_line("A", b"\x00\xff") == 'A="<binary> 2 bytes"'
    assert re.fullmatch(r"A=-?[\d.e+-]+", lines.pair_line("A", number))


# -- users ------------------------------------------------------------------------------------------------------------------------------


class User:
    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    def say(self, *lines: str) -> None:
        self.writer.write("".join(f"{line}\n" for line in lines).encode())

    async def line(self) -> str:
        return (await asyncio.wait_for(self.reader.readline(), 60.0)).decode().rstrip("\r\n")

    async def ask(self, line: str) -> str:
        self.say(line)
        return await self.line()

    async def until(self, start: str) -> list[str]:
        """Lines up to one with this start."""
        lines = [await self.line()]
        while not lines[-1].startswith(start):
            assert lines[-1], lines
            lines.append(await self.line())
        return lines


@pytest.fixture
def bridge(make_auv, serve):
    @contextlib.asynccontextmanager
    async def make(users: int = 1, **config: object) -> AsyncIterator[tuple]:
        table = BridgeTable(
            nav=NavTable(), commands={"DESIRED_THRUST": (Target(port="propeller", field="u", full=1.0),)}
        )
        adapter = MoosTextAdapter(MoosTextConfig(**{"port": 0, "bridge": table, **config}), make_auv())
        async with serve(adapter) as context:
            host, port = context.stats.address.split(":")
            made = [User(*await asyncio.open_connection(host, int(port))) for _ in range(users)]
            yield (context, *made)
            for user in made:
                user.writer.close()

    return make


async def test_hear_and_drive(bridge, until):
    async with bridge() as (context, user):
        assert await user.ask("SUBSCRIBE NAV_D*") == "OK SUBSCRIBE NAV_D*"
        context.put([POSE])
        assert await user.line() == "NAV_DEPTH=5.0"
        user.say("DESIRED_THRUST=40")
        await until(lambda: context.commands, "a command")
        assert [(c.port, c.value) for c in context.commands] == [("auv/propeller", ((0.4,),))]
        assert await user.ask("#1 DESIRED_THRUST=41") == "#1 OK"


async def test_two_users_talk_and_hear_both(bridge):
    async with bridge(2) as (_, a, b):
        await b.ask("subscribe CHAT")
        a.say('CHAT="hello, you"')
        assert await b.line() == 'CHAT="hello, you"'
        assert await b.ask("UNSUBSCRIBE CHAT") == "OK UNSUBSCRIBE CHAT"
        a.say("CHAT=again")
        assert await a.ask("GET CHAT") == 'CHAT="again"'
        assert await b.ask("#9 HELLO=1") == "#9 OK"


async def test_a_late_subscriber_hears_the_last_value(bridge):
    async with bridge() as (context, user):
        context.put([POSE])
        await user.ask("SUBSCRIBE NAV_X 5")
        assert await user.line() == "NAV_X=20.0"


async def test_rates(bridge):
    async with bridge() as (context, user):
        await user.ask("SUBSCRIBE NAV_X 0.01")
        for _ in range(50):
            context.put([POSE])
        assert await user.line() == "NAV_X=20.0"
        assert await user.ask("#end X=1") == "#end OK"


async def test_get_and_list(bridge):
    async with bridge() as (context, user):
        context.put([POSE])
        user.say("#1 GET NAV_X", "#2 GET NOTHING", "#3 LIST NAV_X*", "#4 LIST NOTHING", "LIST")
        assert [await user.line() for _ in range(6)] == [
            "NAV_X=20.0", "#1 OK 1", '#2 ERROR bad_argument nobody has written "NOTHING"; LIST shows what there is',
            "NAV_X=20.0", "#3 OK 1", "#4 OK 0",
        ]  # fmt: skip
        lines = await user.until("OK")
        assert 'SIMULATION_MODE="TRUE"' in lines
        assert lines[-1] == f"OK {len(lines) - 1}"


async def test_calls(bridge):
    async with bridge() as (_, user):
        assert await user.ask('#1 CALL world/echo {"value": [1, null, "a"]}') == '#1 OK [1,null,"a"]'
        assert (await user.ask("#2 CALL world/nothing")).startswith("#2 ERROR unknown_service no service")
        assert (await user.ask("#3 CALL world/echo {")).startswith("#3 ERROR parse_error")
        assert (await user.ask("CALL")).startswith("ERROR invalid_request")
        assert json.loads((await user.ask("CALL world/status")).removeprefix("OK "))["mode"] == "realtime"


async def test_a_flood_of_calls_is_bounded_and_every_line_answered(bridge):
    async with bridge(2) as (context, flood, other):
        flood.say(*(f"#{number} CALL world/echo" for number in range(500)))
        answers = [await flood.line() for _ in range(500)]
        refused = [line for line in answers if "ERROR overload" in line]
        assert {line.split()[0] for line in answers} == {f"#{number}" for number in range(500)}
        assert len(refused) >= 500 - 2 * CALLS_PER_S  # the flood may fall into two windows
        assert await other.ask("#1 CALL world/echo") == "#1 OK null"
        assert len(context.calls) <= 2 * CALLS_PER_S + 20


async def test_refusals_go_to_who_asked(bridge):
    async with bridge(2) as (_, a, b):
        a.say('DESIRED_THRUST="fast"')
        assert (await a.line()).startswith("ERROR bad_argument DESIRED_THRUST:")
        assert (
            await a.ask("#1 SIMULATION_MODE=5")
        ) == "#1 ERROR bad_argument SIMULATION_MODE: a write as double, its type is string"
        assert await b.ask("#2 X=1") == "#2 OK"


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("nonsense", "ERROR parse_error"),
        ("SUBSCRIBE", "ERROR invalid_request write SUBSCRIBE"),
        ("SUBSCRIBE A 1 2", "ERROR invalid_request"),
        ("SUBSCRIBE A fast", "ERROR bad_argument"),
        ("SUBSCRIBE A 0", "ERROR bad_argument the rate"),
        ("#3 SUBSCRIBE A nan", "#3 ERROR bad_argument"),
        ("UNSUBSCRIBE", "ERROR invalid_request"),
        ("GET", "ERROR invalid_request"),
        ("#4 SUBSCRIBE " + "*" * 300, "#4 ERROR bad_argument a pattern has at most 256"),
        ("x" * 100_000, "ERROR too_large"),
    ],
)
async def test_a_bad_line_is_answered_and_the_next_one_works(bridge, line, answer):
    async with bridge() as (context, user):
        assert (await user.ask(line)).startswith(answer)
        assert await user.ask("#1 X=1") == "#1 OK"
        assert context.stats.errors == 1


@pytest.fixture
def steps(monkeypatch):
    """How many lines each step of a user makes, and how many names it compares with a pattern. Each step is a turn."""
    made: list[tuple[int, int]] = []
    compared: list[int] = []
    step, fits = TextConnection.step, database.fits

    def measured(self: TextConnection) -> bool:
        lines, before = len(self._lines), len(compared)
        more = step(self)
        made.append((len(self._lines) - lines, len(compared) - before))
        return more

    monkeypatch.setattr("uwserver.adapter.connection.TURN_S", 0.0)
    monkeypatch.setattr("uwserver.adapter.connection.REST_S", 0.0)
    monkeypatch.setattr(TextConnection, "step", measured)
    monkeypatch.setattr(database, "fits", lambda *names: (compared.append(1), fits(*names))[1])
    return made


async def _fill(user, variables: int, size: int = 0) -> None:
    for at in range(0, variables, 100):
        pairs = " ".join(f'V{n}="{n:0{size}}"' if size else f"V{n}={n}" for n in range(at, at + 100))
        assert await user.ask(f"#w {pairs}") == "#w OK"


@pytest.mark.parametrize("line", ["LIST", "GET V*", "SUBSCRIBE V*", "UNSUBSCRIBE V*"])
async def test_what_looks_at_all_variables_lets_others_have_their_turn(bridge, steps, line):
    """Twenty thousand of them took one line forty milliseconds of the loop."""
    async with bridge(1) as (_, user):
        await _fill(user, 3000)
        if line.startswith("UNSUB"):
            await user.ask("SUBSCRIBE V*")
            user.say("#s X=1")
            await user.until("#s OK")
        steps.clear()
        user.say(line, "#end X=1")
        lines = await user.until("#end OK")
        if not line.startswith("UNSUB"):
            assert sum(line.startswith("V") for line in lines) == 3000
        assert max(lines for lines, _ in steps) <= database.PIECE // database.DELIVERED
        assert len(steps) >= 3000 * database.DELIVERED // database.PIECE


async def test_new_variables_that_many_look_for_are_few_in_a_step(bridge, steps):
    """A line of 256 names, each compared with the patterns of all users: 160 ms."""
    async with bridge(2) as (_, user, other):
        for n in range(200):
            await other.ask(f"SUBSCRIBE A*B{n}")
        steps.clear()
        user.say("#w " + " ".join(f"A{n}=1" for n in range(256)))
        assert await user.line() == "#w OK"
        assert sum(names for _, names in steps) >= 256 * 200
        assert max(names for _, names in steps) <= session.SPENT


async def test_a_listing_waits_for_who_does_not_read(bridge, monkeypatch):
    most = [0]
    write = TextConnection.write

    def measured(self: TextConnection, data: bytes) -> None:
        write(self, data)
        most[0] = max(most[0], self.waiting)

    monkeypatch.setattr(TextConnection, "write", measured)
    async with bridge(2, queue_bytes=1 << 18) as (_, slow, other):
        await _fill(other, 2000, 400)
        slow.writer.transport.pause_reading()
        slow.say(*["LIST V*"] * 10)
        for k in range(100):
            assert await other.ask(f"#{k} X=1") == f"#{k} OK"
        slow.writer.transport.resume_reading()
        lines = [line for _ in range(10) for line in await slow.until("OK 2000")]
        assert len(lines) == 20_010
        assert most[0] < 1 << 20


@pytest.mark.parametrize("verb", ["LIST", "GET"])
async def test_long_patterns_are_refused(bridge, verb):
    async with bridge() as (_, user):
        assert (await user.ask(f"#1 {verb} {'*a' * 200}")).startswith("#1 ERROR bad_argument a pattern has at most 256")


async def test_a_text_is_made_once_for_all_who_hear_it(bridge, monkeypatch):
    made = []
    pair_line = session.pair_line
    monkeypatch.setattr(session, "pair_line", lambda name, value: (made.append(name), pair_line(name, value))[1])
    async with bridge(5) as (_, *users):
        for user in users:
            await user.ask("SUBSCRIBE CHAT")
        users[0].say('CHAT="all"')
        for user in users:
            assert await user.line() == 'CHAT="all"'
        assert made == ["CHAT"]


async def test_help_and_quit(bridge):
    async with bridge() as (_, user):
        user.say("HELP")
        assert any(line.startswith("SUBSCRIBE NAV_*") for line in await user.until("OK"))
        assert await user.ask("QUIT") == "OK bye"
        assert await user.line() == ""


async def test_who_sends_and_only_listens_then_is_answered(bridge):
    """``echo ... | nc -N``: answers that come later than the end of input come too."""
    async with bridge() as (context, user):
        context.put([POSE])
        user.say("GET NAV_X", "CALL world/echo")
        user.writer.write_eof()
        data = await asyncio.wait_for(user.reader.read(), 60.0)
        assert data == b"NAV_X=20.0\nOK 1\nOK null\n"


async def test_too_many_users(bridge):
    async with bridge(2, max_clients=1) as (_, a, b):
        assert await a.ask("#1 X=1") == "#1 OK"
        b.say("X=2")
        assert (await b.line()).startswith("ERROR overload 1 clients are connected")
        assert await b.line() == ""
        assert await a.ask("GET X") == "X=1.0", "nothing of who has no place is obeyed"


async def test_who_says_nothing_valid_is_disconnected(bridge):
    async with bridge(3, first_line_s=0.2) as (_, known, silent, babbling):
        assert await known.ask("#1 X=1") == "#1 OK"
        babbling.say("what?")
        assert (await babbling.line()).startswith("ERROR parse_error")
        for user in (silent, babbling):
            assert (await user.line()).startswith("ERROR timeout nothing valid came within 0.2 s")
            assert await user.line() == ""
        assert await known.ask("#1 X=1") == "#1 OK"


async def test_who_does_not_read_is_disconnected(bridge, until):
    async with bridge(2, queue_bytes=50_000) as (context, sleeper, writer):
        await sleeper.ask("SUBSCRIBE BIG")
        sleeper.writer.transport.pause_reading()
        for k in range(2000):
            if context.stats.peers == 1:
                break
            assert await writer.ask(f"#{k} BIG={'x' * 20_000}") == f"#{k} OK"
        await until(lambda: context.stats.peers == 1, "the sleeper is still there")
        assert "too slowly" in context.stats.last_error


async def test_a_serial_line(bridge, until, monkeypatch):
    monkeypatch.setattr("uwserver_adapters.moos.db.local.TELL_S", 0.02)
    ours, theirs = pty.openpty()
    path = os.ttyname(theirs)

    def read() -> bytes:
        with contextlib.suppress(BlockingIOError):
            return os.read(ours, 4096)
        return b""

    os.set_blocking(ours, False)
    heard = bytearray()
    try:
        async with bridge(0, serial=path) as (context,):
            await until(lambda: context.stats.peers == 1, "the line is open")
            os.write(ours, b"#1 GET NAV_X\r\nSUBSCRIBE NAV_X\r\nDESIRED_THRUST=50\r\n")
            await until(lambda: heard.extend(read()) or b"NAV_X\r\n" in heard, "answers")
            context.put([POSE])
            await until(lambda: heard.extend(read()) or b"NAV_X=20.0\r\n" in heard, "a sample")
            assert heard.startswith(b"#1 ERROR bad_argument")
            await until(lambda: bool(context.commands), "the command")
            assert context.commands[-1].value == ((0.5,),)
            os.write(ours, b"LIST\r\n" * 20)
            await until(lambda: heard.extend(read()) or heard.count(b"\nOK ") >= 21, "all listings")
            os.write(ours, b"QUIT\r\n")
            await until(lambda: heard.extend(read()) or b"OK bye" in heard, "farewell")
            await until(lambda: context.stats.peers == 1, "the line is open again")
    finally:
        os.close(ours)
        os.close(theirs)


async def test_a_serial_line_that_is_not_there_is_told(bridge, until):
    async with bridge(1, serial="/dev/nothing") as (context, user):
        await until(lambda: "/dev/nothing" in context.stats.last_error, "told")
        assert await user.ask("#1 X=1") == "#1 OK"
