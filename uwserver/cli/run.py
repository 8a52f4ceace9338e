"""`uwserver run`: a scenario as a server."""

from __future__ import annotations

import logging
import math
import os
import shutil
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from uwserver.cli.colour import coloured_problems, styled
from uwserver.cli.rotation import rotated
from uwserver.cli.web_view import open_page, where_to_look, with_token, with_view_token, with_web_view

if TYPE_CHECKING:
    from uwserver.adapter import Token
    from uwserver.recording.parts import Rotation
    from uwserver.scenario.load.resolved import Resolved, ResolvedVehicle
    from uwserver.server.life_cycle import Options
    from uwserver.simulation.clock import Timing

DEFAULT_SCENARIO = "bluerov2_pool"


class _Number(click.FloatRange):
    """`FloatRange`, which lets NaN through."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number: float = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail("a number is needed, not nan", param, ctx)
        return number


_SECONDS = _Number(0.0, 1e9)
_FILE = click.Path(path_type=Path, dir_okay=False)
_PROFILE = "Print what a tick takes, by stage and kind, every so many seconds of wall time, and at the end."
_SAVE_AT = "Save the state at this simulation time; may be given several times."


@click.command("run", short_help="Serve a scenario (default bluerov2_pool) until Ctrl-C.")
@click.argument("scenario", default=DEFAULT_SCENARIO)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    help="Port of the first sockets adapter; 0 takes a free one, for the web view too.",
)
@click.option("--bind", help="Address that the first sockets adapter listens on.")
@click.option(
    "--allow-origin",
    multiple=True,
    metavar="ORIGIN",
    help="Pages that may connect to it, as http://localhost:8000; may be given several times.",
)
@click.option("--open", "opens", is_flag=True, help="Open the web view in a browser.")
@click.option("--metrics-bind", help="Address of /health and /metrics.")
@click.option("--seed", type=click.IntRange(0), help="Random seed, instead of the scenario's.")
@click.option("--mode", type=click.Choice(["realtime", "freerun", "lockstep"]), help="How time passes.")
@click.option("--speed", type=_Number(1e-3, 1000.0), help="Simulated seconds per second (realtime).")
@click.option("--paused", is_flag=True, help="Start paused.")
@click.option("--until", "until_s", type=_SECONDS, metavar="SECONDS", help="End at this simulation time.")
@click.option("--record", type=_FILE, help="Write an MCAP file (see `uwserver replay`).")
@rotated
@click.option(
    "--no-foxglove", is_flag=True, help="Record no channels for Foxglove, Lichtblick and rerun beside our own."
)
@click.option("--from", "begin", type=_FILE, help="Begin at a saved state of this scenario.")
@click.option("--save-at", type=(_SECONDS, _FILE), multiple=True, metavar="SECONDS FILE", help=_SAVE_AT)
@click.option("--profile", type=_Number(0.01, 3600.0), metavar="SECONDS", help=_PROFILE)
@click.option("--log-level", default="info", type=click.Choice(["debug", "info", "warning", "error"]))
@click.option("--log-json", is_flag=True, help="One JSON object a log line.")
def run(
    scenario: str, port: int | None, bind: str | None, allow_origin: tuple[str, ...], opens: bool, metrics_bind: str | None,
    seed: int | None, mode: str | None, speed: float | None, paused: bool, until_s: float | None, record: Path | None,
    rotation: Rotation, no_foxglove: bool, begin: Path | None, save_at: tuple[tuple[float, Path], ...], profile: float | None,
    log_level: str, log_json: bool,
) -> None:  # fmt: skip
    """Serve SCENARIO (a shipped name or a file; default bluerov2_pool) until SIGINT or SIGTERM."""
    from uwserver.adapter import AdapterNotFound, installed_adapters
    from uwserver.logs import set_up_logging
    from uwserver.scenario.files.errors import ScenarioError
    from uwserver.scenario.load.scenario import load
    from uwserver.server.life_cycle import Options, StartFailed, timing_of
    from uwserver.server.signals import end_undisturbed
    from uwserver.server.state_files import read_state

    set_up_logging(log_level, log_json)
    try:
        adapters = installed_adapters()
        resolved = load(scenario, adapters=adapters)
    except (ScenarioError, AdapterNotFound) as error:
        click.echo(coloured_problems(str(error)), err=True)
        sys.exit(1)
    for warning in resolved.warnings:
        logging.getLogger(__name__).warning("%s", warning)
    if resolved.missing:
        click.echo(f"uwserver: {resolved.name}: {resolved.missing}", err=True)
        sys.exit(1)
    resolved = _with_metrics(with_address(resolved, port, bind, allow_origin), metrics_bind)
    resolved, token = (resolved, "") if log_json else _with_new_token(resolved)  # the adapter logs one of its own
    resolved, view = with_web_view(resolved, adapters, port)
    resolved, shown = with_view_token(resolved, view, makes=not log_json)
    timing = _timing(timing_of(resolved), mode, speed, paused)
    try:
        state = None if begin is None else read_state(begin)
        announce = partial(_announce, resolved, log_json, token, view=view, shown=shown, opens=opens)
        options = Options(
            seed,
            timing,
            record,
            until_s,
            state,
            save_at,
            profile,
            view,
            announce,
            click.echo,
            rotation,
            not no_foxglove,
        )
        with ExitStack() as ending:
            options = replace(options, announce=_then_compile_the_rest(options.announce, ending))
            status = _run_loop(resolved, options)
    except (StartFailed, OSError) as error:
        click.echo(f"uwserver: {error}", err=True)
        sys.exit(1)
    end_undisturbed()
    sys.exit(status)


def _timing(given: Timing, mode: str | None, speed: float | None, paused: bool) -> Timing:
    """The scenario's, with what the command line says of it."""
    timing = replace(given, mode=mode or given.mode, speed=speed or given.speed, paused=paused or given.paused)  # type: ignore[arg-type]
    if timing.mode == "lockstep" and not timing.lockstep_clients:
        raise click.UsageError("lockstep needs names: set lockstep_clients in [world.clock] of the scenario")
    return timing


