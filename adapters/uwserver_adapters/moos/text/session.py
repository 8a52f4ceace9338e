"""What one user of the text bridge said and is owed. Knows no socket: events in, lines out."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from typing import Protocol

import msgspec

from uwserver.adapter import AdapterContext, RateMeter
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.bridge.bridge import CALLS_PER_S
from uwserver_adapters.moos.bridge.calls import Answer, Calls
from uwserver_adapters.moos.clock import DatabaseClock
from uwserver_adapters.moos.codec import finite
from uwserver_adapters.moos.config import MoosTextConfig
from uwserver_adapters.moos.db.database import DELIVERED, NAME_LIMIT, PIECE, Database
from uwserver_adapters.moos.db.patterns import glob, is_pattern, work
from uwserver_adapters.moos.db.variable import Letter
from uwserver_adapters.moos.text.lines import Malformed, Verb, Write, error_line, pair_line, reply_line

SPENT = 3 * PIECE
"""Work of one line's writes that take effect together, about 0.5 ms."""
HELP = """\
DESIRED_THRUST=40 DESIRED_RUDDER=-5   write variables; quote texts: USM_RESET="x=0,y=0"
SUBSCRIBE NAV_* 5                     hear variables, each at most 5 times a second
UNSUBSCRIBE NAV_*                     hear them no more
GET NAV_DEPTH                         the last value; NAV_* for many
LIST                                  all variables and values; LIST NAV_* for some
CALL world/pause {}                   a service, with its arguments as JSON
QUIT                                  end the connection
#7 GET NAV_DEPTH                      a tag comes back in the answer: #7 OK or #7 ERROR code text"""


class Host(Protocol):
    """Whose sessions they are: it has the database and the world."""

    config: MoosTextConfig
    context: AdapterContext
    clock: DatabaseClock
    database: Database

    def joined(self, session: TextSession) -> None:
        """A user is there."""

    def left(self, session: TextSession) -> None:
        """A user went."""


