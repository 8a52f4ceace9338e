"""The page of the web view in Firefox. Without a display it has no WebGL, and shows the map; under one (Xvfb will do) it draws."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from firefox_rig import firefox_or_skip, running
from server_process import serving

pytestmark = pytest.mark.slow
PICTURES = "UWSERVER_PAGE_PICTURES"


def test_firefox_is_sent_to_the_page_and_steers(tmp_path: Path) -> None:
    program = firefox_or_skip()
    with serving("pilot_training") as ((host, port), _), running(program, tmp_path) as page:
        page.open(f"http://{host}:{port}/", (1280, 720))
        page.wait("window.uw && uw.frames > 2 && uw.app.description && uw.app.status.mode", "the page shows a world")
        assert page.ask("Number(location.port)") != port
        is_drawn = page.ask("Boolean(uw.drawing)")
        assert is_drawn or "no WebGL 2" in page.ask("uw.said.join()")
        with page.holding("w"):
            page.wait("uw.vehicles.rov[0] > 0.5", "W moves it ahead")
        page.wait("uw.training.state.state === 'running'", "samples come")
        page.ask("document.getElementById('tab-data').click()")
        page.wait("document.querySelector('.card canvas')", "a plot")
        kept = Path(os.environ.get(PICTURES, tmp_path))
        kept.mkdir(parents=True, exist_ok=True)
        page.picture(kept / "firefox.png")
        assert page.ask("uw.errors") == []
        assert page.faults == []
        page.ask("uw.app.link.call('web/stop').then(() => true)")
