"""`uwserver shot`: a picture of the web view, made without a desktop."""

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

from uwserver.cli.colour import coloured_problems
from uwserver.ports.checks import suggestion

if TYPE_CHECKING:
    from uwserver.cli.chromium import Page
    from uwserver.scenario.load.resolved import Resolved

VIEWS = ("orbit", "follow", "board", "top")
_NARROWEST, _WIDEST = 320, 4096
_DEFAULT_S, _LONGEST_S = 10.0, 1e6
_PICTURES_HZ = 4
"""At most, of wall time: drawn in software they take what the world wants to run with."""
_TRAIL_LOOKS, _TRAIL_STEP_S = 40, 0.5
"""The page looks at so many moments before the last one: it remembers them as trails."""
_READY = "window.uw && uw.frames > 0 && uw.app.description && uw.app.status.mode"
_CAMERA = "[uw.frames, ...(uw.drawing.stage.camera.matrixWorld.elements)]"
_STILL = 1e-3
"""Of the camera, between pictures: m, and parts of its axes."""


def _size(ctx: click.Context, param: click.Parameter, text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if found is None:
        raise click.BadParameter(f'"{text}" is no size: give width and height in pixels, as 1280x720', ctx, param)
    size = (int(found[1]), int(found[2]))
    if not all(_NARROWEST <= pixels <= _WIDEST for pixels in size):
        raise click.BadParameter(f"{text}: each must be within {_NARROWEST} and {_WIDEST} pixels", ctx, param)
    return size


def _time(ctx: click.Context, param: click.Parameter, seconds: float) -> float:
    if not 0.0 <= seconds <= _LONGEST_S:  # nan, too
        raise click.BadParameter(f"{seconds:g}: it must be within 0 and {_LONGEST_S:g} s", ctx, param)
    return seconds


@click.command("shot", short_help="Make a picture of the web view, without a desktop.")
@click.argument("scenario")
@click.argument("output", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--at", "at_s", type=float, default=_DEFAULT_S, show_default=True, callback=_time, metavar="SECONDS",
    help="Simulation time of the picture.",
)  # fmt: skip
@click.option("--view", type=click.Choice(VIEWS), help="From where; default: follow, or what --link says.")
@click.option("--vehicle", metavar="NAME", help="Which vehicle; default: the first.")
@click.option(
    "--size", default="1280x720", show_default=True, callback=_size, metavar="WxH", help="Of the picture, pixels."
)
@click.option(
    "--link",
    default="",
    metavar="TEXT",
    help="What stands behind the # of a link of the page, as 'dock=off&show=lamps'.",
)
@click.option("--seed", type=click.IntRange(0), help="Random seed, instead of the scenario's.")
@click.option("--browser", default="", metavar="PROGRAM", help="Chromium or Chrome; default: found by its name.")
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
    """Write to OUTPUT (.png, .webp or .jpg) how the page of the web view shows SCENARIO (a shipped name or a file).

    The world runs on a server of its own, which nothing else reaches, as fast as it can and with no other adapter; Chromium draws the page.
    """
    from uwserver.cli.chromium import FORMATS, ChromiumFailed, NoChromium, chromium
    from uwserver.cli.lone_view import ViewFailed

    if output.suffix.lower() not in FORMATS:
        raise click.ClickException(f"{output}: its name must end in {', '.join(FORMATS)}")
    if not output.parent.is_dir():
        raise click.ClickException(f"{output}: there is no folder {output.parent}")
    try:
        program = chromium(browser)
        resolved = _loaded(scenario)
        _check_vehicle(resolved, vehicle)
        given = {"view": view, "vehicle": vehicle}
        parts = {"view": "follow", "quality": "high", **dict(parse_qsl(link)), **{k: v for k, v in given.items() if v}}
        with showing(scenario, program, size, parts, seed) as page:
            advance(page, at_s)
            settle(page)
            page.picture(output)
    except (NoChromium, ChromiumFailed, ViewFailed) as error:
        raise click.ClickException(str(error)) from error
    except OSError as error:
        raise click.ClickException(f"{error.filename or output}: {error.strerror or error}") from error
    click.echo(f"wrote {output}: {output.stat().st_size // 1024 + 1} KiB")


def _loaded(scenario: str) -> Resolved:
    from uwserver.adapter import AdapterNotFound, installed_adapters
    from uwserver.scenario.files.errors import ScenarioError
    from uwserver.scenario.load.scenario import load

    try:
        resolved = load(scenario, adapters=installed_adapters())
    except (ScenarioError, AdapterNotFound) as error:
        click.echo(coloured_problems(str(error)), err=True)
        sys.exit(1)
    if resolved.missing:
        raise click.ClickException(f"{resolved.name}: {resolved.missing}")
    return resolved


def _check_vehicle(resolved: Resolved, vehicle: str | None) -> None:
    """Free objects can be looked at too, as in the page."""
    names = [*resolved.vehicles, *resolved.objects]
    if vehicle is not None and vehicle not in names:
        there = ", ".join(names) or "none"
        raise click.ClickException(
            f'{resolved.name}: no vehicle "{vehicle}"{suggestion(vehicle, names)}; there are: {there}'
        )


@contextlib.contextmanager
def _ending_by_signal() -> Iterator[None]:
    """SIGTERM, and SIGHUP of a closed terminal, unwind as Ctrl-C does: what was begun is ended."""

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
    """A page that shows a world of its own, which stands still at time 0. Page, browser and server end with the block, and by SIGTERM. Main thread.

    Args:
        scenario: a shipped name or a file.
        program: path of the browser.
        size: of the page, pixels.
        parts: of its link: `view`, `vehicle`, `quality`, ...
        seed: instead of the scenario's.

    Raises:
        ChromiumFailed, ViewFailed: see there.
    """
    from uwserver.cli.chromium import ChromiumFailed, browsing
    from uwserver.cli.lone_view import lone_view

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
    """Let the world of `showing` run to a time, s, and stand still there; the page remembers what it has seen of the way.

    Raises:
        ChromiumFailed: it does not come so far.
    """
    now = page.ask("uw.app.link.call('world/status').then((status) => status.t_s)")
    looks = (t_s - k * _TRAIL_STEP_S for k in range(_TRAIL_LOOKS, 0, -1))
    for until in (*(t for t in looks if t > now), t_s):
        _run_until(page, until)


def _run_until(page: Page, t_s: float) -> None:
    from uwserver.cli.chromium import ChromiumFailed

    # Not awaited: it may take long, and then what proceeds is looked at.
    run = f"uw.app.link.call('world/run_until', {{ t_s: {t_s!r} }}).then(() => '', (error) => error.message)"
    page.ask(f"uw.ran = null, void {run}.then((why) => {{ uw.ran = why; }})")
    page.wait("uw.ran !== null", f"the world did not reach {t_s:g} s", sign="uw.app.timeline.newest?.t")
    if why := page.ask("uw.ran"):
        raise ChromiumFailed(f"the world did not reach {t_s:g} s: {why}")
    now = page.ask("uw.app.link.call('world/status').then((status) => status.t_s)")
    page.wait(f"Math.abs(uw.t - {now!r}) < 1e-6", f"the page did not show the world at {now:g} s", sign="uw.frames")


def settle(page: Page) -> None:
    """Wait until everything is loaded and drawn, and the camera stands still.

    Raises:
        ChromiumFailed: that does not come about.
    """
    from uwserver.cli.chromium import ChromiumFailed, pause

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


COMMANDS = (shot,)
