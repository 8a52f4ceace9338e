"""The `foxglove` adapter: listens, offers clients channels and services, and sends them what they subscribe to."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
from collections.abc import Callable, Collection, Sequence
from functools import partial
from http import HTTPStatus

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from uwserver.adapter import (
    MESSAGE_LIMIT,
    AdapterBase,
    AdapterContext,
    InOrder,
    Lockout,
    SampleForm,
    address_text,
    cannot_listen,
    host_here,
    host_of,
    is_host_known,
    is_loopback,
    known_token,
    serving,
    token_for,
)
from uwserver.adapter.foxglove import PICTURE, Foreign, SceneChannels, shown_as
from uwserver.ports import Event, Port, Refused, Sample, SceneState
from uwserver_adapters.foxglove import codec
from uwserver_adapters.foxglove.catalogue import FRAMES, LOG, SCENE, Catalogue
from uwserver_adapters.foxglove.client import Client
from uwserver_adapters.foxglove.config import FoxgloveConfig
from uwserver_adapters.foxglove.outbox import Door, Outbox
from uwserver_adapters.foxglove.playback import Playback

_CLOSE_S = 1.0
_PING_S = 20.0
# The library logs every connection at level info.
_quiet = logging.getLogger(f"{__name__}.frames")
_quiet.setLevel(logging.CRITICAL)


class FoxgloveAdapter(AdapterBase[FoxgloveConfig]):
    """Serves foxglove.sdk.v1 on one TCP port. It is its own `Subscriber`, and the `Server` of its clients. Loop thread.

    Attributes:
        catalogue: what is offered.
        playback: playback of a recording.
        clients: all clients -> their connections.
        scene: time, ns, and bytes of the newest scene; None before the first.
    """

    Config = FoxgloveConfig

    def __init__(self, config: FoxgloveConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        is_open = not is_loopback(config.bind)
        # Foxglove shows no token by itself: on loopback the token of the environment is not required.
        self._token = token_for(known_token(config.token) if is_open else config.token, is_open)
        self._loop = asyncio.get_running_loop()
        self.catalogue = Catalogue(context, config.shows_poses)
        self.playback = Playback(context)
        self.clients: dict[Client, ServerConnection] = {}
        self._channels = SceneChannels(_found(context.mesh), _found(context.model_file))
        self._pictures: InOrder[Foreign | None] = InOrder("foxglove pictures", context.stats)
        self.scene: tuple[int, bytes] | None = None
        self._revision: int | None = None
        self._forms: dict[str, tuple[Port, SampleForm]] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._is_asked = False
        self._told_t_ns = -1
        self._session = 0
        self._lockout = Lockout()
        self._door = Door(self.refusals)
        self._watched: frozenset[int] = frozenset()
        self._ending: asyncio.Future[None] = self._loop.create_future()

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: the address cannot be had, or TLS is configured wrongly.
        """
        config = self.config
        try:
            server = await serve(
                self._converse, config.bind, config.port, ssl=config.tls(),
                subprotocols=[Subprotocol(name) for name in codec.SUBPROTOCOLS], process_request=self._objection,
                open_timeout=config.hello_timeout_s, close_timeout=_CLOSE_S, ping_interval=_PING_S, ping_timeout=_PING_S,
                max_size=MESSAGE_LIMIT, max_queue=4, compression=None, create_connection=self._door.connections(), logger=_quiet, server_header=None,
            )  # fmt: skip
        except OSError as error:
            raise cannot_listen(error, config.bind, config.port) from error
        try:
            with serving(self.context, self, self._address(server), ready):
                reason = f"listens at {config.bind}, which other machines can reach"
                self._token.announce(self.context, reason, f"Open\n    {self._address(server)}/{self._token.text}")
                await self._loop.create_future()  # until cancelled
        finally:
            if self._timer is not None:
                self._timer.cancel()
            self._ending.set_result(None)
            server.close()
            for connection in list(self.clients.values()):
                connection.transport.abort()
            await server.wait_closed()
            await self._pictures.close()

    def _address(self, server: Server) -> str:
        scheme = "ws" if self.config.tls_cert is None else "wss"
        port = next(iter(server.sockets)).getsockname()[1]
        return f"{scheme}://{address_text(host_here(self.config.bind), port)}"

    # -- connections ------------------------------------------------------------------------------------------------------------------

    def _objection(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the refusal of a request to connect; None where it is accepted."""

        def refuse(status: HTTPStatus, cause: str, text: str) -> Response:
            self.refusals.note(cause, text)
            return connection.respond(status, text + "\n")

        for origin in request.headers.get_all("Origin"):
            if not _allows((*self.config.allowed_origins, *self.config.watching_origins), origin):
                text = f"pages of {origin[:200]} may not connect: name that origin in allowed_origins of the adapter"
                return refuse(HTTPStatus.FORBIDDEN, "origin", text)
        for host in request.headers.get_all("Host"):
            if not is_host_known(host, self.config.allowed_hosts):
                text = (
                    f"{host[:200]} is no name of this server that it knows: add it to allowed_hosts, or use the address"
                )
                return refuse(HTTPStatus.FORBIDDEN, "host", text)
        if (token := self._token.text) is not None:
            host, now = host_of(connection.remote_address), self._loop.time()
            if self._lockout.is_out(host, now):
                return refuse(HTTPStatus.TOO_MANY_REQUESTS, "lockout", self._lockout.fault.text)
            given = request.path.partition("?")[0].strip("/")
            if not secrets.compare_digest(given.encode(), token.encode()):
                self._lockout.wrong(host, now)
                return refuse(HTTPStatus.UNAUTHORIZED, "denied", "this server wants a token: ws://HOST:PORT/TOKEN")
        if len(self.clients) >= self.config.max_clients:
            text = f"{len(self.clients)} clients are connected already (max_clients)"
            return refuse(HTTPStatus.SERVICE_UNAVAILABLE, "max_clients", text)
        if "Upgrade" not in request.headers:
            text = "This is uwserver: open this address in Foxglove or Lichtblick as a Foxglove WebSocket connection."
            return connection.respond(HTTPStatus.UPGRADE_REQUIRED, text + "\n")
        return None

    async def _converse(self, connection: ServerConnection) -> None:
        """Serve one client from its greeting to its end."""
        self._door.leave(connection)
        await self.playback.follow()
        outbox = Outbox(
            connection.send,
            self.config.queue_messages,
            self.config.queue_bytes,
            self.context.stats,
            lambda: self._send_away(connection),
        )
        host, port = connection.remote_address[:2]
        origins = connection.request.headers.get_all("Origin") if connection.request is not None else []
        watches = next((o[:200] for o in origins if not _allows(self.config.allowed_origins, o)), None)
        client = Client(self, f"{self.context.name}:{address_text(host, port)}", outbox, watches)
        sending = self._loop.create_task(outbox.run())
        self.clients[client] = connection
        self.context.stats.peers = len(self.clients)
        self._greet(client)
        self.playback.tell(False, "", outbox.put)
        self.follow()
        try:
            async for message in connection:
                # The wait gives others their turn, and makes a client that floods wait. It ends when the adapter ends.
                await asyncio.wait({self._ending}, timeout=client.hear(message))
                if self._ending.done():
                    return
        except ConnectionClosed:
            pass
        finally:
            del self.clients[client]
            self.context.stats.peers = len(self.clients)
            client.close()
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                await sending
            self.follow()

    def _send_away(self, connection: ServerConnection) -> None:
        self.refusals.note("slow reader", "a client reads too slowly (queue_messages, queue_bytes)")
        connection.transport.abort()

    def _greet(self, client: Client) -> None:
        capabilities = ["clientPublish", "parameters", "services", "time"]
        span = self.playback.span_ns
        if span is not None:
            capabilities.append("playbackControl")
        world = self.context.world
        metadata = {"server": str(self.context.hello().get("server", "uwserver")), "scenario": world.scenario}
        name = f"{world.server}: {world.scenario}"
        session = f"{id(self):x}-{self._session}"
        client.outbox.put(codec.server_info(name, capabilities, session, span, metadata), is_text=True)
        self._advertise(client, self.catalogue.channels, self.catalogue.services)

    def _advertise(self, client: Client, channels: Collection[int], services: Collection[int]) -> None:
        known, offered = self.catalogue.channels, self.catalogue.services
        if channels:
            client.tell(op="advertise", channels=[codec.told_channel(n, known[n]) for n in channels])
        if services:
            client.tell(op="advertiseServices", services=[codec.told_service(n, offered[n]) for n in services])

    # -- states -----------------------------------------------------------------------------------------------------------------------

    def follow(self) -> None:
        """Follow a change of the clients' subscriptions."""
        self._watched = frozenset(number for client in self.clients for number in client.subscriptions)
        self.context.subscriptions_changed()
        if self.clients and self._timer is None:
            self._turn()
        elif not self.clients and self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _turn(self) -> None:
        self._timer = self._loop.call_later(1.0 / self.config.frames_hz, self._turn)
        if not self._is_asked:
            with contextlib.suppress(Refused):
                self.context.request_scene_state(self._show_state, self.context.name)
                self._is_asked = True

    def _show_state(self, state: SceneState) -> None:
        self._is_asked = False
        if not self.clients:
            return
        if state.entities.revision != self._revision:
            self._revision = state.entities.revision
            scene = self._channels.scene(self.context.scene(state.entities), state.t_ns)
            self.scene = scene.t_ns, scene.data
            if self.config.shows_poses:
                self._show(SCENE, scene.t_ns, scene.data)
        if state.t_ns == self._told_t_ns:
            return
        self._told_t_ns = state.t_ns
        for client in self.clients:
            client.outbox.put(codec.time(state.t_ns), is_sample=True)
        if self.config.shows_poses and self._is_watched(
            FRAMES, *(f"/{body.name}/pose" for body in state.entities.vehicles)
        ):
            for message in self._channels.state(state):
                self._show(message.topic, message.t_ns, message.data)

    def _is_watched(self, *topics: str) -> bool:
        return any(self.catalogue.numbers.get(topic) in self._watched for topic in topics)

    def _show(self, topic: str, t_ns: int, payload: bytes) -> None:
        number = self.catalogue.numbers.get(topic)
        if number is not None:
            for client in self.clients:
                client.show(number, t_ns, payload)

    # -- samples and events -----------------------------------------------------------------------------------------------------------

    @property
    def subscriptions(self) -> Collection[str]:
        """Ports to whose samples somebody subscribes."""
        known = self.catalogue.channels
        topics = (known[number].topic for number in self._watched if number in known)
        return {path for topic in topics if (path := self.catalogue.port_of(topic)) is not None}

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Send the samples of one tick; each is encoded once for all clients."""
        for sample in samples if self._watched else ():
            port = self.context.ports.get(sample.port)
            if port is None:
                continue
            if self._is_watched(sample.port):
                self._show(sample.port, sample.t_sent_ns, self._encoded(port, sample))
            if self._is_watched(f"/{sample.port}"):
                work = self._channels.work(port, sample)
                if work is not None and shown_as(port) == PICTURE:
                    self._pictures.put(work, partial(self._show_if_current, self._session))
                elif work is not None:
                    self._show_if_current(self._session, work())

    def _show_if_current(self, session: int, message: Foreign | None) -> None:
        """Show a message, unless time has jumped since its sample."""
        if message is not None and session == self._session:
            self._show(message.topic, message.t_ns, message.data)

    def _encoded(self, port: Port, sample: Sample) -> bytes:
        known = self._forms.get(port.path)
        if known is None or known[0] is not port:
            known = self._forms[port.path] = (port, SampleForm(port))
        self.context.stats.encoded += 1
        told = {"seq": sample.seq, "t_ns": sample.t_ns, "t_sent_ns": sample.t_sent_ns, "valid": sample.valid}
        return codec.encode({**told, "value": known[1].value(sample)})

    def put_event(self, event: Event) -> None:
        """Tell the clients about an event; after a jump of time they start anew."""
        if event.event == "ports_changed":
            self._offer_anew()
        if event.event == "reset":
            # A client drops what it has of another session. Otherwise it would show nothing until time is where it was before.
            self._session += 1
            self._told_t_ns = -1
            for client in self.clients:
                self._greet(client)
                if self.scene is not None and self.config.shows_poses:
                    client.show(self.catalogue.numbers[SCENE], event.t_ns, self.scene[1])
        if event.event in ("paused", "resumed", "reset"):
            self._tell_playback(event.event == "reset")
        if self.clients:
            message = self._channels.event(event)
            self._show(LOG, message.t_ns, message.data)

    def _tell_playback(self, has_sought: bool) -> None:
        known = self.playback.span_ns

        def send(message: bytes) -> None:
            is_another_run = has_sought and self.playback.span_ns != known
            for client in self.clients:
                if is_another_run:
                    self._greet(client)
                client.outbox.put(message)

        if self.clients:
            self.playback.tell(has_sought, "", send)

    def _offer_anew(self) -> None:
        came, went, services, services_gone = self.catalogue.follow()
        for client in self.clients:
            client.forget(went)
            if went:
                client.tell(op="unadvertise", channelIds=went)
            if services_gone:
                client.tell(op="unadvertiseServices", serviceIds=services_gone)
            self._advertise(client, came, services)


def _found(find: Callable[[str], bytes | None]) -> Callable[[str], bytes]:
    """Return a search for files that fails where there is none: a file that a scene has just named is there."""

    def file(name: str) -> bytes:
        data = find(name)
        if data is None:
            raise KeyError(name)
        return data

    return file


def _allows(patterns: Sequence[str], origin: str) -> bool:
    """Return whether a page may connect. A pattern is an origin, an origin with ``:*`` for any port, or ``*`` for every page."""
    address, _, port = origin.rpartition(":")
    wanted = {"*", origin} | ({f"{address}:*"} if port.isdigit() else set())
    return not wanted.isdisjoint(patterns)
