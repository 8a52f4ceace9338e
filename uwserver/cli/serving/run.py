"""The command `run`: serves a scenario."""

from __future__ import annotations

import logging
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

from uwserver.adapter import Token, is_loopback, known_token, new_token
from uwserver.cli.loading import alike, loaded, require_packages, with_adapter, with_changes
from uwserver.cli.port_holder import holder_of
from uwserver.cli.serving.web_view import address_lines, open_page, with_view_token, with_web_view
from uwserver.cli.terminal import LOG_LEVEL, SECONDS, Number, rotated, styled
from uwserver.packages import install_command
from uwserver.server.page import with_token

if TYPE_CHECKING:
    from uwserver.recording.parts import Rotation
    from uwserver.scenario.load.resolved import Resolved, ResolvedVehicle
    from uwserver.server.life_cycle import Options
    from uwserver.simulation.clock import Timing

DEFAULT_SCENARIO = "bluerov2_pool"
_FILE = click.Path(path_type=Path, dir_okay=False)
_PROFILE = (
    "Print the cost of a tick, by stage and kind, each time this many seconds of wall time have passed, and at the end."
)
_SAVE_AT = "Save the state of the world to FILE at this simulation time; may be given several times."


@click.command("run", short_help="Serve a scenario (default bluerov2_pool) until Ctrl-C.")
@click.argument("scenario", default=DEFAULT_SCENARIO)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    help="Port of the first sockets adapter; 0 takes a free port, also for the web view.",
)
@click.option("--bind", help="Address on which the first sockets adapter listens.")
@click.option(
    "--allow-origin",
    multiple=True,
    metavar="ORIGIN",
    help="Web pages that may connect to the first sockets adapter, such as http://localhost:8000; may be given several times.",
)
@click.option("--open", "opens", is_flag=True, help="Open the web view in a browser.")
@click.option("--metrics-bind", help="Address on which /health and /metrics are served.")
@click.option("--seed", type=click.IntRange(0), help="Random seed, instead of that of the scenario.")
@click.option(
    "--mode",
    type=click.Choice(["realtime", "freerun", "lockstep"]),
    help="How time passes: with wall time, as fast as possible, or in steps that clients grant.",
)
@click.option("--speed", type=Number(1e-3, 1000.0), help="Simulated seconds per second of wall time, in mode realtime.")
@click.option("--paused", is_flag=True, help="Start paused.")
@click.option("--until", "until_s", type=SECONDS, metavar="SECONDS", help="End at this simulation time.")
@click.option("--record", type=_FILE, help="Record the run to an MCAP file, which `uwserver replay` can run again.")
@rotated
@click.option(
    "--no-foxglove", is_flag=True, help="Leave channels for Foxglove, Lichtblick and rerun out of the recording."
)
@click.option("--from", "begin", type=_FILE, help="Begin at a saved state of this scenario.")
@click.option("--save-at", type=(SECONDS, _FILE), multiple=True, metavar="SECONDS FILE", help=_SAVE_AT)
@click.option("--profile", type=Number(0.01, 3600.0), metavar="SECONDS", help=_PROFILE)
@click.option(
    "--log-level", default="info", show_default=True, type=LOG_LEVEL, help="Least important log lines to write."
)
@click.option(
    "--log-json", is_flag=True, help="Write each log line as a JSON object, and print no addresses and suggestions."
)
def run(
    scenario: str, port: int | None, bind: str | None, allow_origin: tuple[str, ...], opens: bool, metrics_bind: str | None,
    seed: int | None, mode: str | None, speed: float | None, paused: bool, until_s: float | None, record: Path | None,
    rotation: Rotation, no_foxglove: bool, begin: Path | None, save_at: tuple[tuple[float, Path], ...], profile: float | None,
    log_level: str, log_json: bool,
) -> None:  # fmt: skip
    """Serve SCENARIO until Ctrl-C (SIGINT) or SIGTERM.

    SCENARIO is a shipped scenario or a file, by default bluerov2_pool.
    """
    from uwserver.logs import set_up_logging
    from uwserver.server.adapters import StartFailed
    from uwserver.server.life_cycle import Options, timing_of
    from uwserver.server.process import end_undisturbed
    from uwserver.server.state_files import read_state

    set_up_logging(log_level, log_json)
    resolved, adapters = loaded(scenario)
    for warning in resolved.warnings:
        logging.getLogger(__name__).warning("%s", warning)
    require_packages(resolved)
    resolved = with_address(resolved, port, bind, allow_origin)
    _check_port(resolved)
    if metrics_bind is not None:
        server = msgspec.structs.replace(resolved.scenario.server, metrics_bind=metrics_bind)
        resolved = with_changes(resolved, server=server)
    # With JSON nothing is printed: the adapter makes a token itself, and logs it.
    resolved, token = (resolved, "") if log_json else _with_new_token(resolved)
    resolved, view = with_web_view(resolved, adapters, port)
    resolved, shown = with_view_token(resolved, view, makes=not log_json)
    timing = _timing(timing_of(resolved), mode, speed, paused)
    try:
        state = None if begin is None else read_state(begin)
        announce = partial(_announce, resolved, log_json, token, view=view, shown=shown, opens=opens)
        with ExitStack() as ending:
            options = Options(
                seed,
                timing,
                record,
                until_s,
                state,
                save_at,
                profile,
                view,
                _then_compile_the_rest(announce, ending),
                click.echo,
                rotation,
                not no_foxglove,
            )
            status = _run_loop(resolved, options)
    except (StartFailed, OSError) as error:
        click.echo(f"uwserver: {error}", err=True)
        sys.exit(1)
    end_undisturbed()
    sys.exit(status)


