"""Drives Chromium without a desktop, through its DevTools protocol. No driver has to be installed."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import re
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from uwserver.cli.browser.child import child
from uwserver.simulation.clock import SystemTime
from uwserver.units import NANOSECONDS

PATIENCE_S = 150.0
"""Wall time to wait for an answer, enough for a picture on a busy machine."""
NAMES = ("chromium", "chromium-browser", "google-chrome")
"""Names of the programs that are tried."""
FORMATS = {".png": "png", ".webp": "webp", ".jpg": "jpeg", ".jpeg": "jpeg"}
"""Suffixes of picture files, each with its DevTools name."""
# Software rendering gives the same picture with any graphics card, or none. The sandbox does not work in most containers, and only pages of our
# own servers are opened. Containers also have little shared memory.
_OPTIONS = (
    "--headless=new", "--no-sandbox", "--no-first-run", "--disable-extensions", "--remote-debugging-port=0", "--mute-audio",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--window-size=900,620",
    "--disable-dev-shm-usage",
)  # fmt: skip
_LISTENS = re.compile(r"DevTools listening on (ws://\S+)")
_QUALITY = 85
"""Quality of the lossy formats, per cent."""
_POLL_S = 0.05
_TIME = SystemTime()
_KEYS = {"Space": " ", "Enter": "\r", "Tab": "\t"}


class NoChromium(Exception):
    """No Chromium was found; the text says what to install."""


class ChromiumFailed(Exception):
    """Chromium did not start or has ended, or a page did not reach the expected state; the text says why."""


def chromium(name: str = "") -> str:
    """Return the path of the browser.

    Args:
        name: name or path of a program; "" tries `NAMES`.

    Raises:
        NoChromium: there is no such program.
    """
    for each in (name,) if name else NAMES:
        if path := shutil.which(each):
            return path
    if name:
        raise NoChromium(f'no program "{name}" can be run: name the one of Chromium or Chrome')
    raise NoChromium(
        f"no Chromium is installed here (looked for {', '.join(NAMES)}): install it (apt install chromium), "
        "or name a program by --browser"
    )


class Browser:
    """A running Chromium.

    Attributes:
        pages: open pages by DevTools session.
    """

    def __init__(self, socket: ClientConnection, before: str) -> None:
        """Speak to Chromium through a connected socket; each page runs the script `before` ahead of its own scripts."""
        self._socket = socket
        self._before = before
        self._id = 0
        self.pages: dict[str, Page] = {}

    def say(self, method: str, session: str | None = None, **params: Any) -> dict[str, Any]:
        """Send a DevTools command, to one page if there is a `session`, and return its result.

        Raises:
            ChromiumFailed: the command is refused, or there is no answer.
        """
        self._id += 1
        message = {"id": self._id, "method": method, "params": params}
        try:
            self._socket.send(json.dumps(message if session is None else {**message, "sessionId": session}))
            return self._answer(method)
        except (WebSocketException, TimeoutError) as error:
            raise ChromiumFailed(f"Chromium does not answer {method}: {error}") from error

    def _answer(self, method: str) -> dict[str, Any]:
        while True:
            answer: dict[str, Any] = json.loads(self._socket.recv(PATIENCE_S))
            if answer.get("id") == self._id:
                if "error" in answer:
                    raise ChromiumFailed(f"{method}: {answer['error']}")
                result: dict[str, Any] = answer["result"]
                return result
            page = self.pages.get(answer.get("sessionId", ""))
            if page is not None:
                page.hear(answer)

    def open(self, url: str, before: str = "", size: tuple[int, int] = (900, 560)) -> Page:
        """Open a page in a profile of its own. The page believes that it has the focus, and runs the script `before` first."""
        context = self.say("Target.createBrowserContext")["browserContextId"]
        target = self.say("Target.createTarget", url="about:blank", browserContextId=context, newWindow=True)[
            "targetId"
        ]
        session = self.say("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = self.pages[session] = Page(self, session, context)
        for domain in ("Page", "Runtime", "Log", "Network"):
            page.say(f"{domain}.enable")
        page.say("Emulation.setFocusEmulationEnabled", enabled=True)
        page.say("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False)
        page.say("Page.addScriptToEvaluateOnNewDocument", source=f"{self._before}\n{before}")
        page.say("Page.navigate", url=url)
        return page


class Page:
    """One open page.

    Attributes:
        faults: complaints of the console, the network and the scripts.
        loading: DevTools' identifiers of the files that are being loaded.
    """

    def __init__(self, browser: Browser, session: str, context: str) -> None:
        self._browser, self._session, self._context = browser, session, context
        self.faults: list[str] = []
        self.loading: set[str] = set()

    def say(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a DevTools command to this page; see `Browser.say`."""
        return self._browser.say(method, self._session, **params)

    def hear(self, event: dict[str, Any]) -> None:
        """Take in an event that the page has sent."""
        params = event.get("params", {})
        if event["method"] == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
            self.faults.append(str([argument.get("value", argument.get("description")) for argument in params["args"]]))
        elif event["method"] == "Runtime.exceptionThrown":
            self.faults.append(_described(params["exceptionDetails"]))
        elif event["method"] == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.faults.append(f"{params['entry']['text']} {params['entry'].get('url', '')}")
        elif event["method"] == "Network.responseReceived" and params["response"]["status"] >= 400:
            self.faults.append(f"{params['response']['status']} {params['response']['url']}")
        elif event["method"] == "Network.requestWillBeSent":
            self.loading.add(params["requestId"])
        elif event["method"] in ("Network.loadingFinished", "Network.loadingFailed"):
            self.loading.discard(params["requestId"])

    def ask(self, expression: str) -> Any:
        """Return the value of a JavaScript expression; a promise is awaited.

        Raises:
            ChromiumFailed: the expression throws.
        """
        found = self.say("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise ChromiumFailed(f"{expression}: {_described(found['exceptionDetails'])}")
        return found["result"].get("value")

    def wait(self, condition: str, why: str = "", sign: str = "0") -> None:
        """Wait until a JavaScript expression is true.

        Args:
            condition: the expression.
            why: what its failure means, for the error text.
            sign: an expression that changes while there is progress; each change starts the time-out again.

        Raises:
            ChromiumFailed: it was not true for `PATIENCE_S`.
        """
        since, seen = _TIME.now_ns(), None
        while True:
            is_true, now = self.ask(f"[Boolean({condition}), {sign}]")
            if is_true:
                return
            if now != seen:
                since, seen = _TIME.now_ns(), now
            if _TIME.now_ns() - since > PATIENCE_S * NANOSECONDS:
                raise ChromiumFailed(f"{why or condition}: {self.faults} {self.ask('window.uw?.said')}")
            pause(2 * _POLL_S)

    def key(self, code: str, down: bool) -> None:
        """Press or release a key, named as in `KeyboardEvent.code`."""
        text = _KEYS.get(code, code.removeprefix("Key").lower())
        number = {"Space": 32, "Enter": 13, "Tab": 9}.get(code, ord(text[0].upper()))
        kind = "rawKeyDown" if down else "keyUp"
        name = code if code in ("Tab", "Enter") else text
        self.say("Input.dispatchKeyEvent", type=kind, code=code, key=name, windowsVirtualKeyCode=number)

    @contextlib.contextmanager
    def holding(self, *codes: str) -> Iterator[None]:
        """Hold keys down within the block."""
        for code in codes:
            self.key(code, True)
        try:
            yield
        finally:
            for code in codes:
                self.key(code, False)

    def click(self, selector: str) -> None:
        """Click the element of a CSS selector, once it is there."""
        self.wait(f"document.querySelector({selector!r})")
        self.ask(f"document.querySelector({selector!r}).click()")

    def picture(self, path: Path) -> None:
        """Write a picture of the page; the suffix of the file is one of `FORMATS`."""
        kind = FORMATS[path.suffix.lower()]
        quality = {} if kind == "png" else {"quality": _QUALITY}
        path.write_bytes(base64.b64decode(self.say("Page.captureScreenshot", format=kind, **quality)["data"]))

    def close(self) -> None:
        """Close the page and its profile."""
        self._browser.pages.pop(self._session, None)
        self._browser.say("Target.disposeBrowserContext", browserContextId=self._context)


def _described(details: dict[str, Any]) -> str:
    """Return the text of DevTools' `ExceptionDetails`."""
    return str(details.get("exception", {}).get("description", details["text"]))


def pause(seconds: float) -> None:
    """Let wall time pass."""
    _TIME.wait(seconds, threading.Event())


@contextlib.contextmanager
def browsing(program: str, folder: Path, before: str = "") -> Iterator[Browser]:
    """Run the browser until the end of the block.

    Args:
        program: its path (see `chromium`).
        folder: for its profile and everything else that it writes. The path must be short, because Chromium makes a socket in it.
        before: a script that each page runs ahead of its own scripts.

    Raises:
        ChromiumFailed: the browser does not start.
    """
    command = [program, *_OPTIONS, f"--user-data-dir={folder / 'profile'}", "about:blank"]
    told = folder / "told.txt"
    environment = {**os.environ, "TMPDIR": str(folder)}
    with told.open("wb") as file, child(command, stdout=subprocess.DEVNULL, stderr=file, env=environment) as process:
        try:
            # No pings: on a busy machine Chromium is silent for longer than their time-out.
            socket = connect(_address(told, process), max_size=None, open_timeout=PATIENCE_S, ping_interval=None)
        except (OSError, WebSocketException) as error:
            raise ChromiumFailed(f"{program} cannot be reached: {error}") from error
        with socket:
            browser = Browser(socket, before)
            yield browser
            with contextlib.suppress(ChromiumFailed):
                browser.say("Browser.close")


def _address(told: Path, process: subprocess.Popen[Any]) -> str:
    """Return the address of DevTools from what Chromium prints. The file in its profile may be elsewhere: a snap has a /tmp of its own."""
    since = _TIME.now_ns()
    while _TIME.now_ns() - since < PATIENCE_S * NANOSECONDS:
        # Before the file is read: a process that ended after this has written all its words.
        has_ended = process.poll() is not None
        text = told.read_text(errors="replace")
        if found := _LISTENS.search(text):
            return found[1]
        if has_ended:
            raise ChromiumFailed(
                f"Chromium ended at once, with status {process.returncode}: {text.strip()[-500:] or 'it said nothing'}"
            )
        pause(_POLL_S)
    raise ChromiumFailed(f"Chromium did not start within {PATIENCE_S:g} s")
