"""The answers to HTTP requests: the page, a description of the scene, and whether the server is healthy."""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Callable, Coroutine
from typing import Final

import msgspec

from uwserver.adapter import AdapterContext, Refusals, is_host_known
from uwserver.adapter.http import Request
from uwserver.ports import Progress, Refused, Reply, SceneState
from uwserver_adapters.web.config import WebConfig
from uwserver_adapters.web.files import Files, StaticFile, static_file
from uwserver_adapters.web.http import Answer, is_same, takes_gzip, text
from uwserver_adapters.web.service import WebService

log = logging.getLogger(__name__)

OnAnswer = Callable[[Answer], None]
LIVE: Final = "/live"
_BY_HASH: Final = re.compile(r"/(mesh|looks)/([0-9a-f]{64})\.(bin|glb)")
_FOR_EVER: Final = ("Cache-Control", "private, max-age=31536000, immutable")
_ANEW: Final = ("Cache-Control", "no-cache")
_JSON: Final = "application/json"
_WANTS_TOKEN: Final = text(
    "401 Unauthorized", "this server wants a token: Authorization: Bearer ...", ("WWW-Authenticate", "Bearer")
)


class Site:
    """Answers requests.

    Args:
        context: the adapter's context.
        config: the adapter's table.
        files: the files of the page.
        service: knows the tokens.
        refusals: counts and logs what was refused.
    """

    def __init__(
        self, context: AdapterContext, config: WebConfig, files: Files, service: WebService, refusals: Refusals
    ) -> None:
        self._context = context
        self._config = config
        self._files = files
        self._service = service
        self._refusals = refusals
        self._scene: tuple[int, asyncio.Future[StaticFile]] | None = None
        self._has_logged_failure = False
        self._reading: set[asyncio.Task[None]] = set()

    def objection(self, request: Request) -> Answer | None:
        """Return why a request is refused, whatever it asks for; None if it is not."""
        hosts = request.headers.get("host", ())
        if len(hosts) != 1 or not is_host_known(hosts[0], self._config.allowed_hosts):
            # With DNS rebinding another page's name points here, and its browser takes us for that page's origin.
            name = hosts[0][:200] if hosts else ""
            reason = f'"{name}" is not a known name of this server: use its address, or add the name to allowed_hosts'
            self._refusals.note("host", reason)
            return text("421 Misdirected Request", reason)
        if request.method not in ("GET", "HEAD"):
            self._refusals.note("method", f"{request.method[:20]} is neither GET nor HEAD")
            return text("405 Method Not Allowed", "use GET or HEAD", ("Allow", "GET, HEAD"))
        return None

    def origins(self, request: Request) -> tuple[str, ...]:
        """Return the origins of pages that may connect to the live data: that of this page, and configured ones."""
        host = request.header("host")
        scheme = "http" if self._config.tls_cert is None else "https"
        return (f"{scheme}://{host}", *self._config.allowed_origins)

    def answer(self, request: Request, host: str, on_answer: OnAnswer) -> None:
        """Answer a request of a host once, now or later."""
        found = self.objection(request)
        path = request.path
        if found is None and self._files.has(path):
            self._later(self._file(request, on_answer))
            return
        if found is None:
            found = self._objection_to_data(request, host)
        if found is None and path == "/world.json":
            self._send_scene(request, on_answer)
            return
        on_answer(found or self._data(path))

    def _objection_to_data(self, request: Request, host: str) -> Answer | None:
        """Return why a request gets no data. Only our own page gets them, and clients that are not browsers."""
        site = request.header("sec-fetch-site")
        if site not in ("", "same-origin", "none"):
            self._refusals.note("origin", f"a page of another origin ({site}) asked for {request.path[:100]}")
            return text("403 Forbidden", "pages of other origins get no data")
        if self._service.token is not None:
            now, lockout = asyncio.get_running_loop().time(), self._service.lockout
            if lockout.is_out(host, now):
                return text("429 Too Many Requests", lockout.fault.text)
            kind, _, token = request.header("authorization").partition(" ")
            if kind.lower() != "bearer" or not self._service.knows(token.strip()):
                self._refusals.note("denied", "data were requested without the token")
                if token and lockout.wrong(host, now):
                    self._refusals.note("lockout", lockout.fault.text)
                return _WANTS_TOKEN
        return None

    def _data(self, path: str) -> Answer:
        if path == "/health":
            return self._health()
        if path == LIVE:
            return text("426 Upgrade Required", "this is a WebSocket", ("Upgrade", "websocket"))
        named = _BY_HASH.fullmatch(path)
        if named is not None:
            data = self._context.mesh(named[2]) if named[1] == "mesh" else self._context.model_file(named[2])
            if data is not None and (named[1] == "mesh") == (named[3] == "bin"):
                kind = "application/octet-stream" if named[1] == "mesh" else "model/gltf-binary"
                return Answer("200 OK", data, kind, (_FOR_EVER,))
        return text("404 Not Found", "there are /, /world.json, /mesh/..., /looks/..., /health and /live here")

    def _health(self) -> Answer:
        answers: list[Reply | Progress] = []
        self._context.call("world/status", {}, "health", answers.append)
        (answer,) = answers
        now = answer.result if isinstance(answer, Reply) else None
        failed = isinstance(now, dict) and now.get("failure")
        status = "503 Service Unavailable" if failed else "200 OK"
        return Answer(status, msgspec.json.encode(now), _JSON, (("Cache-Control", "no-store"),))

    # -- files ----------------------------------------------------------------------------------------------------------------------

    async def _file(self, request: Request, on_answer: OnAnswer) -> None:
        try:
            found = await asyncio.get_running_loop().run_in_executor(None, self._files.read, request.path)
        except OSError as error:
            on_answer(text("404 Not Found", f"the file can no longer be read: {error.strerror}"))
            return
        on_answer(_sent(request, found, (("Content-Security-Policy", self.policy(found)),)))

    def policy(self, page: StaticFile) -> str:
        """Return what a browser lets the page do: nothing that is not from this server."""
        ancestors = " ".join(self._config.frame_ancestors) or "'none'"
        scripts = " ".join(("'self'", *page.scripts))
        return (
            f"default-src 'self'; script-src {scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' blob: data:; "
            f"connect-src 'self' blob:; worker-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'none'; "
            f"frame-ancestors {ancestors}"
        )

    # -- the scene ------------------------------------------------------------------------------------------------------------------

    def _send_scene(self, request: Request, on_answer: OnAnswer) -> None:
        def show(state: SceneState) -> None:
            self._later(self._described(state, request, on_answer))

        try:
            self._context.request_scene_state(show, "scene")
        except Refused as refused:
            on_answer(text("503 Service Unavailable", refused.fault.text, ("Retry-After", "1")))

    async def _described(self, state: SceneState, request: Request, on_answer: OnAnswer) -> None:
        try:
            # All requests in the meantime share one description. The shield keeps it for the others when one of them goes away.
            packed = await asyncio.shield(self._packed_scene(state))
        except Exception:  # a fault of ours; the client is told too
            if not self._has_logged_failure:
                self._has_logged_failure = True
                log.exception("the scene cannot be described")
            on_answer(text("500 Internal Server Error", "the server failed to describe the scene: see its log"))
            return
        on_answer(_sent(request, packed, ()))

    def _packed_scene(self, state: SceneState) -> asyncio.Future[StaticFile]:
        """Return the description of the scene, which is made once for each revision."""
        revision = state.entities.revision
        if self._scene is None or self._scene[0] != revision or _has_failed(self._scene[1]):
            scene = self._context.scene(state.entities)
            extra = {"exact_poses": self._config.shows_poses, "read_only": self._config.read_only}
            data = msgspec.json.encode({**msgspec.structs.asdict(scene), **extra})
            self._scene = revision, asyncio.get_running_loop().run_in_executor(None, static_file, data, _JSON)
        return self._scene[1]

    def _later(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._reading.add(task)
        task.add_done_callback(self._reading.discard)

    async def close(self) -> None:
        """Cancel answers in progress."""
        for task in list(self._reading):
            task.cancel()
        await asyncio.gather(*self._reading, return_exceptions=True)


def _has_failed(work: asyncio.Future[StaticFile]) -> bool:
    return work.done() and (work.cancelled() or work.exception() is not None)


def _sent(request: Request, found: StaticFile, headers: tuple[tuple[str, str], ...]) -> Answer:
    """Return a file in the form that this peer accepts."""
    headers = (*headers, _ANEW, ("ETag", found.etag), ("Vary", "Accept-Encoding"))
    if is_same(request, found.etag):
        return Answer("304 Not Modified", b"", "", headers)
    if found.gzipped is not None and takes_gzip(request):
        return Answer("200 OK", found.gzipped, found.kind, (*headers, ("Content-Encoding", "gzip")))
    return Answer("200 OK", found.data, found.kind, headers)
