"""`uwserver plot`: a report of a recording; a picture of what a sensor told, from a recording or from a scenario that is run for it; or of a
vehicle."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import Any

import click
import msgspec

import uwserver
from uwserver.ports import Buffer, Port, Refused, Sample
from uwserver.ports.checks import suggestion
from uwserver.recording.report.reading import fields_of
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.water.tables import Environment
from uwserver.units import NANOSECONDS
from uwserver.validation.manoeuvres.report import resolve

_MISSING = "drawing needs matplotlib: pip install 'uwserver[plot]'"
_RUN_S = 20.0
_PATIENCE_S = 1.0
"""What was measured before the end is waited for so long."""
_END = f"the end of a recording, {_RUN_S:g} s of a scenario"
_FILE = click.Path(path_type=Path)


class _Plot(click.Group):
    """A group whose first word may be a recording instead of a command."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """`plot run.mcap` is short for `plot report run.mcap`."""
        if args and args[0] not in (*self.commands, "-h", "--help"):
            args = ["report", *args]
        return super().parse_args(ctx, args)


@click.group(cls=_Plot, short_help="Report on a recording; draw a sensor, or a vehicle.")
def plot() -> None:
    """Write a report of a recording (`uwserver plot run.mcap`), or draw what a sensor told, or a vehicle.

    Pictures need the extra `plot`: pip install 'uwserver[plot]'. The page of a report needs nothing.
    """


@plot.command()
@click.argument("recording", type=_FILE)
@click.option("-o", "--output", type=_FILE, help="HTML page; default: the recording's name as .html.")
@click.option("--vehicle", "vehicles", multiple=True, help="Only this one; may be given several times.")
@click.option("--png", is_flag=True, help="Draw a PNG beside the page, too.")
@click.option("--pdf", is_flag=True, help="Draw a PDF beside the page, too.")
def report(recording: Path, output: Path | None, vehicles: tuple[str, ...], png: bool, pdf: bool) -> None:
    """Write what happened in RECORDING (.mcap) as one HTML page: tracks, depth, attitude, actuators, sensor errors against the truth, events.

    Example: uwserver plot run.mcap -o report.html --png
    """
    from uwserver.recording.report.writing import report_of, write_page, write_picture

    if (png or pdf) and importlib.util.find_spec("matplotlib") is None:
        raise click.ClickException(_MISSING)
    file = output or recording.with_suffix(".html")
    pictures = [file.with_suffix(suffix) for suffix, asked in ((".png", png), (".pdf", pdf)) if asked]
    if recording in (file, *pictures):
        raise click.ClickException(f"{recording} would be overwritten: give -o another name")
    try:
        contents = report_of(recording, vehicles)
        write_page(contents, file)
        left_out = [write_picture(contents, picture) for picture in pictures]
    except ValueError as error:
        raise click.ClickException(str(error)) from error
    except OSError as error:
        raise click.ClickException(f"{error.filename or recording}: {error.strerror or error}") from error
    for remark in contents.remarks:
        click.echo(remark, err=True)
    click.echo(
        f"wrote {file}: {len(contents.panels)} plots, {len(contents.events)} events, {file.stat().st_size} bytes"
    )
    for picture, count in zip(pictures, left_out, strict=True):
        click.echo(
            f"wrote {picture}"
            + (f": without the last {count} plots, which are in the page and in a PDF" if count else "")
        )


@plot.command()
@click.argument("source")
@click.argument("port")
@click.option("-o", "--output", type=_FILE, help="PNG, SVG or PDF; default: the port's name as PNG.")
@click.option("--from", "begin_s", default=0.0, show_default=True, help="First simulation time, s.")
@click.option("--to", "end_s", type=float, help=f"Last simulation time, s; default: {_END}.")
def sensor(source: str, port: str, output: Path | None, begin_s: float, end_s: float | None) -> None:
    """Draw the samples of PORT: SOURCE is a recording (.mcap), or a scenario by name or file, which is run as fast as possible.

    Sonars and cameras give their picture, a side-scan sonar that of its way, a bathymetric one its soundings, a DVL its beams,
    LBL and USBL their beacons, everything else its values over time; grey: not valid.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise click.ClickException(_MISSING)
    from uwserver.cli.pictures import picture

    file = output or Path(f"{port.replace('/', '_')}.png")
    is_recording = source.endswith(".mcap")
    end = end_s if end_s is not None else math.inf if is_recording else _RUN_S
    try:
        found, told = _recorded(Path(source), port) if is_recording else _simulated(source, port, end)
        chosen = [s for s in told if begin_s * NANOSECONDS <= s.t_ns <= end * NANOSECONDS]
        picture(found, chosen).savefig(file, dpi=110, metadata={"Software": None} if file.suffix == ".png" else None)
    except (ScenarioError, Refused, ValueError) as error:
        raise click.ClickException(str(error)) from error
    except OSError as error:
        raise click.ClickException(f"{error.filename or source}: {error.strerror or error}") from error
    click.echo(f"wrote {file}: {len(chosen)} samples")


