"""A real browser without a desktop: Chromium by its DevTools protocol. No driver has to be installed for it."""

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

from uwserver.cli.child import child
from uwserver.simulation.clock import SystemTime
from uwserver.units import NANOSECONDS

PATIENCE_S = 150.0
"""For a picture on a machine that does much else."""
NAMES = ("chromium", "chromium-browser", "google-chrome")
"""Programs that are looked for."""
FORMATS = {".png": "png", ".webp": "webp", ".jpg": "jpeg", ".jpeg": "jpeg"}
"""Files of pictures, and what DevTools calls them."""
# Drawn in software, so that a picture is the same with any graphics card, or none. The sandbox needs what containers lack; pages of our own
# servers alone are opened. Containers have little shared memory, too.
_OPTIONS = (
    "--headless=new", "--no-sandbox", "--no-first-run", "--disable-extensions", "--remote-debugging-port=0", "--mute-audio",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--window-size=900,620",
    "--disable-dev-shm-usage",
)  # fmt: skip
_LISTENS = re.compile(r"DevTools listening on (ws://\S+)")
_QUALITY = 85
"""Of formats that lose something, per cent."""
_LOOK_S = 0.05
_TIME = SystemTime()
_KEYS = {"Space": " ", "Enter": "\r", "Tab": "\t"}


class NoChromium(Exception):
    """There is none; the text says what to install."""


class ChromiumFailed(Exception):
    """It did not start, has ended, or a page did not come to what was waited for; the text says what was the matter."""


def chromium(name: str = "") -> str:
    """Path of the browser.

    Args:
        name: of a program, or its path; "" looks for one of `NAMES`.

    Raises:
        NoChromium: there is none.
    """
    found = next((path for each in ((name,) if name else NAMES) if (path := shutil.which(each))), None)
    if found is not None:
        return found
    if name:
        raise NoChromium(f'no program "{name}" can be run: name the one of Chromium or Chrome')
    looked = ", ".join(NAMES)
    raise NoChromium(
        f"no Chromium is installed here (looked for {looked}): install it (apt install chromium), or name a program by --browser"
    )


