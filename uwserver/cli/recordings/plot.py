"""The command `plot`: a report on a recording, a picture of the samples of a sensor, or a picture of a vehicle."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec
from msgspec import UNSET

import uwserver
from uwserver.cli.loading import require_kind
from uwserver.cli.terminal import FILE, told
from uwserver.packages import install_command
from uwserver.ports import Buffer, Port, Refused, Sample
from uwserver.ports.checks import suggestion
from uwserver.recording.channels import message_of
from uwserver.recording.report.reading import fields_of
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.world.tables import Environment
from uwserver.units import NANOSECONDS
from uwserver.validation.manoeuvres.report import resolve

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_RUN_S = 20.0
_PATIENCE_S = 1.0
"""Simulation time after the end for which samples that were measured before it may still arrive."""
_END = f"the end of a recording, {_RUN_S:g} s of a scenario"
_PICTURE = "PNG, SVG or PDF file to write; default: the name of the"


def _require_matplotlib() -> None:
    if importlib.util.find_spec("matplotlib") is None:
        raise click.ClickException(f"drawing needs matplotlib: {install_command('uwserver[plot]')}")


def _save(figure: Figure, file: Path) -> None:
    """Write a figure. A PNG does not name the version of matplotlib, so that equal pictures are equal files."""
    figure.savefig(file, dpi=110, metadata={"Software": None} if file.suffix == ".png" else None)


class _Plot(click.Group):
    """A group of commands in which `plot run.mcap` is short for `plot report run.mcap`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Insert the command if the first word is none."""
        if args and args[0] not in (*self.commands, "-h", "--help"):
            args = ["report", *args]
        return super().parse_args(ctx, args)


@click.group(cls=_Plot, short_help="Report on a recording; draw a sensor, or a vehicle.")
def plot() -> None:
    """Write a report on a recording (`uwserver plot run.mcap`), or draw the samples of a sensor, or a vehicle.

    Pictures need the extra `plot`. The HTML page of a report needs no extra.
    """


@plot.command()
@click.argument("recording", type=FILE)
@click.option(
    "-o", "--output", type=FILE, help="HTML page to write; default: the name of the recording with the suffix .html."
)
@click.option("--vehicle", "vehicles", multiple=True, help="Report only on this vehicle; may be given several times.")
@click.option("--png", is_flag=True, help="Also write the plots as a PNG beside the page.")
@click.option("--pdf", is_flag=True, help="Also write the plots as a PDF beside the page.")
def report(recording: Path, output: Path | None, vehicles: tuple[str, ...], png: bool, pdf: bool) -> None:
    """Write a report on RECORDING (.mcap) as one HTML page.

    The page shows tracks, depth, attitude, actuators, the errors of sensors against the truth, and events.

    Example: uwserver plot run.mcap -o report.html --png
    """
    from uwserver.recording.report.writing import report_of, write_page, write_picture

    if png or pdf:
        _require_matplotlib()
    file = output or recording.with_suffix(".html")
    pictures = [file.with_suffix(suffix) for suffix, asked in ((".png", png), (".pdf", pdf)) if asked]
    if recording in (file, *pictures):
        raise click.ClickException(f"{recording} would be overwritten: give -o another name")
    require_kind(recording, "a recording", "recording", "log")
    with told(recording, ValueError):
        contents = report_of(recording, vehicles)
        write_page(contents, file)
        left_out = [write_picture(contents, picture) for picture in pictures]
    for remark in contents.remarks:
        click.echo(remark, err=True)
    click.echo(
        f"wrote {file}: {len(contents.panels)} plots, {len(contents.events)} events, {file.stat().st_size} bytes"
    )
    for picture, count in zip(pictures, left_out, strict=True):
        missing = f": without the last {count} plots, which are in the page and in a PDF" if count else ""
        click.echo(f"wrote {picture}{missing}")


@plot.command()
@click.argument("source")
@click.argument("port")
@click.option("-o", "--output", type=FILE, help=f"{_PICTURE} port as PNG.")
@click.option("--from", "begin_s", default=0.0, show_default=True, help="Draw from this simulation time on, s.")
@click.option("--to", "end_s", type=float, help=f"Draw up to this simulation time, s; default: {_END}.")
def sensor(source: str, port: str, output: Path | None, begin_s: float, end_s: float | None) -> None:
    """Draw the samples of the sensor PORT.

    SOURCE is a recording (.mcap), or a scenario by name or file, which is then run as fast as possible.

    Sonars and cameras are drawn as pictures: a side-scan sonar along its track, a bathymetric sonar by its soundings. A DVL is drawn by its
    beams, LBL and USBL by their beacons, and any other sensor as values over time. Grey means that the samples are not valid.
    """
    _require_matplotlib()
    from uwserver.cli.recordings.pictures import picture
    from uwserver.recording.reading import NotReplayable

    file = output or Path(f"{port.replace('/', '_')}.png")
    is_recording = source.endswith(".mcap")
    end = end_s if end_s is not None else math.inf if is_recording else _RUN_S
    with told(source, NotReplayable, ScenarioError, Refused, ValueError):
        found, samples = _recorded(Path(source), port) if is_recording else _simulated(source, port, end)
        chosen = [s for s in samples if begin_s * NANOSECONDS <= s.t_ns <= end * NANOSECONDS]
        _save(picture(found, chosen), file)
    click.echo(f"wrote {file}: {len(chosen)} samples")


@plot.command()
@click.argument("vehicle")
@click.option("-o", "--output", type=FILE, help=f"{_PICTURE} vehicle as PNG.")
def vehicle(vehicle: str, output: Path | None) -> None:
    """Draw VEHICLE: its shapes, thrusters, fins, centre of gravity and centre of buoyancy.

    VEHICLE is a shipped vehicle or a vehicle file.
    """
    _require_matplotlib()
    from uwserver.cli.recordings.vehicle_picture import vehicle_picture

    file = output or Path(f"{Path(vehicle).stem}.png")
    with told(vehicle, ScenarioError, ValueError):
        environment = Environment()
        resolved = resolve(vehicle, environment)
        _save(vehicle_picture(resolved, body_params(resolved.vehicle, resolved.devices, environment)), file)
    click.echo(f"wrote {file}")


def _simulated(source: str, port: str, end_s: float) -> tuple[Port, list[Sample]]:
    world = uwserver.load(source)
    _check(port, [path for path, p in world.ports.items() if p.direction == "sensor"])
    samples: list[Sample] = []
    while world.t_ns < (end_s + _PATIENCE_S) * NANOSECONDS:
        samples += [sample for sample in world.step() if sample.port == port]
    return world.ports[port], samples


def _recorded(file: Path, port: str) -> tuple[Port, list[Sample]]:
    """Return a sensor of a recording, and its samples from all parts."""
    from mcap.records import Channel, Message, Schema

    from uwserver.recording.reading import Reading

    messages: list[bytes] = []
    sensors: dict[str, tuple[Channel, bytes]] = {}
    schemas: dict[int, bytes] = {}
    topics: dict[int, str] = {}
    with Reading(file) as reading:
        for record in reading.records():
            if isinstance(record, Schema):
                schemas[record.id] = record.data
            elif isinstance(record, Channel):
                topics[record.id] = record.topic
                if record.metadata.get("direction") == "sensor":
                    sensors[record.topic] = (record, schemas[record.schema_id])
            elif isinstance(record, Message) and topics.get(record.channel_id) == port:
                messages.append(record.data)
    _check(port, list(sensors))
    channel, data = sensors[port]
    schema = msgspec.json.decode(data)
    about, fields = channel.metadata, tuple(fields_of(schema).values())
    described = Port(port, "sensor", about["kind"], fields, schema["description"], message=message_of(about) or UNSET)
    return described, [_sample(described, msgspec.json.decode(message)) for message in messages]


def _check(port: str, sensors: list[str]) -> None:
    if port not in sensors:
        raise ValueError(f'no sensor "{port}"{suggestion(port, sensors)}; there are: {", ".join(sensors) or "none"}')


def _sample(port: Port, message: dict[str, Any]) -> Sample:
    value = tuple(_value(message["value"][field.name]) for field in port.fields)
    return Sample(port.path, message["seq"], message["t_ns"], message["t_sent_ns"], message["valid"], value)


def _value(entry: Any) -> Any:
    """Return the value of a field from JSON, in which an array is a list and a buffer an object."""
    if isinstance(entry, dict):
        try:
            return msgspec.convert(entry, Buffer)
        except msgspec.ValidationError as error:
            raise ValueError(f"a message holds no buffer where one should be: {error}") from error
    return tuple(entry) if isinstance(entry, list) else entry