def _timing(given: Timing, mode: str | None, speed: float | None, paused: bool) -> Timing:
    """Return the timing of the scenario with the changes of the command line."""
    timing = replace(given, mode=mode or given.mode, speed=speed or given.speed, paused=paused or given.paused)  # type: ignore[arg-type]
    if timing.mode == "lockstep" and not timing.lockstep_clients:
        raise click.UsageError("lockstep needs names: set lockstep_clients in [world.clock] of the scenario")
    return timing


def _run_loop(resolved: Resolved, options: Options) -> int:
    from uwserver.server.life_cycle import Server
    from uwserver.server.process import run as run_loop

    async def serve() -> int:
        # The server must be made on the running loop.
        return await Server(resolved, options).run()

    if not resolved.scenario.server.uvloop:
        return run_loop(serve())
    try:
        import uvloop
    except ImportError:
        raise click.UsageError(f"[server] uvloop = true needs it: {install_command('uwserver[uvloop]')}") from None
    return uvloop.run(serve())


def with_address(resolved: Resolved, port: int | None, bind: str | None, origins: tuple[str, ...]) -> Resolved:
    """Return the scenario with another address for its first sockets adapter, or other pages that may connect to it."""
    given = (("port", port), ("bind", bind), ("allowed_origins", origins or None))
    changes: dict[str, Any] = {k: v for k, v in given if v is not None}
    if not changes:
        return resolved
    name, config = _first_sockets(resolved)
    if not name:
        raise click.UsageError("--port, --bind and --allow-origin need a sockets adapter in the scenario")
    return with_adapter(resolved, name, msgspec.structs.replace(config, **changes))


def _check_port(resolved: Resolved) -> None:
    """Raise a ClickException if another program has the port of the first sockets adapter: told before anything is compiled or started."""
    name, config = _first_sockets(resolved)
    if not name or not config.required:
        return
    holder = holder_of(config.bind, config.port)
    if holder is not None:
        raise click.ClickException(
            f"TCP port {config.port} is taken by {holder}: end it, or add --port 0, which takes a free port"
        )