class Browser:
    """A running Chromium; `say` speaks to all of it. `before` is run in each page ahead of its own scripts."""

    def __init__(self, socket: ClientConnection, before: str) -> None:
        self._socket = socket
        self._before = before
        self._id = 0
        self.pages: dict[str, Page] = {}

    def say(self, method: str, session: str | None = None, **params: Any) -> dict[str, Any]:
        """A command and its result.

        Raises:
            ChromiumFailed: it is refused, or there is no answer.
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
        """A page of its own profile, which believes to have the focus; `before` is run ahead of its own scripts."""
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
    """One page.

    Attributes:
        faults: what the console, the network and scripts complained of.
        loading: files that are under way, by DevTools' names.
    """

    def __init__(self, browser: Browser, session: str, context: str) -> None:
        self._browser, self._session, self._context = browser, session, context
        self.faults: list[str] = []
        self.loading: set[str] = set()

    def say(self, method: str, **params: Any) -> dict[str, Any]:
        """A command to this page."""
        return self._browser.say(method, self._session, **params)

    def hear(self, event: dict[str, Any]) -> None:
        """Something that it tells by itself."""
        params = event.get("params", {})
        if event["method"] == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
            self.faults.append(str([argument.get("value", argument.get("description")) for argument in params["args"]]))
        elif event["method"] == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.faults.append(str(details.get("exception", {}).get("description", details["text"])))
        elif event["method"] == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.faults.append(f"{params['entry']['text']} {params['entry'].get('url', '')}")
        elif event["method"] == "Network.responseReceived" and params["response"]["status"] >= 400:
            self.faults.append(f"{params['response']['status']} {params['response']['url']}")
        elif event["method"] == "Network.requestWillBeSent":
            self.loading.add(params["requestId"])
        elif event["method"] in ("Network.loadingFinished", "Network.loadingFailed"):
            self.loading.discard(params["requestId"])

    def ask(self, expression: str) -> Any:
        """The value of an expression, of a promise what it gives.

        Raises:
            ChromiumFailed: it throws.
        """
        found = self.say("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            details = found["exceptionDetails"]
            raise ChromiumFailed(f"{expression}: {details.get('exception', {}).get('description', details['text'])}")
        return found["result"].get("value")

    def wait(self, condition: str, why: str = "", sign: str = "0") -> None:
        """Until an expression is true.

        Args:
            condition: the expression.
            why: what it means, for the fault.
            sign: an expression whose change shows that something proceeds; patience begins anew then.

        Raises:
            ChromiumFailed: it is not for `PATIENCE_S`.
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
            pause(2 * _LOOK_S)

    def key(self, code: str, down: bool) -> None:
        """Press or release a key, named as by `KeyboardEvent.code`."""
        text = _KEYS.get(code, code.removeprefix("Key").lower())
        number = {"Space": 32, "Enter": 13, "Tab": 9}.get(code, ord(text[0].upper()))
        kind = "rawKeyDown" if down else "keyUp"
        name = code if code in ("Tab", "Enter") else text
        self.say("Input.dispatchKeyEvent", type=kind, code=code, key=name, windowsVirtualKeyCode=number)

    @contextlib.contextmanager
    def holding(self, *codes: str) -> Iterator[None]:
        """With keys held down."""
        for code in codes:
            self.key(code, True)
        try:
            yield
        finally:
            for code in codes:
                self.key(code, False)

    def click(self, selector: str) -> None:
        """Click what a selector names."""
        self.wait(f"document.querySelector({selector!r})")
        self.ask(f"document.querySelector({selector!r}).click()")

    def picture(self, path: Path) -> None:
        """Keep what it looks like; the name ends as one of `FORMATS`."""
        kind = FORMATS[path.suffix.lower()]
        quality = {} if kind == "png" else {"quality": _QUALITY}
        path.write_bytes(base64.b64decode(self.say("Page.captureScreenshot", format=kind, **quality)["data"]))

    def close(self) -> None:
        """Leave."""
        self._browser.pages.pop(self._session, None)
        self._browser.say("Target.disposeBrowserContext", browserContextId=self._context)


def pause(seconds: float) -> None:
    """Let wall time pass."""
    _TIME.wait(seconds, threading.Event())


@contextlib.contextmanager
def browsing(program: str, folder: Path, before: str = "") -> Iterator[Browser]:
    """A running browser, which ends with the block.

    Args:
        program: its path (see `chromium`).
        folder: for its profile and all else that it writes; the path must be short, for a socket is made in it.
        before: a script that each page runs ahead of its own ones.

    Raises:
        ChromiumFailed: it does not start.
    """
    command = [program, *_OPTIONS, f"--user-data-dir={folder / 'profile'}", "about:blank"]
    told = folder / "told.txt"
    environment = {**os.environ, "TMPDIR": str(folder)}
    with told.open("wb") as file, child(command, stdout=subprocess.DEVNULL, stderr=file, env=environment) as process:
        try:
            # Without pings: on a machine that does much else Chromium is silent for longer than these would wait.
            socket = connect(_address(told, process), max_size=None, open_timeout=PATIENCE_S, ping_interval=None)
        except (OSError, WebSocketException) as error:
            raise ChromiumFailed(f"{program} cannot be reached: {error}") from error
        with socket:
            browser = Browser(socket, before)
            yield browser
            with contextlib.suppress(ChromiumFailed):
                browser.say("Browser.close")


def _address(told: Path, process: subprocess.Popen[Any]) -> str:
    """Where DevTools listen: Chromium says it, wherever its profile really is (a snap has a /tmp of its own)."""
    since = _TIME.now_ns()
    while _TIME.now_ns() - since < PATIENCE_S * NANOSECONDS:
        has_ended = process.poll() is not None
        text = told.read_text(errors="replace")
        if found := _LISTENS.search(text):
            return found[1]
        if has_ended:
            raise ChromiumFailed(
                f"Chromium ended at once, with status {process.returncode}: {text.strip()[-500:] or 'it said nothing'}"
            )
        pause(_LOOK_S)
    raise ChromiumFailed(f"Chromium did not start within {PATIENCE_S:g} s")
