"""The files of the page. They are listed once, at the first request, and nothing else is ever served."""

from __future__ import annotations

import base64
import hashlib
import re
import threading
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

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
