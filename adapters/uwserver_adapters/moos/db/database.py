"""What a MOOSDB does, without input or output: keeps the last value of each variable and delivers writes to those who asked."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import islice, zip_longest

from msgspec.structs import replace

from uwserver_adapters.moos import wire
from uwserver_adapters.moos.bridge.quota import FAULTS_PER_S, Quota
from uwserver_adapters.moos.db.patterns import fits, work
from uwserver_adapters.moos.db.variable import Client, Letter, Subscription, Variable
from uwserver_adapters.moos.wire import Message

NAME_LIMIT = 256
"""Longest name of a variable, characters."""
FILTERS = 256
"""Wildcard registrations of one client."""
FILTERS_OF_ALL = 2048
"""Of those of all clients: each counts 1 and for each star 1, with a question mark 64 more. Each new variable is compared with all of them."""
PIECE = 600
"""Work after which others may have their turn, in units of a third of a microsecond: see `Database.spent`."""
DELIVERED = 3
"""Work of a message to a client; each 256 bytes are one unit more, as they are copied and encoded."""
NAMES = 2048
"""Names in one answer to VAR_SUMMARY: where there are more variables there are more answers."""
LISTED = 256
"""Variables that the summaries tell of, and of each client: they are made every second."""
KEPT_BYTES = 256 << 20
"""Of all values together."""
REFUSED = "DB_REFUSED"
"""Where clients are told what was not taken, and why."""

_MEAN = 0.5
"""Weight of the newest interval in a variable's frequency."""


