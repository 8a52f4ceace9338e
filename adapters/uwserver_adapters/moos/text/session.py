"""One user of the text bridge. Nothing here knows a socket: bytes in, lines out."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterator

import msgspec

from uwserver.adapter import AdapterContext, BackgroundWork, RateMeter
from uwserver.ports import Refused
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.bridge.bridge import CALLS_PER_S
from uwserver_adapters.moos.bridge.calls import Answer, Calls
from uwserver_adapters.moos.clock import DatabaseClock
from uwserver_adapters.moos.codec import finite
from uwserver_adapters.moos.config import MoosTextConfig
from uwserver_adapters.moos.db.database import DELIVERED, NAME_LIMIT, PIECE, Database
from uwserver_adapters.moos.db.variable import Letter, glob, is_pattern, work
from uwserver_adapters.moos.text.lines import LineDecoder, Malformed, Verb, Write, error_line, pair_line, reply_line

SPENT = 3 * PIECE
"""Most work of a line's writes that take effect together, about 0.5 ms."""
HELP = """\
DESIRED_THRUST=40 DESIRED_RUDDER=-5   write variables; quote texts: USM_RESET="x=0,y=0"
SUBSCRIBE NAV_* 5                     hear variables, each at most 5 times a second
UNSUBSCRIBE NAV_*                     hear them no more
GET NAV_DEPTH                         the last value; NAV_* for many
LIST                                  all variables and values; LIST NAV_* for some
CALL world/pause {}                   a service, with its arguments as JSON
QUIT                                  end the connection
#7 GET NAV_DEPTH                      a tag comes back in the answer: #7 OK or #7 ERROR code text"""