def _first_sockets(resolved: Resolved) -> tuple[str, Any]:
    """Return name and configuration of the adapter for which commands are printed, or "" and None if there is none."""
    given: Mapping[str, Any] = resolved.scenario.adapters
    found = ((name, config) for name, config in given.items() if config.__struct_config__.tag == "sockets")
    return next(found, ("", None))


def _with_new_token(resolved: Resolved) -> tuple[Resolved, str]:
    """Return the scenario with a new token, and this token, if its first sockets adapter would make one; otherwise the scenario and "".

    It is made here so that the printed commands can hold it.
    """
    name, config = _first_sockets(resolved)
    if not name or known_token(config.token) or is_loopback(config.bind):
        return resolved, ""
    token = new_token()
    return with_adapter(resolved, name, msgspec.structs.replace(config, token=token)), token


def _then_compile_the_rest(
    announce: Callable[[dict[str, str]], None], ending: ExitStack
) -> Callable[[dict[str, str]], None]:
    """Return a function that announces, and then starts a process that compiles what this scenario does not need.

    The process has the lowest priority and ends with the server.
    """
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
    """Print where to look, where to connect and what to type next.

    Args:
        resolved: the scenario.
        quiet: print nothing.
        token: the token that was made for this run; "" if there is none or the user knows it.
        addresses: address of each adapter by name.
        view: name of the adapter of the web view; "" for none.
        shown: the token that its pages need; None for none.
        opens: open the web view in a browser.
    """
    page = addresses.get(view, "")
    if opens:
        open_page(with_token(page, shown and shown.text))
    if quiet:
        return
    first_said, last_said = address_lines(resolved, view, page, shown)
    if first_said:
        click.echo(f"\n{first_said}")
    vehicles = ", ".join(f"{name} ({v.vehicle.name})" for name, v in alike(resolved).items())
    click.echo("\n" * (not first_said) + styled(f"uwserver runs {resolved.name}: {vehicles}", bold=True))
    if resolved.scenario.start == "held":
        click.echo("  Vehicles stay where they are until the first command.")
    for name, address in addresses.items():
        if name != view:
            click.echo(f"  {name}: {address}")
    if last_said:
        click.echo(last_said)
    sockets, config = _first_sockets(resolved)
    first = next(iter(resolved.vehicles.values()), None)
    if sockets and first:
        if token:
            click.echo(
                f"Other machines can reach {addresses[sockets]}: clients must show the token that was made for this run."
            )
        wanted = not token and known_token(config.token)
        click.echo("In another terminal" + (", with UWSERVER_TOKEN set to the server's token:" if wanted else ":"))
        _suggest(addresses[sockets], token, first)
    click.echo("Ctrl-C ends it.\n")


def announced_address(resolved: Resolved, addresses: Mapping[str, str]) -> str:
    """Return the command by which the client reaches the first sockets adapter."""
    port = addresses.get(_first_sockets(resolved)[0], "").rpartition(":")[2]
    return _client() + ("" if port in ("", "7600") else f" --port {port}")


def _client() -> str:
    """Return the command of the client: its name, or its path if it is beside this Python but not on PATH."""
    beside = Path(sys.executable).parent / "uwclient"
    if shutil.which("uwclient") or not beside.exists():
        return "uwclient"
    return os.path.relpath(beside)


def _suggest(address: str, token: str, vehicle: ResolvedVehicle) -> None:
    from uwserver.cli.serving.first_command import first_command

    host, _, port = address.rpartition(":")
    at = ("" if host in ("127.0.0.1", "0.0.0.0") else f" --host {host}") + ("" if port == "7600" else f" --port {port}")
    client = _client() + at + (f" --token {token}" if token else "")
    command = first_command(vehicle)
    for line in ("topics", f"watch '{vehicle.name}/*'", f"send {command}" if command else ""):
        if line:
            click.echo(styled(f"  {client} {line}", fg="cyan"))
