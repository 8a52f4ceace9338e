"""The `zenoh` adapter: a session, and what crosses between its threads and the loop."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from uwserver.adapter import AdapterContext, CannotServe, EncodingName, Inbox, Worker, serving
from uwserver_adapters.zenoh_bus.codec import ATTACHMENT_LIMIT, PAYLOAD_LIMIT, Codec
from uwserver_adapters.zenoh_bus.keys import KeyScheme
from uwserver_adapters.zenoh_bus.publications import Publications
from uwserver_adapters.zenoh_bus.requests import CLIENTS, Put, Question, Requests
from uwserver_adapters.zenoh_session.config import ZenohConfig, is_exposed
from uwserver_adapters.zenoh_session.session import NobodyThere, direct, free, opened

if TYPE_CHECKING:
    import zenoh

log = logging.getLogger(__name__)

RETRY_S = 0.5
"""Wall time between two attempts to open a session that must connect first."""
TAKEN_S = 0.8
"""Wall time to wait for the answer whether the name is taken; peers that have nothing to say answer at once."""
PEERS_S = 0.5
"""Wall time between two counts of the peers."""


class ZenohAdapter:
    """Serves ports and services on a zenoh network, as README.md says."""

    Config = ZenohConfig

    def __init__(self, config: ZenohConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        server = config.server or context.world.server
        self.keys = KeyScheme(config.prefix, server)
        self._zid = ""
        self._clients: set[str] = set()

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: zenoh is not installed, a setting is wrong, an endpoint cannot be had, or the server's name is taken.
        """
        stats = self.context.stats
        sender = Worker("zenoh sender", stats)
        held: list[Any] = []  # the session, once it is open; also if the opening was cancelled meanwhile
        try:
            session = await self._open(sender, held)
            await sender.run(lambda: self._check_name(session))
            await self._serve(session, sender, ready)
        finally:
            await sender.close(lambda: [session.close() for session in held])
            stats.state = "stopped"
            stats.peers = 0

    async def _open(self, sender: Worker, held: list[Any]) -> zenoh.Session:
        stats = self.context.stats
        while True:
            listen = free(self.config)
            try:
                await sender.run(partial(_open_into, held, self.config, listen))
            except NobodyThere as error:
                stats.state, stats.last_error = "retrying", str(error)
                await asyncio.sleep(RETRY_S)
                continue
            stats.address = ", ".join(listen or self.config.connect) or "multicast scouting"
            if is_exposed(self.config, listen):
                log.warning(
                    "%s listens at %s, which others can reach, unrestricted: set access_control or TLS in `config`, or listen on loopback",
                    self.context.name, stats.address,
                )  # fmt: skip
            session: zenoh.Session = held[-1]
            return session

    def _check_name(self, session: zenoh.Session) -> None:
        """Whether another server has our name. Not on the loop."""
        own = self.keys.identity(str(session.zid()))
        for reply in session.liveliness().get(self.keys.identities, timeout=TAKEN_S):
            if reply.ok is not None and str(reply.ok.key_expr) != own:
                raise CannotServe(_taken(self.keys))

    async def _serve(self, session: zenoh.Session, sender: Worker, ready: asyncio.Event) -> None:
        import zenoh

        stats = self.context.stats
        self._zid = str(session.zid())
        codecs: dict[EncodingName, Codec] = {"json": Codec("json"), "msgpack": Codec("msgpack")}
        publications = Publications(self.context, session, self.keys, codecs[self.config.encoding], sender)
        requests = Requests(
            self.context, self.keys, codecs, self.config.encoding, self.config.call_timeout_s,
            publications.tell, publications.look,
        )  # fmt: skip
        puts: Inbox[zenoh.Sample] = Inbox(
            lambda sample: requests.take_put(_put(sample)), self.config.queue_requests, self._drop
        )
        gets: Inbox[zenoh.Query] = Inbox(
            lambda query: requests.take_question(_question(query, sender)), self.config.queue_requests, self._drop
        )
        others: Inbox[zenoh.Sample] = Inbox(self._other_server, self.config.queue_requests, self._drop)
        tokens: Inbox[zenoh.Sample] = Inbox(
            lambda sample: self._token(sample, requests), self.config.queue_requests, self._drop
        )
        losses: Inbox[zenoh.Sample] = Inbox(
            lambda sample: requests.take_loss(_put(sample)), self.config.queue_requests, self._drop
        )
        # Sessions tell nobody of what they put themselves: our own samples do not come back as commands.
        session.declare_subscriber(self.keys.everything, direct(puts.put), allowed_origin=zenoh.Locality.REMOTE)
        for key in self.keys.requests:
            session.declare_queryable(key, direct(gets.put))
        session.declare_subscriber(self.keys.losses, direct(losses.put), allowed_origin=zenoh.Locality.REMOTE)
        liveliness = session.liveliness()
        liveliness.declare_subscriber(self.keys.clients, direct(tokens.put), history=True)
        liveliness.declare_subscriber(self.keys.identities, direct(others.put), history=True)
        identity = liveliness.declare_token(self.keys.identity(self._zid))
        publications.open()
        alive = liveliness.declare_token(self.keys.alive())
        try:
            with serving(self.context, publications, stats.address, ready):
                while True:
                    publications.look()
                    # A named client behind a router is known by its token alone; most give the id of their session as name.
                    stats.peers = len({str(peer.zid) for peer in session.info.transports()} | self._clients)
                    await asyncio.sleep(PEERS_S)
        finally:
            requests.close()
            self._clients.clear()
            alive.undeclare()
            identity.undeclare()

    def _drop(self, item: zenoh.Sample | zenoh.Query) -> None:
        """Too much waits for the loop. A zenoh thread."""
        self.context.stats.dropped += 1

    def _token(self, sample: zenoh.Sample, requests: Requests) -> None:
        """A client is there, or gone."""
        import zenoh

        client = str(sample.key_expr).rsplit("/", 1)[-1]
        if sample.kind == zenoh.SampleKind.DELETE:
            self._clients.discard(client)
            requests.client_left(client)
        elif len(self._clients) < CLIENTS:
            self._clients.add(client)

    def _other_server(self, sample: zenoh.Sample) -> None:
        import zenoh

        zid = str(sample.key_expr).rsplit("/", 1)[-1]
        if sample.kind == zenoh.SampleKind.PUT and zid != self._zid:
            self.context.stats.errors += 1
            self.context.stats.last_error = _taken(self.keys)
            log.error("%s", _taken(self.keys))


