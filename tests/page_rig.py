"""A real server, and its page in a real browser: for tests of what the page shows and does."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import nursery

from uwserver.cli.browser.chromium import PATIENCE_S, Page

PYTHON = "UWSERVER_PAGE_PYTHON"
"""Variable: the Python whose installed server is tested, in place of this tree's."""
PROBES = Path(__file__).parent / "page_probes.js"


@contextlib.contextmanager
def served(scenario: str | Path, folder: Path, program: str = "") -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A server of a scenario (a file, or the name of a shipped one): the address of its page, and its process, which is a fork unless it is said
    of what program it is to be one."""
    python = os.environ.get(PYTHON) or program or nursery.python()
    there = {
        key: value for key, value in os.environ.items() if PYTHON not in os.environ or not key.startswith("PYTHON")
    }
    ports = ["--port", "0"] if isinstance(scenario, str) else []
    command = [python, "-m", "uwserver", "run", str(scenario), *ports]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=folder, env=there
    ) as process:
        try:
            assert process.stdout is not None
            found = next((f for line in process.stdout if (f := re.search(r"http://127\.0\.0\.1:\d+/", line))), None)
            assert found is not None, "the server ended without a web view"
            yield found[0], process
            process.send_signal(signal.SIGTERM)
            process.wait(PATIENCE_S)
        finally:
            process.kill()


def ready(page: Page) -> Page:
    """Once it shows and knows everything."""
    page.wait("window.uw && uw.frames > 2 && uw.app.description && uw.app.status.mode", "the page shows a world")
    return page
