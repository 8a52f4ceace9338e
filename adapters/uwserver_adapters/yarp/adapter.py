"""The `yarp` adapter: ports of a YARP network, registered at its name server. It needs no YARP on this machine."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
from collections.abc import Collection, Sequence
from functools import partial

from uwserver.adapter import (
    AdapterBase,
    AdapterContext,
    CannotListen,
    Peers,
    TcpListener,
    address_text,
    may_connect,
    serve_tcp,
    serving,
    within,
)
from uwserver.ports import Event, Refused, Sample
from uwserver_adapters.yarp import codec, links
from uwserver_adapters.yarp.config import YarpConfig
from uwserver_adapters.yarp.links import Address, Link, connect
from uwserver_adapters.yarp.peer import Answered, Peer
from uwserver_adapters.yarp.port import Reader, Writer, YarpPort, ports_of
from uwserver_adapters.yarp.wire import CARRIERS, Carrier

log = logging.getLogger(__name__)

TRIES = 64
"""Most TCP ports that are tried for one port of YARP, where they are in use."""
CHECK_S = 1.0
"""Wall time between two checks whether the name server still knows this server."""
LEAVE_S = 0.5
"""Wall time to unregister at the name server when this server ends."""
LINKS = 64
"""Most connections that are being made at a time."""


class YarpAdapter(AdapterBase[YarpConfig]):
    """Serves ports for sensors, actuators, services and the time. The name server may start later, end, and come back.

    It is its own `Subscriber`, and the `uwserver_adapters.yarp.peer.Network` of those who connect.

    Attributes:
        ports: all ports, by name; the first is the clock.
    """

    Config = YarpConfig

    def __init__(self, config: YarpConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        self.ports: dict[str, YarpPort] = {}
        self._peers: Peers[Peer | Link] = Peers(
            config.max_clients, self.refusals, context.stats, strangers=config.max_strangers
        )
        self._listeners: dict[str, TcpListener] = {}
        self._registered: set[str] = set()
        self._gone: set[str] = set()
        self._heard: dict[str, list[YarpPort]] = {}
        self._followed: set[str] = set()
        self._next_port = config.first_port
        self._next_clock = 0
        self._numbers = itertools.count(1)
        self._changed = asyncio.Event()
        self._making: set[asyncio.Task[None]] = set()
        self._trouble = ""

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: `name_server` is no address.
            CannotListen: the address cannot be had; or it is not loopback and the table does not allow that, or does not say by which name
                others reach it.
        """
        config, context = self.config, self.context
        config.check_bind("YARP")
        self._host = config.reached_at()
        self._server = links.server_of(config.name_server)
        context.stats.details["name_server"] = config.name_server
        async with contextlib.AsyncExitStack() as stack:
            await self._open(stack)
            clock = self._listeners[next(iter(self.ports))].port
            with serving(context, self, address_text(config.bind, clock), ready):
                try:
                    while True:
                        await self._stay_registered()
                        with contextlib.suppress(OSError):
                            await within(CHECK_S, self._changed.wait(), "nothing has changed")
                        if self._changed.is_set():
                            self._changed.clear()
                            await self._open(stack)
                finally:
                    await self._leave_network()

    # -- ports ----------------------------------------------------------------------------------------------------------------------------

    async def _open(self, stack: contextlib.AsyncExitStack) -> None:
        """Have ports for everything that exists now, and for nothing else."""
        config = self.config
        wanted = {each.name: each for each in ports_of(self.context, config.prefix, config.ports, config.vectors)}
        for name in [name for name, port in self.ports.items() if name not in wanted or wanted[name].port != port.port]:
            self._listeners.pop(name).close()
            self.ports.pop(name).close()
            self._gone.add(name)
        for name, port in wanted.items():
            if name in self.ports:
                self.ports[name].services = port.services
            else:
                self.ports[name] = port
                self._listeners[name] = await self._listener(stack, port)
                self._registered.discard(name)
                self._gone.discard(name)
        self._follow()
        self.context.stats.details["ports"] = {name: each.port for name, each in self._listeners.items()}

    async def _listener(self, stack: contextlib.AsyncExitStack, port: YarpPort) -> TcpListener:
        def make() -> Peer:
            return Peer(self, port, self._peers, f"{port.name}#{next(self._numbers)}")

        tries = 0
        while True:
            number, tries = self._next_port, tries + 1
            if number:
                self._next_port = number % 65535 + 1
            try:
                server = serve_tcp(make, self._peers, self.config.bind, number, key="first_port", rival="YARP")
                return await stack.enter_async_context(server)
            except CannotListen:
                if tries == TRIES or not number:
                    raise

    # -- the name server --------------------------------------------------------------------------------------------------------------------

    async def _stay_registered(self) -> None:
        """Stay registered at a name server that may come and go."""
        try:
            await self._register()
            if self._trouble:
                log.info("%s is registered at %s", self.context.name, self.config.name_server)
            self._trouble = ""
        except OSError as error:
            self._registered.clear()
            text = f"no YARP name server at {self.config.name_server}: {error}"
            self.context.stats.last_error = text
            if not self._trouble:
                log.warning("%s: %s; it is looked for every second (yarpserver is one)", self.context.name, text)
            self._trouble = text
        self.context.stats.details["registered"] = len(self._registered)

    async def _register(self) -> None:
        """Register what is new and unregister what has gone.

        If the name server does not know the first port any more it was restarted: everything is registered again.
        """
        host, first = self._host, next(iter(self.ports))
        if first in self._registered:
            (answer,) = await links.ask(self._server, [f"query {first}"], self.config.prefix)
            known = links.address_in(answer)
            if known is None:
                self._registered.clear()
            elif (known.host, known.port) != (host, self._listeners[first].port):
                text = f"{first} belongs to {known.host}:{known.port} now: another server has this prefix"
                self.refusals.note("prefix", text)
        if self._gone:
            await links.ask(self._server, [f"unregister {name}" for name in sorted(self._gone)], self.config.prefix)
            self._gone.clear()
        new = [name for name in self.ports if name not in self._registered]
        if new:
            questions = [f"register {name} tcp {host} {self._listeners[name].port}" for name in new]
            await links.ask(self._server, questions, self.config.prefix)
            self._registered.update(new)

    async def _leave_network(self) -> None:
        for task in self._making:
            task.cancel()
        await asyncio.gather(*self._making, return_exceptions=True)
        questions = [f"unregister {name}" for name in sorted(self._registered | self._gone)]
        if questions:
            with contextlib.suppress(OSError):
                unregistering = links.ask(self._server, questions, self.config.prefix)
                await within(LEAVE_S, unregistering, "the name server did not answer")

    # -- uwserver.adapter.Subscriber ------------------------------------------------------------------------------------------------------

    subscriptions: Collection[str] = ()

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Send the samples of one tick, and the time."""
        stats, heard = self.context.stats, self._heard
        for sample in samples:
            for port in heard.get(sample.port, ()):
                stats.encoded += port.tell(sample)
        self._tell_time(max((sample.t_sent_ns for sample in samples), default=0))

    def _tell_time(self, now: int) -> None:
        clock, span = next(iter(self.ports.values())), codec.span_ns(self.config.clock_hz)
        # Time may also jump back.
        if now and clock.readers and not self._next_clock - 2 * span <= now < self._next_clock:
            self._next_clock = now + span
            clock.tell_time(now)

    def put_event(self, event: Event) -> None:
        """Follow a change of ports or of time."""
        if event.event == "ports_changed":
            self._changed.set()
        elif event.event == "reset":
            self._next_clock = 0

    # -- Network ----------------------------------------------------------------------------------------------------------------------------

    def hear(self, at: YarpPort, reader: Reader) -> None:
        """See `Network`."""
        at.readers[reader] = reader
        self._follow()

    def leave(self, at: YarpPort, end: Reader | Writer) -> None:
        """See `Network`."""
        at.writers.pop(end, None)
        at.readers.pop(end, None)
        if at.name in self._followed and not at.readers:
            self._follow()

    def _follow(self) -> None:
        """Ask for the samples of ports that somebody hears, and for the clock for those of the fastest sensor."""
        self._heard = {}
        for each in self.ports.values():
            if each.readers and each.port is not None:
                self._heard.setdefault(each.port.path, []).append(each)
        subscriptions = set(self._heard)
        sensors = [port for port in self.context.ports.values() if port.direction == "sensor"]
        if sensors and next(iter(self.ports.values())).readers:
            subscriptions.add(max(sensors, key=lambda port: port.rate_hz or 0.0).path)
        self.subscriptions = subscriptions
        self._followed = {each.name for each in self.ports.values() if each.readers}
        self.context.subscriptions_changed()

    def connect(self, at: YarpPort, target: str, answered: Answered) -> None:
        """See `Network`."""
        if len(self._making) >= LINKS:
            answered(f"Cannot connect to {target[:100]}: {LINKS} connections are in the making")
            return
        task = asyncio.get_running_loop().create_task(self._connect(at, target, answered))
        self._making.add(task)
        task.add_done_callback(self._making.discard)

    async def _connect(self, at: YarpPort, target: str, answered: Answered) -> None:
        try:
            carrier, name = links.target_of(target)
            address = await self._find(name)
            spoken = _carrier(carrier or address.carrier)
            if not at.is_output:
                raise Refused("denied", "Outputs not allowed")
            at.disconnect(name)
            link = Link(
                at, name, spoken, self._peers, self.context.stats, self.config.queue_bytes, partial(self.leave, at)
            )
            await connect(link, address)
            if at.name in self.ports:
                self.hear(at, link)
            else:
                link.close()
            outcome = f"Added connection from {at.name} to {target}"
        except Refused as refused:
            outcome = f"{refused}" if refused.fault.code == "denied" else f"Cannot connect to {target[:100]}: {refused}"
            self.refusals.note("connect", outcome)
        except OSError as error:
            outcome = f"Cannot connect to {target[:100]}: {error}"
        answered(outcome)

    async def _find(self, name: str) -> Address:
        (answer,) = await links.ask(self._server, [f"query {name}"], self.config.prefix)
        address = links.address_in(answer)
        if address is None:
            raise Refused("unknown_port", f"Do not know how to connect to {name}")
        if not may_connect(address.host, (*self.config.allowed_hosts, self._server[0])):
            text = f'{name} is at "{address.host}": say allowed_hosts = ["{address.host}"] if that is one of yours'
            raise Refused("denied", text)
        return address

    def complain(self, text: str) -> None:
        """See `Network`."""
        self.refusals.note_error("not taken", text)


def _carrier(name: str) -> Carrier:
    if name not in CARRIERS:
        raise Refused("bad_argument", f"no carrier {name[:40]}, there are: {', '.join(CARRIERS)}")
    return name