class Users:
    """The database, and all its users on TCP and on the serial line.

    Attributes:
        config, context: those of the adapter.
        clock: time of the variables, s since 1970.
        database: the variables.
        background: what is done later, in pieces.
    """

    def __init__(self, config: MoosTextConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        self.clock = DatabaseClock(1.0)
        self.database = Database("text", self.clock.now, config.max_variables, asyncio.get_running_loop().time)
        self.background = BackgroundWork()
        self._sessions: dict[str, TextSession] = {}

    def joined(self, session: TextSession) -> None:
        """Add a user."""
        self._sessions[session.name] = session
        self.database.join(session.name, session.deliver)
        self.context.stats.peers = len(self._sessions)

    def left(self, session: TextSession) -> None:
        """Remove a user."""
        del self._sessions[session.name]
        self.background.add(self.database.leave(session.name))
        self.context.stats.peers = len(self._sessions)

    def tell_error(self, letter: Letter) -> None:
        """Tell a refusal of the world to the user whose write was refused."""
        said = msgspec.json.decode(letter.message.data)
        if session := self._sessions.get(said["src"]):
            session.refuse(said["code"], f"{said['variable']}: {said['message']}")


class TextSession:
    """One user.

    Args:
        users: all users.
        name: name of this user as a client of the database.
        send: takes lines without their end.
        end: ends the connection.

    Attributes:
        name: as given.
    """

    def __init__(self, users: Users, name: str, send: Callable[[str], None], end: Callable[[], None]) -> None:
        self.name = name
        self._users = users
        self._database = users.database
        self._send = send
        self._end = end
        self._decoder = LineDecoder(users.config.line_bytes)
        self._steps: Iterator[None] | None = None
        self._verbs: dict[str, Callable[[Verb], Iterator[None] | None]] = {
            "SUBSCRIBE": self._subscribe,
            "UNSUBSCRIBE": self._unsubscribe,
            "LIST": self._list,
            "GET": self._get,
            "CALL": self._call,
            "HELP": self._help,
            "QUIT": self._quit,
        }
        self._heard: set[str] = set()
        self._calls = Calls(users.context)
        self._steady = asyncio.get_running_loop().time
        self._rate = RateMeter(CALLS_PER_S)
        users.joined(self)

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._decoder.receive(data)

    @property
    def is_busy(self) -> bool:
        """Whether a line is being carried out."""
        return self._steps is not None

    def step(self, admit: Callable[[], bool] = lambda: True) -> bool:
        """Carry out the next line, or the next piece of one.

        Args:
            admit: called with each line that can be understood; False ends the user.

        Returns:
            False where nothing is to be done.
        """
        if self._steps is None:
            event = self._decoder.next_event()
            if event is None or not (isinstance(event, Malformed) or admit()):
                return False
            self._steps = self._take(event)
        if next(self._steps, self) is self:
            self._steps = None
        return True

    @property
    def has_pending_output(self) -> bool:
        """Whether lines are still to come: answers, or variables to which the user has subscribed."""
        return bool(self._heard) or self._calls.waiting > 0

    def close(self) -> None:
        """End the session, and its calls."""
        self._calls.close()
        self._users.left(self)

    def deliver(self, letter: Letter) -> None:
        """Send a variable to which the user has subscribed."""
        self._users.context.stats.samples_sent += 1
        self._tell_of(letter)

    def _tell_of(self, letter: Letter) -> None:
        letter.line = letter.line or pair_line(letter.message.key, letter.message.value)
        self._send(letter.line)

    def _take(self, event: Write | Verb | Malformed) -> Iterator[None]:
        """Carry out one line in pieces. Others may have their turn between them, but not this user's next line."""
        if isinstance(event, Malformed):
            self.refuse(event.code, event.text, event.tag)
        elif isinstance(event, Write):
            yield from self._write(event)
        else:
            try:
                yield from self._verbs[event.verb](event) or ()
            except Refused as refused:
                self.refuse(refused.fault.code, refused.fault.text, event.tag)
            except ValueError as error:
                self.refuse("bad_argument", str(error), event.tag)

    def refuse(self, code: str, text: str, tag: str = "") -> None:
        """Tell the user what is wrong."""
        self._users.context.stats.errors += 1
        self._send(error_line(tag, code, text))

    def _write(self, event: Write) -> Iterator[None]:
        now = self._users.clock.now()
        is_good = True
        start = self._database.spent
        for name, value in event.pairs:
            # New variables that match many patterns cost much, and values with many readers.
            if self._database.spent - start >= SPENT:
                yield
                start = self._database.spent
            if reason := self._database.write(wire.notify(name, value, now, self.name)):
                is_good = False
                self.refuse("bad_argument", f"{name}: {reason}", event.tag)
        if event.tag and is_good:
            self._send(reply_line(event.tag))

    def _subscribe(self, event: Verb) -> Iterator[None]:
        words = event.rest.split()
        if len(words) not in (1, 2):
            raise Refused("invalid_request", "write SUBSCRIBE pattern [times a second]")
        rate = finite(words[1]) if len(words) == 2 else math.inf
        if rate <= 0.0:
            raise ValueError("the rate is a number above zero")
        if reason := self._database.objection(self.name, words[0], "*"):
            raise ValueError(reason)
        self._heard.add(words[0])
        self._send(reply_line(event.tag, f"SUBSCRIBE {words[0]}"))
        yield from self._database.register_all(self.name, words[0], "*", 1.0 / rate)

    def _unsubscribe(self, event: Verb) -> Iterator[None]:
        if len(event.rest.split()) != 1:
            raise Refused("invalid_request", "write UNSUBSCRIBE pattern")
        self._heard.discard(event.rest)
        yield from self._database.forget_all(self.name, event.rest, "*")
        self._send(reply_line(event.tag, f"UNSUBSCRIBE {event.rest}"))

    def _list(self, event: Verb) -> Iterator[None]:
        return self._tell(event, event.rest or "*")

    def _get(self, event: Verb) -> Iterator[None]:
        if not event.rest:
            raise Refused("invalid_request", "write GET name, or GET pattern")
        return self._tell(event, event.rest)

    def _tell(self, event: Verb, pattern: str) -> Iterator[None]:
        """Send the values of all variables that match, then their number."""
        if len(pattern) > NAME_LIMIT:
            raise ValueError(f"a pattern has at most {NAME_LIMIT} characters")
        database = self._database
        names = database.variables if is_pattern(pattern) else {pattern} & database.variables.keys()
        count = 0
        for key in list(names):
            if database.is_turn_over(DELIVERED + work(pattern)):
                yield
            variable = database.variables[key]
            if variable.letter is not None and glob(pattern, key):
                count += 1
                database.spent += variable.size >> 8
                self._tell_of(variable.letter)
        if not count and event.verb == "GET":
            raise ValueError(f'nobody has written "{pattern[:80]}"; LIST shows what there is')
        self._send(reply_line(event.tag, str(count)))

    def _call(self, event: Verb) -> None:
        if not self._rate.take(self._steady()):
            raise Refused("overload", f"more than {CALLS_PER_S} calls in a second: it is not carried out")

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
