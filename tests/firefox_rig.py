"""Firefox, without a desktop where there is none, by WebDriver BiDi, which it speaks itself: no driver has to be installed for it."""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

PROGRAM = "UWSERVER_FIREFOX"
"""Variable: the path of a Firefox that is not on PATH."""
NAMES = ("firefox-esr", "firefox")
PATIENCE_S = 120.0
_LISTENS = re.compile(r"WebDriver BiDi listening on (ws://\S+)")
_PREFERENCES = ('user_pref("webgl.force-enabled", true);', 'user_pref("webgl.out-of-process", false);')
"""Drawn in software where there is no graphics card."""


def firefox_or_skip() -> str:
    """Its path; the test is skipped where there is none."""
    named = os.environ.get(PROGRAM)
    found = shutil.which(named) if named else next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"no Firefox is installed (apt install firefox-esr), and {PROGRAM} names none")
    return found


class Firefox:
    """A running browser with one page."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._ids = itertools.count(1)
        self.faults: list[str] = []
        self.say("session.new", capabilities={})
        self.say("session.subscribe", events=["log.entryAdded"])
        self._context = self.say("browsingContext.getTree")["contexts"][0]["context"]

    def say(self, method: str, **params: Any) -> dict[str, Any]:
        """A command and its result."""
        number = next(self._ids)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv(PATIENCE_S))
            if answer.get("id") == number:
                assert answer["type"] == "success", answer
                result: dict[str, Any] = answer["result"]
                return result
            if answer.get("method") == "log.entryAdded" and answer["params"]["level"] == "error":
                self.faults.append(str(answer["params"]["text"]))

    def open(self, url: str, size: tuple[int, int]) -> None:
        """Show a page."""
        viewport = {"width": size[0], "height": size[1]}
        self.say("browsingContext.setViewport", context=self._context, viewport=viewport)
        self.say("browsingContext.navigate", context=self._context, url=url, wait="complete")

    def ask(self, expression: str) -> Any:
        """The value of an expression; objects and lists come as JSON."""
        told = self.say(
            "script.evaluate",
            expression=f"(async () => JSON.stringify(await ({expression})) ?? 'null')()",
            target={"context": self._context},
            awaitPromise=True,
        )
        assert told["type"] == "success", told
        return json.loads(told["result"]["value"])

    def wait(self, condition: str, why: str) -> None:
        """Until an expression is true."""
        end = time.monotonic() + PATIENCE_S
        while not self.ask(f"Boolean({condition})"):
            assert time.monotonic() < end, (why, self.faults, self.ask("window.uw?.said ?? []"))
            time.sleep(0.1)

    @contextlib.contextmanager
    def holding(self, key: str) -> Iterator[None]:
        """With a key held down."""
        self._press("keyDown", key)
        try:
            yield
        finally:
            self._press("keyUp", key)

    def _press(self, kind: str, key: str) -> None:
        action = {"type": kind, "value": key}
        keyboard = {"type": "key", "id": "keyboard", "actions": [action]}
        self.say("input.performActions", context=self._context, actions=[keyboard])

    def picture(self, path: Path) -> None:
        """Keep what it looks like, as a PNG."""
        told = self.say("browsingContext.captureScreenshot", context=self._context)
        path.write_bytes(base64.b64decode(told["data"]))


@contextlib.contextmanager
def running(program: str, folder: Path) -> Iterator[Firefox]:
    """A Firefox with a profile of its own in a folder; it ends with the block."""
    profile = folder / "profile"
    profile.mkdir()
    (profile / "user.js").write_text("\n".join(_PREFERENCES))
    told = folder / "told.txt"
    desktop = [] if "DISPLAY" in os.environ else ["--headless"]
    command = [program, *desktop, "--no-remote", "--remote-debugging-port", "0", "--profile", str(profile)]
    environment = {**os.environ, "HOME": str(folder)}
    with (
        told.open("wb") as file,
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=file, env=environment) as process,
    ):
        try:
            end = time.monotonic() + PATIENCE_S
            while not (found := _LISTENS.search(told.read_text(errors="replace"))):
                assert process.poll() is None, told.read_text(errors="replace")[-500:]
                assert time.monotonic() < end, "Firefox does not listen"
                time.sleep(0.1)
            with connect(f"{found[1]}/session", max_size=None, open_timeout=PATIENCE_S) as socket:
                yield Firefox(socket)
        finally:
            process.kill()
