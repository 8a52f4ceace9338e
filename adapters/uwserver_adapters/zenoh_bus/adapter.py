"""The `zenoh` adapter: its session, and the hand-over between zenoh's threads and the loop."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from uwserver.adapter import AdapterBase, AdapterContext, CannotServe, EncodingName, Inbox, Worker, serving
from uwserver_adapters.zenoh_bus.codec import ATTACHMENT_LIMIT, PAYLOAD_LIMIT, Codec
from uwserver_adapters.zenoh_bus.keys import KeyScheme
from uwserver_adapters.zenoh_bus.requests import CLIENTS, Put, Question, Requests
from uwserver_adapters.zenoh_session.config import ZenohConfig
from uwserver_adapters.zenoh_session.session import direct, open_session

if TYPE_CHECKING:
    import zenoh

log = logging.getLogger(__name__)

TAKEN_S = 0.8
"""Wall time to wait for other servers of the same name; peers that have nothing to say answer at once."""
PEERS_S = 0.5
"""Wall time between two counts of the peers."""


class ZenohAdapter(AdapterBase[ZenohConfig]):
    """Serves ports and services on a zenoh network, as README.md says."""

    Config = ZenohConfig

    def __init__(self, config: ZenohConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        self.keys = KeyScheme(config.prefix, config.server or context.world.server)
        self._zid = ""
        self._clients: set[str] = set()

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: zenoh is not installed, a setting is wrong, an endpoint cannot be had, or the server's name is taken.
        """
        async with open_session(self.config, self.context, "zenoh sender") as (session, sender):
            self._zid = str(session.zid())
            await sender.run(lambda: self._check_name(session))
            await self._serve(session, sender, ready)

    def _check_name(self, session: zenoh.Session) -> None:
        """Check that no other server has our name. Must not run on the loop.

        Raises:
            CannotServe: another server has it.
        """
        own = self.keys.identity(self._zid)
        for reply in session.liveliness().get(self.keys.identities, timeout=TAKEN_S):
            if reply.ok is not None and str(reply.ok.key_expr) != own:
                raise CannotServe(_taken(self.keys))

    async def _serve(self, session: zenoh.Session, sender: Worker, ready: asyncio.Event) -> None:
        import zenoh

        from uwserver_adapters.zenoh_bus.publications import Publications

        config, keys, stats = self.config, self.keys, self.context.stats
        codecs: dict[EncodingName, Codec] = {"json": Codec("json"), "msgpack": Codec("msgpack")}
        publications = Publications(self.context, session, keys, codecs[config.encoding], sender)
        requests = Requests(
            self.context,
            keys,
            codecs,
            config.encoding,
            config.call_timeout_s,
            publications.tell,
            publications.refresh_matching,
        )

        def inbox(take: Callable[[Any], None]) -> Callable[[Any], None]:
            """Return what zenoh's threads call, so that `take` is called on the loop."""
            return Inbox(take, config.queue_requests, self._drop).put

        puts = inbox(lambda sample: requests.take_put(_put(sample)))
        gets = inbox(lambda query: requests.take_question(_question(query, sender)))
        losses = inbox(lambda sample: requests.take_loss(_put(sample)))
        # A session does not hear what it puts itself: our own samples do not come back as commands.
        session.declare_subscriber(keys.everything, direct(puts), allowed_origin=zenoh.Locality.REMOTE)
        for key in keys.requests:
            session.declare_queryable(key, direct(gets))
        session.declare_subscriber(keys.losses, direct(losses), allowed_origin=zenoh.Locality.REMOTE)
        liveliness = session.liveliness()
        tokens = inbox(lambda sample: self._client_token(sample, requests))
        liveliness.declare_subscriber(keys.clients, direct(tokens), history=True)
        liveliness.declare_subscriber(keys.identities, direct(inbox(self._server_token)), history=True)
        identity = liveliness.declare_token(keys.identity(self._zid))
        publications.open()
        alive = liveliness.declare_token(keys.alive())
        try:
            with serving(self.context, publications, stats.address, ready):
                while True:
                    publications.refresh_matching()
                    # A named client behind a router is known only by its token. Most clients use the id of their session as name.
                    stats.peers = len({str(peer.zid) for peer in session.info.transports()} | self._clients)
                    await asyncio.sleep(PEERS_S)
        finally:
            requests.close()
            self._clients.clear()
            alive.undeclare()
            identity.undeclare()

    def _drop(self, item: zenoh.Sample | zenoh.Query) -> None:
        """Count what is dropped because too much waits for the loop. Called on a zenoh thread."""
        self.context.stats.dropped += 1

    def _client_token(self, sample: zenoh.Sample, requests: Requests) -> None:
        """Note that a client came or went."""
        import zenoh

        client = str(sample.key_expr).rsplit("/", 1)[-1]
        if sample.kind == zenoh.SampleKind.DELETE:
            self._clients.discard(client)
            requests.client_left(client)
        elif len(self._clients) < CLIENTS:
            self._clients.add(client)

    def _server_token(self, sample: zenoh.Sample) -> None:
        """Complain of another server with our name."""
        import zenoh

        zid = str(sample.key_expr).rsplit("/", 1)[-1]
        if sample.kind == zenoh.SampleKind.PUT and zid != self._zid:
            self.context.stats.count_error(_taken(self.keys))
            log.error("%s", _taken(self.keys))


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
        _bytes(sample.payload, PAYLOAD_LIMIT) or b"",
        str(sample.encoding),
        _bytes(sample.attachment, ATTACHMENT_LIMIT),
        sample.kind == zenoh.SampleKind.DELETE,
    )


def _bytes(data: zenoh.ZBytes | None, limit: int) -> bytes | None:
    """Return the bytes of a payload. One that is too large is not copied, as only its excess matters, and copying would hold up everybody."""
    if data is None:
        return None
    return bytes(limit + 1) if len(data) > limit else data.to_bytes()


class _Reply:
    """Answers a query on the sender's thread. A reply is never dropped, so it may have to wait for a slow peer. Implements `Answer`."""

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
    payload, encoding, key = query.payload, query.encoding, query.key_expr
    intersects: Callable[[str], bool] = key.intersects
    return Question(
        str(key),
        query.parameters,
        _bytes(payload, PAYLOAD_LIMIT),
        "" if payload is None or encoding is None else str(encoding),
        _bytes(query.attachment, ATTACHMENT_LIMIT),
        _Reply(query, sender),
        intersects,
    )
