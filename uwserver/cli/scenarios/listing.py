"""The commands `list`, `schema` and `camera-info`: the kinds and files that there are, and the calibration of a camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import click
import numpy as np
from msgspec import Struct

from uwserver.actuators import ActuatorConfig
from uwserver.adapter import installed_adapters
from uwserver.cli.loading import loaded
from uwserver.modifiers import ModifierConfig
from uwserver.ports.checks import suggestion
from uwserver.scenario.authoring.catalogue import (
    FileKind,
    SensorKind,
    first_sentence,
    json_schema,
    keys_of,
    modifier_kinds,
    sensor_kinds,
)
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.convert import kinds_of
from uwserver.scenario.files.documents import read, shipped
from uwserver.scenario.files.errors import suggestion as suggestion_or_list
from uwserver.scenario.load.scenario import load
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.sensors import SensorConfig
from uwserver.sensors.optical.camera.calibration import DISTANCE_M, Calibration, as_opencv, as_ros, calibrations
from uwserver.table import Vector3


@click.command(short_help="Print the JSON Schema of scenario, vehicle or device files.")
@click.option("--vehicle", "kind", flag_value="vehicle", help="Print the schema of vehicle files.")
@click.option("--device", "kind", flag_value="device", help="Print the schema of device files: thrusters and sensors.")
@click.option(
    "--scenario", "kind", flag_value="scenario", default=True, help="Print the schema of scenario files (the default)."
)
def schema(kind: FileKind) -> None:
    """Print the JSON Schema of scenario, vehicle or device files."""
    click.echo(json_schema(kind), nl=False)


def _files(folder: str, key: str) -> dict[str, str]:
    return {name: str(read(path).raw.get(key, "")) for name, path in shipped(folder).items()}


def _kinds(kinds: Mapping[str, type]) -> dict[str, str]:
    return {kind: first_sentence(table) for kind, table in kinds.items()}


_LISTS: Mapping[str, Callable[[], dict[str, str]]] = {
    "scenarios": lambda: _files("", "title"),
    "vehicles": lambda: _files("vehicles", "description"),
    "devices": lambda: _files("devices", "kind"),
    "sensors": lambda: _kinds(kinds_of(SensorConfig)),
    "actuators": lambda: _kinds(kinds_of(ActuatorConfig)),
    "modifiers": lambda: _kinds(kinds_of(ModifierConfig)),
    "adapters": lambda: _kinds(installed_adapters()),
}
"""A text for each thing in a section, by its name."""


@click.command("list", short_help="List scenarios, vehicles, devices, and kinds of component.")
@click.argument("what", type=click.Choice(list(_LISTS)), required=False)
@click.argument("kind", required=False)
def list_(what: str | None, kind: str | None) -> None:
    """List what is installed: scenarios, vehicles, devices, and the kinds of sensor, actuator, modifier and adapter.

    `uwserver list sensors` also shows what each kind measures, its keys and its device files; `uwserver list sensors dvl` shows one kind.

    `uwserver list modifiers` also shows the keys of each kind.

    `uwserver list vehicles bluerov2` shows the thrusters, fins, propellers, sensors and actuators of this vehicle.
    """
    for section in [what] if what else list(_LISTS):
        if not what:
            click.echo(f"{section}:")
        lines = _LISTS[section]()
        if kind is not None and kind not in lines:
            raise click.BadParameter(
                f'there is no "{kind}"{suggestion_or_list(kind, list(lines), "; there are: ")}', param_hint="KIND"
            )
        details = _DETAILS[section]() if what in _DETAILS else {}
        if section == "vehicles" and kind is not None:
            details = {kind: list(parts_of(kind))}
        for name, line in lines.items():
            if kind in (None, name):
                click.echo(f"{'' if what else '  '}{name:<22} {line}".rstrip())
                for detail in details.get(name, ()):
                    click.echo(f"    {detail}")


def _sensor_lines(kind: SensorKind) -> Iterator[str]:
    for output in kind.outputs:
        yield output.doc
        for field in output.fields:
            yield f"  {field.name:<20} {field.form:<7} {field.unit:<8} {field.frame or '-':<3} {field.doc}"
    yield _keys(kind.table)
    settings = [setting.name for setting in kind.outputs[0].settings]
    yield f"set while it runs: {', '.join(['rate_hz', *settings])}"
    if kind.devices:
        yield "profiles: " + ", ".join(f"{device.name} ({device.title})" for device in kind.devices)


def _keys(table: type[Struct]) -> str:
    keys = [f"{name} ({default})" for name, default in keys_of(table).items()]
    return f"keys: {', '.join(keys) or 'none of its own'}"


_DETAILS: Mapping[str, Callable[[], Mapping[str, list[str]]]] = {
    "sensors": lambda: {name: list(_sensor_lines(kind)) for name, kind in sensor_kinds().items()},
    "modifiers": lambda: {name: [_keys(table)] for name, table in modifier_kinds().items()},
}
"""Further lines about each thing in a section, by its name."""


# -- the parts of a vehicle -------------------------------------------------------------------------------------------------------------


def parts_of(name: str) -> Iterator[str]:
    """Yield lines about a shipped vehicle, with positions in B (forward, right, down)."""
    scenario = ScenarioBuilder(name).vehicle("v", name, position_ned_m=(0.0, 0.0, 5.0)).build()
    yield from body_lines(load(scenario, adapters={}).vehicles["v"].vehicle)
    yield f"picture: uwserver plot vehicle {name}; what it does: uwserver manoeuvres {name}"


def body_lines(file: VehicleFile) -> Iterator[str]:
    """Yield lines about the body, the propulsors and the components of a vehicle."""
    body = file.rigid_body
    yield f"{body.mass_kg:g} kg, displaces {1e3 * file.buoyancy.volume_m3:g} l"
    yield from _propulsors(file)
    if file.fins:
        yield f"fins: {', '.join(file.fins)}"
    for title, table in (("sensors", file.sensors), ("actuators", file.actuators)):
        kinds = [f"{key} ({part.__struct_config__.tag})" for key, part in table.items()]
        yield f"{title}: {', '.join(kinds) or 'none'}"


def _propulsors(file: VehicleFile) -> Iterator[str]:
    placed = [("thruster", key, each.position_frd_m, each.axis_frd) for key, each in file.thrusters.items()]
    placed += [("propeller", key, each.position_frd_m, each.axis_frd) for key, each in file.propellers.items()]
    if placed:
        yield f"{'':10} {'':14} {'at, m: x forward':>16} {'y right':>8} {'z down':>8}   pushes to, at a positive command"
    for kind, key, place, axis in placed:
        x, y, z = place
        yield f"{kind:10} {key:14} {x:>16.3f} {y:>8.3f} {z:>8.3f}   {_direction(axis)}"


def _direction(axis: Vector3) -> str:
    """Return a direction in B in words, followed by its components: ``ahead and right (0.71, 0.71, 0.00)``."""
    unit = np.array(axis) / np.linalg.norm(axis)
    names = (("ahead", "astern"), ("right", "left"), ("down", "up"))
    words = [names[k][int(unit[k] < 0)] for k in range(3) if abs(unit[k]) > 0.2]
    return f"{' and '.join(words)} ({', '.join(f'{each + 0.0:.2f}' for each in unit)})"


# -- camera-info ------------------------------------------------------------------------------------------------------------------------


@click.command("camera-info", short_help="Print the calibration of a camera, for ROS or OpenCV.")
@click.argument("scenario")
@click.argument("camera")
@click.option(
    "--form", type=click.Choice(["ros", "opencv"]), default="ros", show_default=True, help="Format of the file."
)
@click.option(
    "--distance",
    default=DISTANCE_M,
    show_default=True,
    type=click.FloatRange(0.1, 1000.0),
    help="Distance of the calibration board in m; it matters behind a flat port.",
)
def camera_info(scenario: str, camera: str, form: str, distance: float) -> None:
    """Print the calibration of CAMERA in SCENARIO, under water, as YAML.

    CAMERA is a path such as rov/camera; the right camera of a stereo pair is rov/camera/right.
    """
    resolved, _ = loaded(scenario)
    there: dict[str, Calibration] = {}
    for name, vehicle in resolved.vehicles.items():
        found = calibrations(vehicle.vehicle.sensors, distance)
        there |= {f"{name}/{key}": each for key, each in found.items()}
    if camera not in there:
        raise click.ClickException(
            f'no camera "{camera}" in {scenario}{suggestion(camera, there)}; there are: {", ".join(there) or "none"}'
        )
    wanted = there[camera]
    click.echo(as_ros(camera.replace("/", "_"), wanted) if form == "ros" else as_opencv(wanted), nl=False)
    if wanted.error_px > 0.0:
        click.echo(
            f"a flat port is no lens: this model is off by {wanted.error_px:.2g} px rms at {distance:g} m", err=True
        )
