"""The address of the web view, and the browser of this desktop."""

from __future__ import annotations

import threading
from collections.abc import Callable
from urllib.parse import quote


def with_token(address: str, token: str | None) -> str:
    """Return the address of a page with its token in the fragment, which browsers do not send to a server."""
    return f"{address}#token={quote(token, safe='')}" if address and token else address


def open_in_browser(address: str, failed: Callable[[str], None]) -> threading.Thread:
    """Open a page in the browser of this desktop.

    Args:
        address: address of the page.
        failed: takes the address if there is no browser, on the thread that is returned.

    Returns:
        The thread that opens it, named "browser", because a browser in a terminal runs until its user ends it, and some take seconds to
        answer.
    """
    thread = threading.Thread(target=_open, args=(address, failed), name="browser", daemon=True)
    thread.start()
    return thread


def _open(address: str, failed: Callable[[str], None]) -> None:
    import webbrowser

    if not webbrowser.open(address):
        failed(address)
