"""The command `manoeuvres`: a report of how a vehicle moves."""

from __future__ import annotations

import json

import click

from uwserver.cli.errors import told
from uwserver.scenario.files.errors import ScenarioError
from uwserver.validation.manoeuvres.report import as_json, markdown, report


@click.command(short_help="Run the manoeuvres of a vehicle, and print the report.")
@click.argument("vehicle")
@click.option(
    "--density",
    default=1025.0,
    show_default=True,
    type=click.FloatRange(500.0, 1500.0),
    help="Density of the water in kg/m3.",
)
@click.option("--json", "json_wanted", is_flag=True, help="Print JSON (SI, radians) instead of markdown.")
def manoeuvres(vehicle: str, density: float, json_wanted: bool) -> None:
    """Run the manoeuvres of VEHICLE and print the report. VEHICLE is a shipped vehicle or a vehicle file.

    The manoeuvres are straight line, turning circle, zig-zag, dive, free decay, stop and others. They run open loop in still water. The
    report compares them with the [[published]] figures of the real vehicle in its file, and says which manoeuvres do not apply.
    `uwserver plot vehicle` draws the vehicle.
    """
    with told(vehicle, ScenarioError, FloatingPointError):
        found = report(vehicle, density)
    click.echo(json.dumps(as_json(found), indent=2) if json_wanted else markdown(found), nl=json_wanted)
