"""The answers to HTTP requests: the page and its files, a description of the scene, and whether the server is healthy.

The files are listed once, at the first request, and nothing else is ever served. One connection gets one answer.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import logging
import re
import threading
import zlib
from collections.abc import Callable, Coroutine, Mapping
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from uwserver.adapter import AdapterContext, Refusals, is_host_known
from uwserver.adapter.http import Request
from uwserver.ports import Progress, Refused, Reply, SceneState
from uwserver_adapters.web.config import WebConfig
from uwserver_adapters.web.service import WebService

log = logging.getLogger(__name__)

KINDS: Final[Mapping[str, str]] = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".json": "application/json",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".webp": "image/webp",
    ".ico": "image/vnd.microsoft.icon",
    ".woff2": "font/woff2",
    ".glb": "model/gltf-binary",
    ".txt": "text/plain; charset=utf-8",
}
"""Content type by suffix. Files with other suffixes are not served."""
_COMPRESSED: Final = ("text/", "application/json", "image/svg")
"""Beginnings of the content types that are compressed."""
INDEX: Final = "index.html"
_MOST_FILES = 2000
_IMPORT_MAP: Final = re.compile(rb'<script\s+type="importmap"\s*>(.*?)</script>', re.DOTALL)
NO_PAGE: Final = b"""<!doctype html><meta charset="utf-8"><title>uwserver</title>
<p>The files of the web view are missing in this installation of uwserver; its data are served here all the same: /world.json and /live.</p>
"""
LIVE: Final = "/live"
_BY_HASH: Final = re.compile(r"/(mesh|looks)/([0-9a-f]{64})\.(bin|glb)")
_FOR_EVER: Final = ("Cache-Control", "private, max-age=31536000, immutable")
_ANEW: Final = ("Cache-Control", "no-cache")
_JSON: Final = "application/json"


class Answer(NamedTuple):
    """An answer, after which the connection is closed.

    Attributes:
        status: code and phrase.
        body: the body, which is not sent for HEAD.
        kind: content type; "" without a body.
        headers: further headers.
    """

    status: str
    body: bytes = b""
    kind: str = "text/plain; charset=utf-8"
    headers: tuple[tuple[str, str], ...] = ()

    def head(self) -> bytes:
        """Return everything before the body. Pages of other origins can neither read the answer nor use it as a script, style or picture."""
        lines = [
            f"HTTP/1.1 {self.status}",
            f"Content-Length: {len(self.body)}",
            "X-Content-Type-Options: nosniff",
            "Referrer-Policy: no-referrer",
            "Cross-Origin-Resource-Policy: same-origin",
            "Connection: close",
        ]
        if self.kind:
            lines.append(f"Content-Type: {self.kind}")
        lines += [f"{name}: {value}" for name, value in self.headers]
        return ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1", "replace")


def text(status: str, body: str, *headers: tuple[str, str]) -> Answer:
    """Return an answer with a short text."""
    return Answer(status, body.encode() + b"\n", headers=headers)


def takes_gzip(request: Request) -> bool:
    """Return whether the peer accepts gzip."""
    for offer in ",".join(request.headers.get("accept-encoding", ())).split(","):
        name, _, weight = offer.partition(";")
        if name.strip().lower() in ("gzip", "*"):
            return weight.replace(" ", "") not in ("q=0", "q=0.0", "q=0.00", "q=0.000")
    return False


def is_same(request: Request, etag: str) -> bool:
    """Return whether the peer already has this version."""
    known = ",".join(request.headers.get("if-none-match", ()))
    return etag in {each.strip().removeprefix("W/") for each in known.split(",")}


class StaticFile(NamedTuple):
    """A file as it is sent.

    Attributes:
        data, gzipped: its content, and the same by gzip; None where that is not smaller.
        kind, etag: content type and entity tag.
        scripts: hashes of scripts within a page, for its Content-Security-Policy.
    """

    data: bytes
    gzipped: bytes | None
    kind: str
    etag: str
    scripts: tuple[str, ...] = ()


class Files:
    """Files below a folder, by the path of a URL. Each is read and compressed once, when it is first requested.

    Args:
        folder: folder of the page, which need not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._manifest: dict[str, Path] | None = None
        self._known: dict[str, StaticFile] = {}
        self._lock = threading.Lock()

    def has(self, path: str) -> bool:
        """Return whether there is such a file."""
        return path == "/" or path in self._paths()

    def read(self, path: str) -> StaticFile:
        """Return a file. Must run on a thread: the first time it takes up to 0.1 s, most of it without the interpreter lock.

        Raises:
            OSError: the file existed at the first request, but can no longer be read.
        """
        with self._lock:  # a second request for the same file waits instead of compressing it again
            known = self._known.get(path)
            if known is None:
                place = self._paths().get(f"/{INDEX}" if path == "/" else path)
                kind = KINDS[".html"] if place is None else KINDS[place.suffix]
                known = self._known[path] = static_file(NO_PAGE if place is None else place.read_bytes(), kind)
            return known

    def _paths(self) -> dict[str, Path]:
        if self._manifest is None:
            found = {}
            for place in sorted(self._folder.rglob("*"))[:_MOST_FILES] if self._folder.is_dir() else ():
                inside = place.relative_to(self._folder)
                hidden = any(part.startswith(".") for part in inside.parts)
                if place.suffix in KINDS and place.is_file() and not place.is_symlink() and not hidden:
                    found[f"/{inside.as_posix()}"] = place
            self._manifest = found
        return self._manifest


def static_file(data: bytes, kind: str) -> StaticFile:
    """Return a file with these bytes."""
    gzipped = None
    if kind.startswith(_COMPRESSED):
        packer = zlib.compressobj(9, zlib.DEFLATED, 31)
        gzipped = packer.compress(data) + packer.flush()
        if len(gzipped) >= len(data):
            gzipped = None
    scripts = tuple(
        "'sha256-" + base64.b64encode(hashlib.sha256(script).digest()).decode() + "'"
        for script in _IMPORT_MAP.findall(data if kind == KINDS[".html"] else b"")
    )
    return StaticFile(data, gzipped, kind, f'"{hashlib.sha256(data).hexdigest()[:32]}"', scripts)


def page_folder() -> Path:
    """Return the folder of the page: beside this module in an installation, and in the clients' folder in a checkout."""
    beside = Path(__file__).parent / "page"
    return beside if beside.is_dir() else Path(__file__).parents[3] / "clients" / "web"


_WANTS_TOKEN: Final = text(
    "401 Unauthorized", "this server wants a token: Authorization: Bearer ...", ("WWW-Authenticate", "Bearer")
)


OnAnswer = Callable[[Answer], None]


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
