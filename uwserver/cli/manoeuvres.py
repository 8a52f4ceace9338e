"""`uwserver manoeuvres`: what a vehicle does, as a report."""

from __future__ import annotations

import json

import click

from uwserver.scenario.files.errors import ScenarioError
from uwserver.validation.manoeuvres.report import as_json, markdown, report


@click.command(short_help="Run the manoeuvres of a vehicle, and print the report.")
@click.argument("vehicle")
@click.option(
    "--density", default=1025.0, show_default=True, type=click.FloatRange(500.0, 1500.0), help="Of the water, kg/m3."
)
@click.option("--json", "json_wanted", is_flag=True, help="Print JSON (SI, radians) instead of markdown.")
def manoeuvres(vehicle: str, density: float, json_wanted: bool) -> None:
    """Run the manoeuvres of VEHICLE, a shipped one by name or a vehicle file, and print the report.

    Straight line, turning circle, zig-zag, dive, free decay, stop and more, open loop in still water, beside the figures of the real
    vehicle that its file has as [[published]]; what does not apply is said. `uwserver plot vehicle` draws it.
    """
    try:
        found = report(vehicle, density)
    except (ScenarioError, FloatingPointError) as error:
        raise click.ClickException(str(error)) from error
    click.echo(json.dumps(as_json(found), indent=2) if json_wanted else markdown(found), nl=json_wanted)


COMMANDS = (manoeuvres,)
