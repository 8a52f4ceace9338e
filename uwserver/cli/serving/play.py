"""The command `play`: serves a recording as if it were live."""

from __future__ import annotations

import logging
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from uwserver.cli.loading import require_kind
from uwserver.cli.serving.played_adapters import with_played_adapters
from uwserver.cli.serving.run import announced_address, with_address
from uwserver.cli.serving.web_view import address_lines, open_page, with_view_token, with_web_view
from uwserver.cli.terminal import FILE, LOG_LEVEL, SECONDS, styled, told
from uwserver.server.page import with_token

if TYPE_CHECKING:
    from uwserver.recording.player.track import Track
    from uwserver.recording.player.world import Range
    from uwserver.simulation.clock import Timing

log = logging.getLogger(__name__)


class _Speed(click.ParamType[float]):
    """A factor, or "max"."""

    name = "speed"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if value == "max":
            return 0.0
        try:
            number: float = click.FloatRange(1e-3, 1000.0).convert(value, param, ctx)
        except click.BadParameter as error:
            self.fail(f'{error.message} Or say "max".', param, ctx)
        return number


@click.command("play", short_help="Serve a recording as if it were live.")
@click.argument("file", type=FILE)
@click.option(
    "--speed",
    type=_Speed(),
    default=1.0,
    metavar="FACTOR|max",
    help="Recorded seconds per second of wall time; max is as fast as possible [default: 1].",
)
@click.option("--from", "from_s", type=SECONDS, metavar="SECONDS", help="Begin at this simulation time.")
@click.option("--to", "to_s", type=SECONDS, metavar="SECONDS", help="End at this simulation time.")
@click.option("--loop", "loops", is_flag=True, help="Begin again at the end.")
@click.option("--paused", is_flag=True, help="Begin paused.")
@click.option(
    "--map",
    "names",
    multiple=True,
    metavar="OLD=NEW",
    help="Serve the vehicle OLD under the name NEW; may be given several times.",
)
@click.option("--mapping", type=FILE, help="Mapping file of a log of another origin (see `uwserver log --mapping`).")
@click.option(
    "--port", type=click.IntRange(0, 65535), help="Port of the sockets adapter; 0 takes free ports for all adapters."
)
@click.option("--bind", help="Address on which the sockets adapter listens.")
@click.option(
    "--adapter",
    "chosen",
    multiple=True,
    metavar="NAME",
    help="Let this adapter of the recording do all that its table says, on any network; may be given several times.",
)
@click.option("--open", "opens", is_flag=True, help="Open the web view in a browser.")
@click.option(
    "--log-level", default="info", show_default=True, type=LOG_LEVEL, help="Least important log lines to write."
)
def play(
    file: Path,
    speed: float,
    from_s: float | None,
    to_s: float | None,
    loops: bool,
    paused: bool,
    names: tuple[str, ...],
    mapping: Path | None,
    port: int | None,
    bind: str | None,
    chosen: tuple[str, ...],
    opens: bool,
    log_level: str,
) -> None:
    """Serve FILE with its ports and times, until Ctrl-C (SIGINT) or SIGTERM.

    FILE is a recording of `uwserver run --record FILE` or `uwserver record`, or a log of another origin.

    Example: uwserver play dive.mcap --from 60 --speed 5 --open
    """
    from uwserver.logs import set_up_logging
    from uwserver.recording.player.chunks import NotPlayable
    from uwserver.recording.player.world import Range
    from uwserver.server.process import end_undisturbed
    from uwserver.simulation.clock import Timing

    require_kind(file, "a recording or log", "recording", "log")
    set_up_logging(log_level, False)
    with tempfile.TemporaryDirectory(prefix="uwserver-play-") as place:
        with told(file, NotPlayable):
            track = _opened(file, _renames(names), mapping, Path(place))
        span = Range(from_s, to_s, loops)
        if fault := span.fault(track):
            track.close()
            raise click.ClickException(f"{file}: {fault}")
        for remark in track.remarks:
            log.warning("%s: %s", file.name, remark)
        timing = Timing("freerun" if speed == 0.0 else "realtime", speed or 1.0, paused)
        status = _serve(track, timing, span, (port, bind), chosen, opens)
    end_undisturbed()
    sys.exit(status)


def _opened(file: Path, names: dict[str, str], mapping: Path | None, place: Path) -> Track:
    """Open a recording of uwserver, or convert a log of another origin to one in the folder `place`."""
    from uwserver.recording.player.chunks import NotOurs
    from uwserver.recording.player.importing import import_log
    from uwserver.recording.player.served import import_served, is_served
    from uwserver.recording.player.track import Track

    may_be_ours = mapping is None and file.is_file()
    try:
        if may_be_ours:
            return Track(file, names)
    except NotOurs:
        click.echo(f"uwserver: no scenario of uwserver is in {file.name}: it is read as a log, once")
    target = place / "log.mcap"
    if may_be_ours and is_served(file):
        remarks = import_served(file, target)
    else:
        remarks = import_log(file, mapping, target)
    track = Track(target, names)
    track.path, track.remarks = file, (*remarks, *track.remarks)
    return track


def _renames(names: tuple[str, ...]) -> dict[str, str]:
    renames: dict[str, str] = {}
    for text in names:
        old, separator, new = text.partition("=")
        if not (separator and old and new) or "/" in text:
            raise click.UsageError(f"--map takes OLD=NEW, two names of vehicles, not {text!r}")
        renames[old] = new
    return renames


def _serve(
    track: Track,
    timing: Timing,
    span: Range,
    address: tuple[int | None, str | None],
    chosen: tuple[str, ...],
    opens: bool,
) -> int:
    from uwserver.adapter import installed_adapters
    from uwserver.server.adapters import StartFailed
    from uwserver.server.life_cycle import Options, Server
    from uwserver.server.playback import Playback
    from uwserver.server.process import run as run_loop

    adapters = installed_adapters()
    try:
        resolved = with_played_adapters(track.head.resolved, adapters, address[0], chosen)
    except ValueError as error:
        track.close()
        raise click.ClickException(f"{track.path}: {error}") from error
    resolved = with_address(resolved, *address, ())
    resolved, view = with_web_view(resolved, adapters, address[0])
    resolved, shown = with_view_token(resolved, view, makes=True)

    def announce(addresses: dict[str, str]) -> None:
        page = addresses.get(view, "")
        if opens:
            open_page(with_token(page, shown.text))
        for line in address_lines(resolved, view, page, shown):
            if line:
                click.echo(line)
        length = (track.runs[0].to_ns - track.runs[0].from_ns) / 1e9
        click.echo(styled(f"uwserver plays {track.path}: {resolved.name}, {length:.1f} s", bold=True))
        for name, where in addresses.items():
            if name != view:
                click.echo(f"  {name}: {where}")
        click.echo(f"  {announced_address(resolved, addresses)} call playback/seek t_s=10")
        click.echo("Ctrl-C ends it.\n")

    async def serve() -> int:
        options = Options(announce=announce, shown=view)
        return await Server(resolved, options, Playback(track, timing, span)).run()

    try:
        return run_loop(serve())
    except (StartFailed, OSError) as error:
        track.close()
        click.echo(f"uwserver: {advised(str(error), str(track.path))}", err=True)
        sys.exit(1)


def advised(text: str, file: str) -> str:
    """Return why the server cannot start, with advice that suits a recording, whose adapter tables cannot be edited."""
    from uwserver.adapter.listening import IN_USE

    if IN_USE not in text:
        return text
    what = text.partition(", or give this adapter")[0]
    return f"{what}, or play it beside: `uwserver play {file} --port 0` takes free ports for all that it serves"