@plot.command()
@click.argument("vehicle")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="PNG, SVG or PDF; default: the vehicle's name as PNG."
)
def vehicle(vehicle: str, output: Path | None) -> None:
    """Draw VEHICLE, a shipped one by name or a vehicle file: its shapes, thrusters, fins, centres of gravity and of buoyancy."""
    if importlib.util.find_spec("matplotlib") is None:
        raise click.ClickException(_MISSING)
    from uwserver.cli.vehicle_picture import vehicle_picture

    file = output or Path(f"{Path(vehicle).stem}.png")
    try:
        environment = Environment()
        resolved = resolve(vehicle, environment)
        figure = vehicle_picture(resolved, body_params(resolved.vehicle, resolved.devices, environment))
        figure.savefig(file, dpi=110, metadata={"Software": None} if file.suffix == ".png" else None)
    except (ScenarioError, ValueError) as error:
        raise click.ClickException(str(error)) from error
    except OSError as error:
        raise click.ClickException(f"{error.filename or vehicle}: {error.strerror or error}") from error
    click.echo(f"wrote {file}")


def _simulated(source: str, port: str, end_s: float) -> tuple[Port, list[Sample]]:
    world = uwserver.load(source)
    _check(port, [path for path, p in world.ports.items() if p.direction == "sensor"])
    samples: list[Sample] = []
    while world.t_ns < (end_s + _PATIENCE_S) * NANOSECONDS:
        samples += [sample for sample in world.step() if sample.port == port]
    return world.ports[port], samples


def _recorded(file: Path, port: str) -> tuple[Port, list[Sample]]:
    from uwserver.recording.reading import NotReplayable, parts_of

    told = [_in_part(file, port)]
    try:
        told += [_in_part(part, port) for part in parts_of(file)[1:]]
    except NotReplayable as error:
        raise ValueError(str(error)) from error
    _check(port, list(dict.fromkeys(sensor for sensors, _, _ in told for sensor in sensors)))
    described = next(found for _, found, _ in told if found is not None)
    return described, [_sample(described, message) for _, _, messages in told for message in messages]


def _in_part(file: Path, port: str) -> tuple[list[str], Port | None, list[dict[str, Any]]]:
    """The sensors of a file; of one of them the port, if it is there, and its messages."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        try:
            reader = make_reader(stream)
            summary = reader.get_summary()
            channels = {} if summary is None else {channel.topic: channel for channel in summary.channels.values()}
            sensors = [topic for topic, channel in channels.items() if channel.metadata.get("direction") == "sensor"]
            if summary is None or port not in sensors:
                return sensors, None, []
            schema = msgspec.json.decode(summary.schemas[channels[port].schema_id].data)
            described = _port(port, channels[port].metadata["kind"], schema)
            messages = [msgspec.json.decode(m.data) for _, _, m in reader.iter_messages(topics=[port])]
        except McapError as error:
            raise ValueError(f"{file}: no recording that can be read: {error}") from error
    return sensors, described, messages


def _check(port: str, sensors: list[str]) -> None:
    if port not in sensors:
        raise ValueError(f'no sensor "{port}"{suggestion(port, sensors)}; there are: {", ".join(sensors) or "none"}')


def _port(path: str, kind: str, schema: dict[str, Any]) -> Port:
    """The port again, as far as the schema of its channel tells it."""
    return Port(path, "sensor", kind, tuple(fields_of(schema).values()), schema["description"])


def _sample(port: Port, message: dict[str, Any]) -> Sample:
    values = [message["value"][field.name] for field in port.fields]
    value = tuple(_value(v) for v in values)
    return Sample(port.path, message["seq"], message["t_ns"], message["t_sent_ns"], message["valid"], value)


def _value(told: Any) -> Any:
    """As it was: a list is an array, an object a buffer."""
    if isinstance(told, dict):
        try:
            return msgspec.convert(told, Buffer)
        except msgspec.ValidationError as error:
            raise ValueError(f"a message holds no buffer where one should be: {error}") from error
    return tuple(told) if isinstance(told, list) else told


COMMANDS = (plot,)
