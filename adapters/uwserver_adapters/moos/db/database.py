"""A MOOSDB without input or output: it keeps the last value of each variable, and delivers writes to the clients that asked for them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import islice, zip_longest

from msgspec.structs import replace

from uwserver_adapters.moos import wire
from uwserver_adapters.moos.bridge.quota import FAULTS_PER_S, Quota
from uwserver_adapters.moos.db.variable import Client, Letter, Subscription, Variable, fits, work
from uwserver_adapters.moos.wire import MoosMessage

NAME_LIMIT = 256
"""Longest name of a variable, characters."""
FILTERS = 256
"""Most wildcard registrations of one client."""
FILTERS_OF_ALL = 2048
"""Most wildcard registrations of all clients. Each counts 1, and 1 more for each star, and 64 more with a question mark: each new variable is
compared with all of them."""
PIECE = 600
"""Work after which others may have their turn, in the units of `Database.spent`."""
DELIVERED = 3
"""Work of a message to a client. Each 256 bytes of it are one unit more, as they are copied and encoded."""
NAMES = 2048
"""Most names in one answer to VAR_SUMMARY. For more variables there are more answers."""
LISTED = 256
"""Most variables in a summary, and of each client: the summaries are made every second."""
KEPT_BYTES = 256 << 20
"""Most bytes of all values together."""
REFUSED = "DB_REFUSED"
"""Variable that tells clients which write or registration was not taken, and why."""

_MEAN = 0.5
"""Weight of the newest interval in a variable's frequency."""


