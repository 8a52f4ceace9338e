"""The adapter of a scenario file that says nothing of adapters: somebody who runs it wants to reach it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from uwserver.scenario.files.documents import Document

KIND = "sockets"


def with_default_adapter(document: Document, adapters: Mapping[str, type]) -> Document:
    """The file with `[adapters.sockets]` at its defaults, TCP port 7600, where it has no table `adapters`.

    An empty table is left as it is: nothing listens then. So is a scenario that was made in Python, which mostly runs in its own process.
    """
    if document.path is None or "adapters" in document.raw or KIND not in adapters:
        return document
    raw: dict[str, Any] = {**document.raw, "adapters": {KIND: {"kind": KIND}}}
    return replace(document, raw=raw)
