"""The command `shot`: makes a picture of the web view without a desktop."""

from __future__ import annotations

import contextlib
import re
import signal
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, urlencode

import click

from uwserver.cli.loading import loaded, require_packages
from uwserver.cli.terminal import Number, told
from uwserver.ports.checks import suggestion

if TYPE_CHECKING:
    from uwserver.cli.browser.chromium import Page

VIEWS = ("orbit", "follow", "board", "top")
_NARROWEST, _WIDEST = 320, 4096
_PICTURES_HZ = 4
"""Largest rate of pictures in wall time. Drawn in software, they take processor time that the world needs to run."""
_TRAIL_LOOKS, _TRAIL_STEP_S = 40, 0.5
"""Moments before the last one that the page shows, and their distance: it remembers them as trails."""
_READY = "window.uw && uw.frames > 0 && uw.app.description && uw.app.status.mode"
_CAMERA = "[uw.frames, ...(uw.drawing.stage.camera.matrixWorld.elements)]"
_STILL = 1e-3
"""Largest change of the camera's pose between pictures, in m and in components of its axes, if it is at rest."""


def _size(ctx: click.Context, param: click.Parameter, text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if found is None:
        raise click.BadParameter(f'"{text}" is no size: give width and height in pixels, as 1280x720', ctx, param)
    size = (int(found[1]), int(found[2]))
    if not all(_NARROWEST <= pixels <= _WIDEST for pixels in size):
        raise click.BadParameter(f"{text}: each must be within {_NARROWEST} and {_WIDEST} pixels", ctx, param)
    return size


@click.command("shot", short_help="Make a picture of the web view, without a desktop.")
@click.argument("scenario")
@click.argument("output", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--at", "at_s", type=Number(0.0, 1e6), default=10.0, show_default=True, metavar="SECONDS",
    help="Simulation time of the picture.",
)  # fmt: skip
@click.option("--view", type=click.Choice(VIEWS), help="Position of the camera; default: follow, or what --link says.")
@click.option("--vehicle", metavar="NAME", help="Vehicle or free object to look at; default: the first vehicle.")
@click.option(
    "--size",
    default="1280x720",
    show_default=True,
    callback=_size,
    metavar="WxH",
    help="Width and height of the picture in pixels.",
)
@click.option(
    "--link",
    default="",
    metavar="TEXT",
    help="What follows the # in a link to the page, such as 'dock=off&show=lamps'.",
)
@click.option("--seed", type=click.IntRange(0), help="Random seed, instead of that of the scenario.")
@click.option(
    "--browser", default="", metavar="PROGRAM", help="Name or path of Chromium or Chrome; default: the one on PATH."
)
def shot(
    scenario: str,
    output: Path,
    at_s: float,
    view: str | None,
    vehicle: str | None,
    size: tuple[int, int],
    link: str,
    seed: int | None,
    browser: str,
) -> None:
    """Write a picture of the web view of SCENARIO to OUTPUT (.png, .webp or .jpg).

    SCENARIO is a shipped scenario or a file. The world runs as fast as possible on a server of its own, which has no other adapter and which
    nothing else can reach. Chromium draws the page.
    """
    from uwserver.cli.browser.chromium import FORMATS, ChromiumFailed, NoChromium, chromium
    from uwserver.cli.browser.lone_view import ViewFailed

    if output.suffix.lower() not in FORMATS:
        raise click.ClickException(f"{output}: its name must end in {', '.join(FORMATS)}")
    if not output.parent.is_dir():
        raise click.ClickException(f"{output}: there is no folder {output.parent}")
    with told(output, NoChromium, ChromiumFailed, ViewFailed):
        program = chromium(browser)
        _check(scenario, vehicle)
        given = {"view": view, "vehicle": vehicle}
        parts = {"view": "follow", "quality": "high", **dict(parse_qsl(link)), **{k: v for k, v in given.items() if v}}
        with showing(scenario, program, size, parts, seed) as page:
            advance(page, at_s)
            wait_until_still(page)
            page.picture(output)
    click.echo(f"wrote {output}: {output.stat().st_size // 1024 + 1} KiB")


def _check(scenario: str, vehicle: str | None) -> None:
    """Check that a scenario can run, and that it has the vehicle or free object to look at."""
    resolved, _ = loaded(scenario)
    require_packages(resolved)
    names = [*resolved.vehicles, *resolved.objects]
    if vehicle is not None and vehicle not in names:
        there = ", ".join(names) or "none"
        raise click.ClickException(
            f'{resolved.name}: no vehicle "{vehicle}"{suggestion(vehicle, names)}; there are: {there}'
        )


@contextlib.contextmanager
def _ending_by_signal() -> Iterator[None]:
    """Let SIGTERM, and the SIGHUP of a closed terminal, unwind the block as Ctrl-C does, so that the child processes are ended."""

    def leave(number: int, frame: object) -> None:
        sys.exit(128 + number)

    numbers = [signal.Signals[name] for name in ("SIGTERM", "SIGHUP") if name in signal.Signals.__members__]
    before = {number: signal.signal(number, leave) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def showing(
    scenario: str, program: str, size: tuple[int, int], parts: Mapping[str, str], seed: int | None = None
) -> Iterator[Page]:
    """Open a page that shows a world of its own, paused at time 0. Main thread only.

    Page, browser and server end with the block, and on SIGTERM.

    Args:
        scenario: a shipped name or a file.
        program: path of the browser.
        size: width and height of the page, pixels.
        parts: settings in the link to the page: `view`, `vehicle`, `quality`, ...
        seed: random seed; None takes that of the scenario.

    Raises:
        ChromiumFailed: the browser did not start, or the page did not show the world.
        ViewFailed: the server did not start.
    """
    from uwserver.cli.browser.chromium import ChromiumFailed, browsing
    from uwserver.cli.browser.lone_view import lone_view

    with contextlib.ExitStack() as stack:
        stack.enter_context(_ending_by_signal())
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="uwshot-", ignore_cleanup_errors=True))
        address, _, token = stack.enter_context(lone_view(scenario, seed)).partition("#")
        browser = stack.enter_context(browsing(program, Path(folder)))
        page = browser.open(f"{address}?fps={_PICTURES_HZ}#{token}&{urlencode(parts)}", size=size)
        page.wait(_READY, "the page did not show the world")
        if not page.ask("Boolean(uw.drawing)"):
            raise ChromiumFailed(f"{program} cannot draw in three dimensions: {' '.join(page.ask('uw.said'))}")
        yield page


