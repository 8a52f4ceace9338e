"""The web view: cost of a page that shows twenty vehicles, whether twenty pages, half of which do not read, delay ticks, and how soon a browser shows
the first picture, if one is installed."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Any

from uwserver.cli.browser.chromium import ChromiumFailed, NoChromium, browsing, chromium
from uwserver.simulation.clock import SystemTime
from uwserver_bench.processes import BenchFailed, Load, Served, loading, processor_s, scenario_file, serving
from uwserver_bench.report import Row
from uwserver_bench.server import STATUS
from uwserver_bench.swarm.swarm_scenario import SERVED, scenario

VEHICLES = 20
PAGES, DEAF = 20, 10
SHARE_BAR = 0.03
"""Largest part of a core that one page may cost."""
BYTES_BAR_KB = 25.0
LATENESS_BAR_MS = 1.0
FRAMES_HZ = 30.0
FIRST_BAR_S = 2.0
"""Longest time from the request of the page to the first picture of the world."""
FIRST_SHOWN = "bluerov2_pool"
_LEAST = 0.8
"""Least part of the states that a page must get."""


def bench_web(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on the web view.

    Args:
        quick: short repeats.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    repeats, seconds = (1, 1.0) if quick else (5, 6.0)
    shares, rates, frames, crowded, alone = [], [], [], [], []
    with scenario_file(scenario("simple", VEHICLES) + SERVED) as file, loading("uwserver_bench.web.web_load") as load:
        with serving(file) as served:
            host, port = _view(served)
            load.ask(
                "watch", host=host, port=port, pages=1, deaf=0, seconds=0.5
            )  # the first page makes the server load modules
            for repeat in range(repeats):
                say(f"web: a page, {repeat + 1} of {repeats}")
                idle = _spent(served, seconds)
                alone.append(_lateness_ms(served))
                spent, told = _watched(served, load, host, port, 1, 0, seconds)
                shares.append(max(0.0, spent - idle))
                rates.append(told["bytes_per_s"] * 1e-3)
                frames.append(told["frames_per_s"])
                say(f"web: {PAGES} pages, {repeat + 1} of {repeats}")
                _watched(served, load, host, port, PAGES, DEAF, seconds)
                crowded.append(_lateness_ms(served))
    title = f"{VEHICLES} vehicles, a page at {FRAMES_HZ:g} states/s"
    first = _first_pictures(1 if quick else 5, say)
    return [
        *([Row("web", f"{FIRST_SHOWN}: first picture, in software", "s", first, at_most=FIRST_BAR_S)] if first else []),
        Row("web", f"{title}: added share of a core", "cores", tuple(shares), at_most=SHARE_BAR),
        Row("web", f"{title}: data", "kB/s", tuple(rates), at_most=BYTES_BAR_KB),
        Row("web", f"{title}: states", "1/s", tuple(frames), at_least=_LEAST * FRAMES_HZ),
        Row("web", f"{VEHICLES} vehicles, no page: tick lateness p99", "ms", tuple(alone)),
        Row("web", f"{VEHICLES} vehicles, {PAGES} pages, {DEAF} do not read: tick lateness p99", "ms", tuple(crowded), at_most=LATENESS_BAR_MS),
    ]  # fmt: skip


def _view(served: Served) -> tuple[str, int]:
    """Return the address of the web view."""
    adapters = served.ask(STATUS)["value"]["adapters"]
    found = re.fullmatch(r"http://([\d.]+):(\d+)/", adapters.get("web", {}).get("address", ""))
    if found is None:
        raise BenchFailed(f"the server shows no web view: {adapters.get('web', 'no adapter `web` is installed')}")
    return found[1], int(found[2])


def _spent(served: Served, seconds: float) -> float:
    """Return the number of cores that the server uses."""
    clock = SystemTime()
    before, since = processor_s(served.pid), clock.now_ns()
    clock.wait(seconds, Event())
    return _cores(before, processor_s(served.pid), clock.now_ns() - since)


def _watched(
    served: Served, load: Load, host: str, port: int, pages: int, deaf: int, seconds: float
) -> tuple[float, dict[str, Any]]:
    """Return the same while pages are open, and what the pages received."""
    clock = SystemTime()
    before, since = processor_s(served.pid), clock.now_ns()
    told = load.ask("watch", host=host, port=port, pages=pages, deaf=deaf, seconds=seconds)
    return _cores(before, processor_s(served.pid), clock.now_ns() - since), told


def _cores(before: float | None, after: float | None, wall_ns: int) -> float:
    if before is None or after is None:
        raise BenchFailed("this system does not tell what a process spends: the web view cannot be measured here")
    return (after - before) / (wall_ns * 1e-9)


def _lateness_ms(served: Served) -> float:
    return float(served.ask(STATUS)["value"]["lateness"]["p99_s"]) * 1e3


def _first_pictures(repeats: int, say: Callable[[str], None]) -> tuple[float, ...]:
    """Return the seconds until a running browser, whose cache is empty, has drawn the world; nothing if no browser is installed."""
    try:
        program = chromium()
    except NoChromium as error:
        say(f"web: no first picture is measured: {error}")
        return ()
    found = []
    with tempfile.TemporaryDirectory(prefix="uwbrowser-") as folder, serving(FIRST_SHOWN) as served:
        host, port = _view(served)
        try:
            with browsing(program, Path(folder)) as browser:
                for repeat in range(repeats + 1):
                    say(f"web: first picture, {repeat} of {repeats}")
                    page = browser.open(f"http://{host}:{port}/", size=(1280, 720))
                    page.wait("window.uw?.first", "a picture")
                    found.append(page.ask("uw.first") * 1e-3)
                    page.close()
        except ChromiumFailed as error:
            raise BenchFailed(f"the browser failed: {error}") from error
    return tuple(found[1:])  # the first one also loads the browser, and the files of the server