def _run_loop(resolved: Resolved, options: Options) -> int:
    if not resolved.scenario.server.uvloop:
        from uwserver.server.loop import run as run_loop

        return run_loop(_serve(resolved, options))
    try:
        import uvloop
    except ImportError:
        raise click.UsageError("[server] uvloop = true needs it: pip install 'uwserver[uvloop]'") from None
    return uvloop.run(_serve(resolved, options))


async def _serve(resolved: Resolved, options: Options) -> int:
    from uwserver.server.life_cycle import Server

    return await Server(resolved, options).run()


def with_address(resolved: Resolved, port: int | None, bind: str | None, origins: tuple[str, ...]) -> Resolved:
    """The scenario with another address, or pages that may connect, for its first sockets adapter."""
    given = (("port", port), ("bind", bind), ("allowed_origins", origins or None))
    changes: dict[str, Any] = {k: v for k, v in given if v is not None}
    if not changes:
        return resolved
    if (name := _first_sockets(resolved)) is None:
        raise click.UsageError("--port, --bind and --allow-origin need a sockets adapter in the scenario")
    return _with_adapter(resolved, name, changes)


def _first_sockets(resolved: Resolved) -> str | None:
    """Name of the adapter to which the printed commands lead."""
    kinds = ((name, str(config.__struct_config__.tag)) for name, config in resolved.scenario.adapters.items())
    return next((name for name, kind in kinds if kind == "sockets"), None)


def _with_adapter(resolved: Resolved, name: str, changes: dict[str, Any]) -> Resolved:
    adapters = dict(resolved.scenario.adapters)
    adapters[name] = msgspec.structs.replace(adapters[name], **changes)
    return replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, adapters=adapters))


def _with_new_token(resolved: Resolved) -> tuple[Resolved, str]:
    """The scenario with the token that its first sockets adapter would make itself, so that the printed commands hold it; "" for none."""
    from uwserver.adapter import is_loopback, new_token

    name = _first_sockets(resolved)
    if name is None or _has_token(resolved, name) or is_loopback(_config(resolved, name).bind):
        return resolved, ""
    token = new_token()
    return _with_adapter(resolved, name, {"token": token}), token