class Database:
    """The variables of one community. Loop thread.

    Args:
        community: its name.
        now: MOOS time, s.
        max_variables: most variables that are kept.
        steady: a clock that never jumps, MOOS seconds; default: `now`. Intervals are measured by it, so that a step of `now` holds no mail back.

    Attributes:
        community: as given.
        name: name under which the database writes variables of its own.
        refused: number of writes and registrations that were not taken.
        spent: work done so far, about, in units of a third of a microsecond. A caller that wants much work compares two readings.
        log: called with each write that was taken.
        variables: name -> variable.
    """

    def __init__(
        self, community: str, now: Callable[[], float], max_variables: int, steady: Callable[[], float] | None = None
    ) -> None:
        self.community = community
        self.name = f"MOOSDB_{community}"
        self.refused = 0
        self.spent = 0
        self.log: Callable[[MoosMessage], None] = lambda message: None
        self.variables: dict[str, Variable] = {}
        self._now = now
        self._steady = now if steady is None else steady
        self._start, self._steady_start = now(), self._steady()
        self._max_variables = max_variables
        self._clients: dict[str, Client] = {}
        self._kept = 0
        self._is_refusing = False
        self._told = Quota(FAULTS_PER_S, self._steady)
        self._turn_began = 0

    def is_turn_over(self, work: int = 0) -> bool:
        """Return whether others may have their turn now, as a `PIECE` of work was done since they last had; count the work that comes next."""
        is_over = self.spent - self._turn_began >= PIECE
        if is_over:
            self._turn_began = self.spent
        self.spent += work
        return is_over

    # -- clients --------------------------------------------------------------------------------------------------------------------

    def join(self, name: str, deliver: Callable[[Letter], None]) -> None:
        """Add a client; `deliver` takes its mail."""
        self._clients[name] = Client(deliver)
        self.say("DB_EVENT", f"connected={name}")

    def leave(self, name: str) -> Iterator[None]:
        """Remove a client: it gets no more mail. Its registrations are removed by the returned iterator, which is to be run to its end."""
        client = self._clients.pop(name)
        client.deliver = lambda letter: None
        self.say("DB_EVENT", f"disconnected={name}")
        return self._tidy(name, client)

    def _tidy(self, name: str, client: Client) -> Iterator[None]:
        for key in list(client.hears):
            if self.is_turn_over(DELIVERED):
                yield
            if self.variables[key].hears(name, client):  # and not a new client of this name
                del self.variables[key].subscribers[name]

    def beat(self, name: str, sent: float) -> None:
        """Take a heartbeat of a client, sent at a MOOS time of its clock."""
        self._clients[name].latency.add((self._now() - sent) * 1e3)

    def steps(self, name: str, message: MoosMessage) -> Iterator[None]:
        """Carry out a message of a client. Others may have their turn at each step.

        What is not taken is told in DB_REFUSED. Unknown types are ignored, as a MOOSDB does.
        """
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

    def _refuse(self, client: str, key: str, reason: str) -> str:
        """Tell all clients of a refusal, within a limit. Returns the reason."""
        self.refused += 1
        if not self._is_refusing and self._told.take(client):  # else a full database would refuse DB_REFUSED, and so on
            self._is_refusing = True
            self.say(REFUSED, f"client={client[:60]},variable={key[:60]},reason={reason}")
            self._is_refusing = False
        return reason

    # -- registrations --------------------------------------------------------------------------------------------------------------

    def register(self, name: str, key: str, interval: float) -> None:
        """Register a client for a variable. It gets the last value now, and writes at most every `interval` MOOS seconds."""
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
        """Deliver a message to one client."""
        self.spent += DELIVERED + (len(letter.message.data) >> 8)
        client.deliver(letter)

    def register_all(self, name: str, pattern: str, app: str, interval: float) -> Iterator[None]:
        """Register a client for all variables that match, also for those that come later. Others may have their turn at each step."""
        if reason := self.objection(name, pattern, app):
            self._refuse(name, pattern, reason)
            return
        client = self._clients[name]
        client.filters[pattern, app] = interval
        for key in list(self.variables):
            if self.is_turn_over(work(pattern, app)):
                yield
                if self._clients.get(name) is not client:  # it left meanwhile
                    return
            variable = self.variables[key]
            if variable.letter is not None and fits(key, variable.source, pattern, app):
                self.register(name, key, interval)

    def objection(self, name: str, pattern: str, app: str) -> str:
        """Return why a client cannot register for a pattern, or ""."""
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
        """End the registrations of a client that match. Others may have their turn at each step."""
        client = self._clients[name]
        client.filters.pop((pattern, app), None)
        for key in list(client.hears):
            if self.is_turn_over(DELIVERED + work(pattern, app)):
                yield
                if self._clients.get(name) is not client:  # it left meanwhile
                    return
            if fits(key, self.variables[key].source, pattern, app):
                self._forget(name, key)

    # -- writes ---------------------------------------------------------------------------------------------------------------------

    def say(self, key: str, value: float | str) -> None:
        """Write a variable of the database itself."""
        self.write(wire.notify(key, value, self._now(), self.name))

    def write(self, message: MoosMessage) -> str:
        """Keep a value and deliver it. The first write of a variable fixes its type.

        Returns:
            Why it was not taken, or "".
        """
        variable = self._variable(message.src, message.key)
        if isinstance(variable, str):
            return variable
        old = variable.letter
        if message.kind not in wire.KINDS or (old is not None and old.message.kind != message.kind):
            given, has = (_WORDS.get(kind, "unknown type") for kind in (message.kind, variable.kind))
            return self._refuse(message.src, message.key, f"a write as {given}, its type is {has}")
        kept = self._kept + len(message.data) - variable.size
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
        writer = self._clients.get(message.src)  # a message can claim any name, so only names of clients are kept
        if writer is not None:
            writer.writes[message.key] = None
        self.spent += DELIVERED
        for subscription in variable.subscribers.values():
            if not subscription.interval or now - subscription.last >= subscription.interval:
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
        """Return the variable, which is made if need be; or why there can be none."""
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
        """Write the DB_ variables. The costly ones are written only when a client is registered for them. To be called every second or two."""
        self.say("DB_TIME", self._now())
        self.say("DB_UPTIME", self._steady() - self._steady_start)
        self.say("DB_CLIENTS", "".join(f"{name}," for name in self._clients))
        for key, text in (("DB_VARSUMMARY", self._summary), ("DB_RWSUMMARY", self._traffic), ("DB_QOS", self._quality)):
            if key in self.variables and self.variables[key].subscribers:
                self.say(key, text())

    def _summary(self) -> str:
        lines = []
        for key, variable in islice(self.variables.items(), LISTED):
            letter, source = variable.letter, variable.source if variable.letter is not None else "(write pending)"
            value = "" if letter is None else str(replace(letter.message, data=letter.message.data[:64]).value)
            value = f"{value[:22]}..." if len(value) > 25 else value
            lines.append(
                f"{key:<20} {variable.written:<20.3f} {source:<20} {variable.frequency:4.1f}Hz {variable.kind:<2} {value}\n"
            )
        return "".join(lines)

    def _traffic(self) -> str:
        def first(names: Iterable[str]) -> str:
            return ":".join(islice(names, LISTED))

        return ",".join(f"{name}={first(c.hears)}&{first(c.writes)}" for name, c in self._clients.items())

    def _quality(self) -> str:
        return "".join(f"{name}={client.latency}," for name, client in self._clients.items() if client.latency)

    def _answer(self, name: str, request: MoosMessage) -> Iterator[None]:
        """Answer what a client asks of the database itself. Others may have their turn at each step."""
        client = self._clients[name]
        replies: Iterable[MoosMessage] = ()
        if request.key == "ALL":
            replies = (self._listed(key, self.variables[key]) for key in list(self.variables))
        elif "PROC_SUMMARY" in request.key:
            replies = self._clients_summary()
        elif "VAR_SUMMARY" in request.key:
            replies = (self._reply("VAR_SUMMARY", ",".join(part)) for part in _parts(self.variables, NAMES))
        elif "DB_CLEAR" in request.key:
            yield from self._clear()
        else:
            self._refuse(name, request.key, "no request: ask for ALL, VAR_SUMMARY, PROC_SUMMARY or DB_CLEAR")
        for reply in replies:
            self.deliver(client, Letter(reply))
            if self.is_turn_over():
                yield

    def _clients_summary(self) -> Iterator[MoosMessage]:
        for who, client in list(self._clients.items()):
            hears, writes = _parts(client.hears, LISTED), _parts(client.writes, LISTED)
            for heard, written in zip_longest(hears, writes, fillvalue=()):
                text = f"{who}:{_list('SUBSCRIBED=', heard)},{_list('PUBLISHED=', written)}"
                yield self._reply("PROC_SUMMARY", text)

    def _clear(self) -> Iterator[None]:
        """Forget all values and types."""
        for client in self._clients.values():
            client.writes.clear()
        for key in list(self.variables):  # the names alone: a copy of 20 000 pairs would take 2 ms
            if self.is_turn_over(DELIVERED):
                yield
            variable = self.variables[key]
            self._kept -= variable.size
            self.variables[key] = Variable(last=variable.last, subscribers=variable.subscribers)

    def _listed(self, key: str, variable: Variable) -> MoosMessage:
        if variable.letter is None:
            return MoosMessage(wire.NOTIFY, key, 0.0, kind="~", time=-1.0, id=wire.SERVER_REQUEST_ID)
        said, since = variable.letter.message, variable.written - self._start
        return replace(said, time=since, number2=variable.frequency, id=wire.SERVER_REQUEST_ID)

    def _reply(self, key: str, text: str) -> MoosMessage:
        return wire.notify(key, text, self._now() - self._start, self.name, wire.SERVER_REQUEST_ID)


_WORDS = {wire.DOUBLE: "double", wire.STRING: "string", wire.BINARY: "binary"}


def _parts(names: Iterable[str], most: int) -> Iterator[list[str]]:
    """Return the present names in parts of at most `most`; one empty part where there are none."""
    there = list(names)
    return (there[at : at + most] for at in range(0, max(1, len(there)), most))


def _list(title: str, names: Iterable[str]) -> str:
    return title + "".join(f",{name}" for name in names)
