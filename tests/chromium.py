"""A real browser for tests: Debian's Chromium without a window, by its DevTools protocol. No driver has to be installed for it."""

from __future__ import annotations

import base64
import contextlib
import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

PATIENCE_S = 180.0
"""For a picture on a machine that does much else."""
PROBES = Path(__file__).parent / "page_probes.js"
_NAMES = ("chromium", "chromium-browser", "google-chrome")
_OPTIONS = (
    "--headless=new", "--no-sandbox", "--no-first-run", "--disable-extensions", "--remote-debugging-port=0", "--mute-audio",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--window-size=900,620",
)  # fmt: skip
_KEYS = {"Space": " ", "Enter": "\r", "Tab": "\t"}


class Browser:
    """A running Chromium; `say` speaks to all of it."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._id = 0
        self.pages: dict[str, Page] = {}

    def say(self, method: str, session: str | None = None, **params: Any) -> dict[str, Any]:
        """A command and its result."""
        self._id += 1
        message = {"id": self._id, "method": method, "params": params}
        self._socket.send(json.dumps(message if session is None else {**message, "sessionId": session}))
        while True:
            answer: dict[str, Any] = json.loads(self._socket.recv(PATIENCE_S))
            if answer.get("id") == self._id:
                assert "error" not in answer, (method, answer["error"])
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
        page.say("Page.addScriptToEvaluateOnNewDocument", source=f"{PROBES.read_text()}\n{before}")
        page.say("Page.navigate", url=url)
        return page


class Page:
    """One page.

    Attributes:
        faults: what the console, the network and scripts complained of.
    """

    def __init__(self, browser: Browser, session: str, context: str) -> None:
        self._browser, self._session, self._context = browser, session, context
        self.faults: list[str] = []

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

    def ask(self, expression: str) -> Any:
        """The value of an expression, of a promise what it gives."""
        found = self.say("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait(self, condition: str, why: str = "") -> None:
        """Until an expression is true."""
        end = time.monotonic() + PATIENCE_S
        while not self.ask(f"Boolean({condition})"):
            assert time.monotonic() < end, f"{why or condition}: {self.faults} {self.ask('window.uw?.said')}"
            time.sleep(0.1)

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
        """Keep what it looks like."""
        path.write_bytes(base64.b64decode(self.say("Page.captureScreenshot", format="png")["data"]))

    def close(self) -> None:
        """Leave."""
        self._browser.pages.pop(self._session, None)
        self._browser.say("Target.disposeBrowserContext", browserContextId=self._context)


@contextlib.contextmanager
def browsing(folder: Path) -> Iterator[Browser]:
    """A browser with a profile in a folder; the test is skipped where there is none."""
    program = next((found for name in _NAMES if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium is installed")
    command = [program, *_OPTIONS, f"--user-data-dir={folder}", "about:blank"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            lines = _told(folder / "DevToolsActivePort", process)
            with connect(f"ws://127.0.0.1:{lines[0]}{lines[1]}", max_size=None, open_timeout=PATIENCE_S) as socket:
                browser = Browser(socket)
                yield browser
                with contextlib.suppress(Exception):
                    browser.say("Browser.close")
        finally:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


def _told(file: Path, process: subprocess.Popen[bytes]) -> list[str]:
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end and process.poll() is None:
        if file.is_file() and len(lines := file.read_text().split()) == 2:
            return lines
        time.sleep(0.05)
    raise AssertionError("Chromium did not start")