def _has_token(resolved: Resolved, name: str) -> bool:
    from uwserver.adapter import known_token

    return known_token(_config(resolved, name).token) is not None


def _config(resolved: Resolved, name: str) -> Any:
    """Of an adapter: of a class of its own distribution."""
    return resolved.scenario.adapters[name]


def _with_metrics(resolved: Resolved, bind: str | None) -> Resolved:
    if bind is None:
        return resolved
    server = msgspec.structs.replace(resolved.scenario.server, metrics_bind=bind)
    return replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, server=server))


def _then_compile_the_rest(
    announce: Callable[[dict[str, str]], None], ending: ExitStack
) -> Callable[[dict[str, str]], None]:
    """`announce`, and then a process of the lowest priority that compiles what this scenario does not need, until the server ends."""
    from uwserver.physics.kernel.compiled import cache_state
    from uwserver.world.builds import STAGES, missing, start, stop

    if cache_state.folder is None and missing(STAGES):
        click.echo(f"uwserver: {cache_state.reason}", err=True)

    def announced(addresses: dict[str, str]) -> None:
        announce(addresses)
        rest = missing(STAGES)
        if rest and cache_state.folder is not None and not cache_state.reason:
            ending.callback(stop, start(rest, nice=19))

    return announced


def _announce(
    resolved: Resolved,
    quiet: bool,
    token: str,
    addresses: dict[str, str],
    *,
    view: str = "",
    shown: Token | None = None,
    opens: bool = False,
) -> None:
    """Say where to look, where to connect and what to type next.

    Args:
        resolved: the scenario.
        quiet: say nothing.
        token: that was made for this run; "" for one that the user knows, or none.
        addresses: of the adapters, by name.
        view: name of the adapter of the web view; "" for none.
        shown: token that its pages need; None for none.
        opens: open it.
    """
    from uwserver.cli.scenario import alike

    page = addresses.get(view, "")
    if opens:
        open_page(with_token(page, shown and shown.text))
    if quiet:
        return
    first_said, last_said = where_to_look(resolved, view, page, shown)
    if first_said:
        click.echo(f"\n{first_said}")
    vehicles = ", ".join(f"{name} ({v.vehicle.name})" for name, v in alike(resolved).items())
    click.echo("\n" * (not first_said) + styled(f"uwserver runs {resolved.name}: {vehicles}", bold=True))
    for name, address in addresses.items():
        if name != view:
            click.echo(f"  {name}: {address}")
    if last_said:
        click.echo(last_said)
    sockets = _first_sockets(resolved)
    first = next(iter(resolved.vehicles.values()), None)
    if sockets and first:
        if token:
            click.echo(
                f"Others can reach {addresses[sockets]}: whoever connects shows a token, which was made for this run."
            )
        wanted = not token and _has_token(resolved, sockets)
        click.echo("In another terminal" + (", UWSERVER_TOKEN set there to the server's token:" if wanted else ":"))
        _suggest(addresses[sockets], token, first)
    click.echo("Ctrl-C ends it.\n")


def announced_address(resolved: Resolved, addresses: Mapping[str, str]) -> str:
    """What to type for the client to reach the first sockets adapter."""
    name = _first_sockets(resolved)
    port = addresses.get(name or "", "").rpartition(":")[2]
    return _client() + ("" if port in ("", "7600") else f" --port {port}")


def _client() -> str:
    """What to type for the client: its name, or its path when it stands beside this Python but not on PATH."""
    beside = Path(sys.executable).parent / "uwclient"
    if shutil.which("uwclient") or not beside.exists():
        return "uwclient"
    return os.path.relpath(beside)


def _suggest(address: str, token: str, vehicle: ResolvedVehicle) -> None:
    from uwserver.cli.first_command import first_command

    host, _, port = address.rpartition(":")
    at = ("" if host in ("127.0.0.1", "0.0.0.0") else f" --host {host}") + ("" if port == "7600" else f" --port {port}")
    client = _client() + at + (f" --token {token}" if token else "")
    command = first_command(vehicle)
    for line in ("topics", f"watch '{vehicle.name}/*'", f"send {command}" if command else ""):
        if line:
            click.echo(styled(f"  {client} {line}", fg="cyan"))


COMMANDS = (run,)