def _open_into(held: list[Any], config: ZenohConfig, listen: tuple[str, ...]) -> None:
    held.append(opened(config, listen))


def _taken(keys: KeyScheme) -> str:
    name = keys.root.rsplit("/", 1)[-1]
    return (
        f'another server named "{name}" is in this zenoh network: give one of them another name (`server` of this adapter, or [server] name), '
        "another `prefix`, or a network of its own (scouting = false and other endpoints)"
    )


def _put(sample: zenoh.Sample) -> Put:
    import zenoh

    return Put(
        str(sample.key_expr),
        _taken_bytes(sample.payload, PAYLOAD_LIMIT) or b"",
        str(sample.encoding),
        _taken_bytes(sample.attachment, ATTACHMENT_LIMIT),
        sample.kind == zenoh.SampleKind.DELETE,
    )


def _taken_bytes(data: zenoh.ZBytes | None, limit: int) -> bytes | None:
    """The bytes of a payload; of one that is too large only its size is of interest, and its copy would hold up everybody."""
    if data is None:
        return None
    return bytes(limit + 1) if len(data) > limit else data.to_bytes()


class _Reply:
    """The `Answer` to a query, given by the sender's thread: a reply is never dropped, so it may wait for a slow peer."""

    def __init__(self, query: zenoh.Query, sender: Worker) -> None:
        self._query = query
        self._sender = sender

    def reply(self, key: str, payload: bytes, media: str, attachment: bytes | None = None) -> None:
        self._sender.send(lambda: self._query.reply(key, payload, encoding=media, attachment=attachment, express=True))

    def refuse(self, payload: bytes, media: str) -> None:
        self._sender.send(lambda: self._query.reply_err(payload, encoding=media))

    def end(self) -> None:
        self._sender.send(self._query.drop)


def _question(query: zenoh.Query, sender: Worker) -> Question:
    payload, encoding = query.payload, query.encoding
    key = query.key_expr
    intersects: Callable[[str], bool] = key.intersects
    return Question(
        str(key),
        query.parameters,
        _taken_bytes(payload, PAYLOAD_LIMIT),
        "" if payload is None or encoding is None else str(encoding),
        _taken_bytes(query.attachment, ATTACHMENT_LIMIT),
        _Reply(query, sender),
        intersects,
    )