def advance(page: Page, t_s: float) -> None:
    """Let the world of `showing` run to a simulation time, s, and pause there. The page remembers the way there as trails.

    Raises:
        ChromiumFailed: the world does not reach that time.
    """
    now = page.ask("uw.app.link.call('world/status').then((status) => status.t_s)")
    looks = (t_s - k * _TRAIL_STEP_S for k in range(_TRAIL_LOOKS, 0, -1))
    for until in (*(t for t in looks if t > now), t_s):
        _run_until(page, until)


def _run_until(page: Page, t_s: float) -> None:
    from uwserver.cli.browser.chromium import ChromiumFailed

    # The call is not awaited, because it may take longer than the time-out of an answer; the page's time shows the progress.
    run = f"uw.app.link.call('world/run_until', {{ t_s: {t_s!r} }}).then(() => '', (error) => error.message)"
    page.ask(f"uw.ran = null, void {run}.then((why) => {{ uw.ran = why; }})")
    page.wait("uw.ran !== null", f"the world did not reach {t_s:g} s", sign="uw.app.timeline.newest?.t")
    if why := page.ask("uw.ran"):
        raise ChromiumFailed(f"the world did not reach {t_s:g} s: {why}")
    now = page.ask("uw.app.link.call('world/status').then((status) => status.t_s)")
    page.wait(f"Math.abs(uw.t - {now!r}) < 1e-6", f"the page did not show the world at {now:g} s", sign="uw.frames")


def wait_until_still(page: Page) -> None:
    """Wait until everything is loaded and drawn, and the camera is at rest.

    Raises:
        ChromiumFailed: this does not happen in time.
    """
    from uwserver.cli.browser.chromium import ChromiumFailed, pause

    before: list[float] = []
    for _ in range(1000):
        shown = page.ask(_CAMERA)
        if not before or page.loading:
            before = shown
        elif shown[0] >= before[0] + 2:
            if all(abs(a - b) < _STILL for a, b in zip(before[1:], shown[1:], strict=True)):
                return
            before = shown
        pause(0.1)
    raise ChromiumFailed(
        f"the picture does not come to rest: {len(page.loading)} files under way, {page.ask('uw.said')}"
    )