class TextSession:
    """One user.

    Args:
        host: database and world.
        name: of this user as a client of the database.
        send: takes lines without their end.
        end: ends the connection.
    """

    def __init__(self, host: Host, name: str, send: Callable[[str], None], end: Callable[[], None]) -> None:
        self.name = name
        self._host = host
        self._database = host.database
        self._send = send
        self._end = end
        self._long: dict[str, Callable[[Verb], Iterator[None]]] = {
            "SUBSCRIBE": self._subscribe,
            "UNSUBSCRIBE": self._unsubscribe,
            "LIST": self._list,
            "GET": self._get,
        }
        self._verbs: dict[str, Callable[[Verb], None]] = {
            "CALL": self._call,
            "HELP": self._help,
            "QUIT": self._quit,
        }
        self._heard: set[str] = set()
        self._calls = Calls(host.context)
        self._steady = asyncio.get_running_loop().time
        self._rate = RateMeter(CALLS_PER_S)
        host.joined(self)

    @property
    def is_owed(self) -> bool:
        """Whether lines are still to come: answers, or variables that it hears."""
        return bool(self._heard) or self._calls.waiting > 0

    def close(self) -> None:
        """The user went: nobody waits for its calls."""
        self._calls.close()
        self._host.left(self)

    def deliver(self, letter: Letter) -> None:
        """A variable that it hears."""
        self._host.context.stats.samples_sent += 1
        self._tell_of(letter)

    def _tell_of(self, letter: Letter) -> None:
        letter.line = letter.line or pair_line(letter.message.key, letter.message.value)
        self._send(letter.line)

    def take(self, event: Write | Verb | Malformed) -> Iterator[None]:
        """Carry out one line, in pieces: between them others may have their turn, but not this user's next line."""
        if isinstance(event, Malformed):
            self.refuse(event.code, event.text, event.tag)
        elif isinstance(event, Write):
            yield from self._write(event)
        elif event.verb in self._long:
            yield from self._long[event.verb](event)
        else:
            self._verbs[event.verb](event)

    def refuse(self, code: str, text: str, tag: str = "") -> None:
        """Say what is wrong."""
        self._host.context.stats.errors += 1
        self._send(error_line(tag, code, text))

    def _write(self, event: Write) -> Iterator[None]:
        now = self._host.clock.now()
        is_good = True
        start = self._database.spent
        for name, value in event.pairs:
            if self._database.spent - start >= SPENT:  # new variables that many look for, or values that many hear
                yield
                start = self._database.spent
            reason = self._database.write(wire.notify(name, value, now, self.name))
            if reason:
                is_good = False
                self.refuse("bad_argument", f"{name}: {reason}", event.tag)
        if event.tag and is_good:
            self._send(reply_line(event.tag))

    def _subscribe(self, event: Verb) -> Iterator[None]:
        words = event.rest.split()
        if len(words) not in (1, 2):
            self.refuse("invalid_request", "write SUBSCRIBE pattern [times a second]", event.tag)
            return
        interval = 0.0
        if len(words) == 2:
            try:
                rate = finite(words[1])
            except ValueError as error:
                self.refuse("bad_argument", str(error), event.tag)
                return
            if rate <= 0.0:
                self.refuse("bad_argument", "the rate is a number above zero", event.tag)
                return
            interval = 1.0 / rate
        if reason := self._database.objection(self.name, words[0], "*"):
            self.refuse("bad_argument", reason, event.tag)
            return
        self._heard.add(words[0])
        self._send(reply_line(event.tag, f"SUBSCRIBE {words[0]}"))
        yield from self._database.register_all(self.name, words[0], "*", interval)

    def _unsubscribe(self, event: Verb) -> Iterator[None]:
        if len(event.rest.split()) != 1:
            self.refuse("invalid_request", "write UNSUBSCRIBE pattern", event.tag)
            return
        self._heard.discard(event.rest)
        yield from self._database.forget_all(self.name, event.rest, "*")
        self._send(reply_line(event.tag, f"UNSUBSCRIBE {event.rest}"))

    def _list(self, event: Verb) -> Iterator[None]:
        yield from self._tell(event, event.rest or "*")

    def _get(self, event: Verb) -> Iterator[None]:
        if event.rest:
            yield from self._tell(event, event.rest)
        else:
            self.refuse("invalid_request", "write GET name, or GET pattern", event.tag)

    def _tell(self, event: Verb, pattern: str) -> Iterator[None]:
        """Values of all that match, then how many."""
        if len(pattern) > NAME_LIMIT:
            self.refuse("bad_argument", f"a pattern has at most {NAME_LIMIT} characters", event.tag)
            return
        database = self._database
        names = database.variables if is_pattern(pattern) else {pattern} & database.variables.keys()
        count = 0
        for key in database.paced(names, DELIVERED + work(pattern)):
            if key is None:
                yield
                continue
            letter = database.variables[key].letter
            if letter is not None and glob(pattern, key):
                count += 1
                database.spent += len(letter.message.data) >> 8
                self._tell_of(letter)
        if count or event.verb == "LIST":
            self._send(reply_line(event.tag, str(count)))
        else:
            self.refuse("bad_argument", f'nobody has written "{pattern[:80]}"; LIST shows what there is', event.tag)

    def _call(self, event: Verb) -> None:
        if not self._rate.take(self._steady()):
            self.refuse("overload", f"more than {CALLS_PER_S} calls in a second: it is not carried out", event.tag)
            return

        def answer(said: Answer) -> None:
            error = said.get("error")
            if isinstance(error, dict):
                self._send(error_line(event.tag, str(error["code"]), str(error["message"])))
            else:
                self._send(reply_line(event.tag, msgspec.json.encode(said.get("value")).decode()))

        self._calls.take(event.rest, self.name, answer)

    def _help(self, event: Verb) -> None:
        for line in HELP.splitlines():
            self._send(line)
        self._send(reply_line(event.tag))

    def _quit(self, event: Verb) -> None:
        self._send(reply_line(event.tag, "bye"))
        self._end()
