"""The commands `validate` and `manoeuvres`: the integrator against reference trajectories, and a report on a vehicle."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import click

from uwserver.cli.terminal import FILE, styled, told
from uwserver.scenario.files.errors import ScenarioError
from uwserver.validation.manoeuvres.pages import markdown, plain
from uwserver.validation.manoeuvres.report import as_json, report
from uwserver.validation.oracle import OracleResult
from uwserver.validation.oracle import validate as validate_oracle

COLUMNS = ("position m", "attitude deg", "velocity m/s", "rate rad/s")
_RATE = click.FloatRange(0.0, 1e6, min_open=True)


@click.command(short_help="Run oracle files through the integrator.")
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=FILE)
@click.option("--rate-hz", default=240.0, show_default=True, type=_RATE, help="Rate of the integrator, Hz.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def validate(files: tuple[Path, ...], rate_hz: float, as_json: bool) -> None:
    """Run reference trajectories (oracle files, format uwserver-oracle-1) through the integrator, and print the largest errors.

    The exit status is 1 if a file cannot be read or has another format; the other files are still run.
    """
    results: dict[str, OracleResult] = {}
    faults: list[str] = []
    for file in files:
        try:
            results[str(file)] = validate_oracle(file, rate_hz)
        except OSError as error:
            faults.append(f"{file}: {error.strerror or error}")
        except ValueError as error:
            faults.append(str(error))
    click.echo(json.dumps(_as_json(results), indent=2) if as_json else _table(results), nl=bool(results) or as_json)
    for fault in faults:
        click.echo(f"uwserver validate: {fault}", err=True)
    if faults:
        raise SystemExit(1)


def _as_json(results: dict[str, OracleResult]) -> list[dict[str, object]]:
    return [
        {
            "file": file,
            "rate_hz": result.rate_hz,
            "samples": result.samples,
            "steps": result.steps,
            "position_m": result.position.error,
            "position_at_s": result.position.t_s,
            "attitude_deg": result.attitude.error,
            "attitude_at_s": result.attitude.t_s,
            "linear_velocity_mps": result.linear_velocity.error,
            "linear_velocity_at_s": result.linear_velocity.t_s,
            "angular_velocity_radps": result.angular_velocity.error,
            "angular_velocity_at_s": result.angular_velocity.t_s,
        }
        for file, result in results.items()
    ]


def _table(results: dict[str, OracleResult]) -> str:
    """Return a line for each file, with each largest error and the time at which it occurs."""
    if not results:
        return ""
    width = max(len("file"), *(len(Path(file).name) for file in results))
    lines = [f"{'file':{width}}  {'rate Hz':>8}  " + "  ".join(f"{name:>20}" for name in COLUMNS)]
    for file, result in results.items():
        cells = [f"{worst.error:9.3g} at {worst.t_s:6g} s" for worst in result[:4]]
        lines.append(f"{Path(file).name:{width}}  {result.rate_hz:8g}  " + "  ".join(f"{cell:>20}" for cell in cells))
    return "\n".join(lines)


@click.command(short_help="Run the manoeuvres of a vehicle, and print the report.")
@click.argument("vehicle")
@click.option(
    "--density",
    default=1025.0,
    show_default=True,
    type=click.FloatRange(500.0, 1500.0),
    help="Density of the water in kg/m3.",
)
@click.option("--json", "json_wanted", is_flag=True, help="Print JSON (SI, radians).")
@click.option(
    "--markdown",
    "markdown_wanted",
    is_flag=True,
    help="Print Markdown; also the default where the output is no terminal.",
)
def manoeuvres(vehicle: str, density: float, json_wanted: bool, markdown_wanted: bool) -> None:
    """Run the manoeuvres of VEHICLE and print the report. VEHICLE is a shipped vehicle or a vehicle file.

    The report begins with a verdict: what stands out, why, and what to change in the file.

    The manoeuvres are straight line, turning circle, zig-zag, dive, free decay, stop and others. They run open loop in still water. The
    report compares them with the [[published]] figures of the real vehicle in its file, and says which manoeuvres do not apply.
    `uwserver plot vehicle` draws the vehicle.
    """
    with told(vehicle, ScenarioError, FloatingPointError):
        found = report(vehicle, density)
    if json_wanted:
        click.echo(json.dumps(as_json(found), indent=2))
    elif markdown_wanted or not sys.stdout.isatty():
        click.echo(markdown(found), nl=False)
    else:
        click.echo(plain(found, shutil.get_terminal_size().columns, _styled), nl=False)


def _styled(text: str, style: str) -> str:
    return styled(text, bold=True) if style == "title" else styled(text, fg="yellow")