class Database:
    """The variables of one community. Loop thread.

    Args:
        community: its name.
        now: MOOS time, s.
        max_variables: more are refused.
        steady: a clock that never jumps, MOOS seconds: intervals are measured by it, so that a step of `now` holds no mail back; default: `now`.

    Attributes:
        name: under which it writes variables of its own.
        refused: writes and registrations that were not taken.
        spent: work that was done, about, in units of a third of a microsecond: who asks for much of it looks here when it is time for others.
        log: called with each write that was taken.
    """

    def __init__(
        self, community: str, now: Callable[[], float], max_variables: int, steady: Callable[[], float] | None = None
    ) -> None:
        self.community = community
        self.name = f"MOOSDB_{community}"
        self.refused = 0
        self.spent = 0
        self.log: Callable[[Message], None] = _ignore
        self.variables: dict[str, Variable] = {}
        self._now = now
        self._steady = now if steady is None else steady
        self._start, self._steady_start = now(), self._steady()
        self._max_variables = max_variables
        self._clients: dict[str, Client] = {}
        self._kept = 0
        self._is_refusing = False
        self._told = Quota(FAULTS_PER_S, self._steady)

    @property
    def clients(self) -> tuple[str, ...]:
        """Names of all clients."""
        return tuple(self._clients)

    # -- clients --------------------------------------------------------------------------------------------------------------------

    def join(self, name: str, deliver: Callable[[Letter], None]) -> None:
        """A client is there; `deliver` takes its mail."""
        self._clients[name] = Client(deliver)
        self.say("DB_EVENT", f"connected={name}")

    def leave(self, name: str) -> Iterator[None]:
        """It went, and hears nothing more. What is left of it is tidied up in pieces: to be taken to the end, some time."""
        client = self._clients.pop(name)
        client.leave()
        self.say("DB_EVENT", f"disconnected={name}")
        return self._tidy(name, client)

    def _tidy(self, name: str, client: Client) -> Iterator[None]:
        for key in self.paced(client.hears, DELIVERED):
            if key is None:
                yield
            else:
                self.variables[key].drop(name, client)

    def beat(self, name: str, sent: float) -> None:
        """A heartbeat of a client, sent at a MOOS time of its clock."""
        self._clients[name].latency.add((self._now() - sent) * 1e3)

    def take(self, name: str, message: Message) -> None:
        """The same as `steps`, all at once."""
        for _ in self.steps(name, message):
            pass

    def steps(self, name: str, message: Message) -> Iterator[None]:
        """A message of a client. What is not taken is told in DB_REFUSED; unknown types are ignored, as MOOSDB does."""
        if message.type == wire.NOTIFY:
            self.write(message)
        elif message.type == wire.REGISTER:
            self.register(name, message.key, message.number)
        elif message.type == wire.UNREGISTER:
            self._forget(name, message.key)
        elif message.type == wire.WILDCARD_REGISTER:
            yield from self.register_all(name, *wire.wildcard_of(message))
        elif message.type == wire.WILDCARD_UNREGISTER:
            pattern, app, _ = wire.wildcard_of(message)
            yield from self.forget_all(name, pattern, app)
        elif message.type == wire.SERVER_REQUEST:
            yield from self._answer(name, message)

    def paced(self, names: Iterable[str], each: int) -> Iterator[str | None]:
        """These names, as they are now, and between them None where others may have their turn.

        Args:
            names: of variables; only they are copied: the pairs of a large dictionary would take 2 ms.
            each: work that one of them is; what is done besides counts too.
        """
        start = self.spent
        for name in list(names):
            if self.spent - start >= PIECE:
                yield None
                start = self.spent
            self.spent += each
            yield name

    def _refuse(self, client: str, key: str, reason: str) -> str:
        """Tell everybody, sparingly; returns the reason."""
        self.refused += 1
        if not self._is_refusing and self._told.take(client):  # a full database cannot even say so
            self._is_refusing = True
            self.say(REFUSED, f"client={client[:60]},variable={key[:60]},reason={reason}")
            self._is_refusing = False
        return reason

    # -- registrations --------------------------------------------------------------------------------------------------------------

    def register(self, name: str, key: str, interval: float) -> None:
        """A client hears a variable, at most every `interval` MOOS seconds, and its last value at once."""
        variable = self._variable(name, key)
        if isinstance(variable, str):
            return
        client = self._clients[name]
        subscription = Subscription(client, interval if 0.0 < interval < float("inf") else 0.0)
        variable.subscribers[name] = subscription
        client.hears[key] = None
        self.spent += DELIVERED
        if variable.letter is not None:
            subscription.last = self._steady()
            self.deliver(client, variable.letter)

    def deliver(self, client: Client, letter: Letter) -> None:
        """A message to one client."""
        self.spent += DELIVERED + (len(letter.message.data) >> 8)
        client.deliver(letter)

    def register_all(self, name: str, pattern: str, app: str, interval: float) -> Iterator[None]:
        """A client hears all variables that match, also those that come later. In pieces: there may be many."""
        if reason := self.objection(name, pattern, app):
            self._refuse(name, pattern, reason)
            return
        client = self._clients[name]
        client.filters[pattern, app] = interval
        for key in self.paced(self.variables, work(pattern, app)):
            if key is None:
                yield
                if self._clients.get(name) is not client:
                    return
                continue
            letter = self.variables[key].letter
            if letter is not None and fits(key, letter.message.src, pattern, app):
                self.register(name, key, interval)

    def objection(self, name: str, pattern: str, app: str) -> str:
        """Why a client cannot hear all that match; "" when it can."""
        filters = self._clients[name].filters
        if max(len(pattern), len(app)) > NAME_LIMIT:
            return f"a pattern has at most {NAME_LIMIT} characters"
        if (pattern, app) in filters:
            return ""
        if len(filters) >= FILTERS:
            return f"{FILTERS} wildcard registrations are the most a client has"
        there = sum(work(*each) for client in self._clients.values() for each in client.filters)
        if there + work(pattern, app) > FILTERS_OF_ALL:
            return (
                "the wildcard registrations of all clients have too many stars and question marks: name the variables"
            )
        return ""

    def _forget(self, name: str, key: str) -> None:
        variable = self.variables.get(key)
        if variable is not None:
            variable.subscribers.pop(name, None)
            self._clients[name].hears.pop(key, None)

    def forget_all(self, name: str, pattern: str, app: str) -> Iterator[None]:
        """A client hears these no more; in pieces."""
        client = self._clients[name]
        client.filters.pop((pattern, app), None)
        for key in self.paced(client.hears, DELIVERED + work(pattern, app)):
            if key is None:
                yield
                if self._clients.get(name) is not client:
                    return
                continue
            letter = self.variables[key].letter
            if fits(key, letter.message.src if letter is not None else "", pattern, app):
                self._forget(name, key)

    # -- writes ---------------------------------------------------------------------------------------------------------------------

    def say(self, key: str, value: float | str) -> None:
        """Write a variable of our own."""
        self.write(wire.notify(key, value, self._now(), self.name))

    def write(self, message: Message) -> str:
        """Keep a value and deliver it. The first write of a variable fixes its type.

        Returns:
            "", or why it was not taken.
        """
        variable = self._variable(message.src, message.key)
        if isinstance(variable, str):
            return variable
        old = variable.letter
        if message.kind not in wire.KINDS or (old is not None and old.message.kind != message.kind):
            given, has = (_WORDS.get(kind, "unknown type") for kind in (message.kind, variable.kind))
            return self._refuse(message.src, message.key, f"a write as {given}, its type is {has}")
        kept = self._kept + len(message.data) - (len(old.message.data) if old is not None else 0)
        if kept > KEPT_BYTES:
            return self._refuse(message.src, message.key, f"all values together have at most {KEPT_BYTES} bytes")
        self._kept = kept
        if not message.community:
            message = replace(message, community=self.community)
        self.log(message)
        letter = Letter(message)
        now = self._steady()
        variable.letter = letter
        if old is None:
            self._find_subscribers(message.key, message.src, variable)
        else:
            elapsed = max(now - variable.last, 1e-3)
            variable.frequency += _MEAN * (1.0 / elapsed - variable.frequency)
        variable.written, variable.last = self._now(), now
        variable.writes += 1
        writer = self._clients.get(message.src)  # anybody can claim any name, so only those of clients are kept
        if writer is not None:
            writer.writes[message.key] = None
        self.spent += DELIVERED
        for subscription in variable.subscribers.values():
            if not subscription.interval:
                self.deliver(subscription.client, letter)
            elif now - subscription.last >= subscription.interval:
                subscription.last = now
                self.deliver(subscription.client, letter)
        return ""

    def _find_subscribers(self, key: str, source: str, variable: Variable) -> None:
        for name, client in self._clients.items():
            for (pattern, app), interval in client.filters.items():
                self.spent += work(pattern, app)
                if not variable.hears(name, client) and fits(key, source, pattern, app):
                    variable.subscribers[name] = Subscription(client, interval)
                    client.hears[key] = None

    def _variable(self, client: str, key: str) -> Variable | str:
        """The variable, made if need be, or why there can be none."""
        variable = self.variables.get(key)
        if variable is None:
            if not 0 < len(key) <= NAME_LIMIT:
                return self._refuse(client, key, f"the name of a variable has 1 to {NAME_LIMIT} characters")
            if len(self.variables) >= self._max_variables:
                return self._refuse(client, key, f"{self._max_variables} variables are the most there can be")
            variable = self.variables[key] = Variable()
        return variable

    # -- what it tells of itself ----------------------------------------------------------------------------------------------------

    def tell(self) -> None:
        """Write the DB_ variables; those that cost much only when somebody listens. To be called every second or two."""
        self.say("DB_TIME", self._now())
        self.say("DB_UPTIME", self._steady() - self._steady_start)
        self.say("DB_CLIENTS", "".join(f"{name}," for name in self._clients))
        for key, text in (("DB_VARSUMMARY", self._summary), ("DB_RWSUMMARY", self._traffic), ("DB_QOS", self._quality)):
            if key in self.variables and self.variables[key].subscribers:
                self.say(key, text())

    def _summary(self) -> str:
        lines = []
        for key, variable in islice(self.variables.items(), LISTED):
            letter = variable.letter
            source = letter.message.src if letter is not None else "(write pending)"
            value = "" if letter is None else str(replace(letter.message, data=letter.message.data[:64]).value)
            value = f"{value[:22]}..." if len(value) > 25 else value
            lines.append(
                f"{key:<20} {variable.written:<20.3f} {source:<20} {variable.frequency:4.1f}Hz {variable.kind:<2} {value}\n"
            )
        return "".join(lines)

    def _traffic(self) -> str:
        clients = self._clients.items()
        return ",".join(f"{name}={':'.join(_first(c.hears))}&{':'.join(_first(c.writes))}" for name, c in clients)

    def _quality(self) -> str:
        return "".join(f"{name}={client.latency}," for name, client in self._clients.items() if client.latency)

    def _answer(self, name: str, request: Message) -> Iterator[None]:
        """What a client asks of the database itself, in pieces."""
        client = self._clients[name]
        if request.key == "ALL":
            replies = self._all()
        elif "PROC_SUMMARY" in request.key:
            replies = self._clients_summary()
        elif "VAR_SUMMARY" in request.key:
            replies = (self._reply("VAR_SUMMARY", ",".join(part)) for part in _parts(self.variables, NAMES))
        elif "DB_CLEAR" in request.key:
            replies = self._cleared()
        else:
            self._refuse(name, request.key, "no request: ask for ALL, VAR_SUMMARY, PROC_SUMMARY or DB_CLEAR")
            return
        start = self.spent
        for reply in replies:
            if reply is not None:
                self.deliver(client, Letter(reply))
            if reply is None or self.spent - start >= PIECE:
                yield
                start = self.spent

    def _all(self) -> Iterator[Message | None]:
        for key in self.paced(self.variables, DELIVERED):
            yield None if key is None else self._listed(key, self.variables[key])

    def _clients_summary(self) -> Iterator[Message]:
        for who, client in list(self._clients.items()):
            hears, writes = _parts(client.hears, LISTED), _parts(client.writes, LISTED)
            for heard, written in zip_longest(hears, writes, fillvalue=()):
                text = f"{who}:{_list('SUBSCRIBED=', heard)},{_list('PUBLISHED=', written)}"
                yield self._reply("PROC_SUMMARY", text)

    def _cleared(self) -> Iterator[None]:
        for client in self._clients.values():
            client.writes.clear()
        for key in self.paced(self.variables, DELIVERED):
            if key is None:
                yield
            else:
                self._kept -= self.variables[key].clear()

    def _listed(self, key: str, variable: Variable) -> Message:
        if variable.letter is None:
            return Message(wire.NOTIFY, key, 0.0, kind="~", time=-1.0, id=wire.SERVER_REQUEST_ID)
        said, since = variable.letter.message, variable.written - self._start
        return replace(said, time=since, number2=variable.frequency, id=wire.SERVER_REQUEST_ID)

    def _reply(self, key: str, text: str) -> Message:
        return wire.notify(key, text, self._now() - self._start, self.name, wire.SERVER_REQUEST_ID)


_WORDS = {wire.DOUBLE: "double", wire.STRING: "string", wire.BINARY: "binary"}


def _ignore(message: Message) -> None:
    """No log."""


def _first(names: Iterable[str]) -> Iterable[str]:
    return islice(names, LISTED)


def _parts(names: Iterable[str], most: int) -> Iterator[list[str]]:
    """These names, as they are now, in parts of at most so many; one part without any where there are none."""
    there = list(names)
    return (there[at : at + most] for at in range(0, max(1, len(there)), most))


def _list(title: str, names: Iterable[str]) -> str:
    return title + "".join(f",{name}" for name in names)
