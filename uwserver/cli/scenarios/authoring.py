"""The commands `new`, `show` and `copy`: files to begin with, and the files that are shipped."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal, cast

import click

from uwserver.physics.geometry.shapes import BadSolid
from uwserver.ports.checks import suggestion
from uwserver.scenario.authoring.hull import mesh_hull
from uwserver.scenario.authoring.morse_script import LONGEST, NoScript, scenario_from
from uwserver.scenario.authoring.starter import starter, vehicle_starter
from uwserver.scenario.files.convert import NAME
from uwserver.scenario.files.documents import find, shipped
from uwserver.scenario.files.errors import label_of
from uwserver.scenario.files.formats import format_of
from uwserver.scenario.files.formats import told as told_of

_FOLDERS = {"scenario": "", "vehicle": "vehicles", "device": "devices"}
_DEFAULT = "bluerov2_heavy"
_POSITIVE = click.FloatRange(min=0.0, min_open=True)


@click.command(short_help="Write a scenario or a vehicle file to begin with.")
@click.argument("name", required=False)
@click.option(
    "--vehicle",
    metavar="VEHICLE",
    help=f"Vehicle of the scenario [default: {_DEFAULT}]; without NAME, name of the new vehicle.",
)
@click.option(
    "--from", "base", help=f"Shipped vehicle or file from which the new vehicle takes the rest [default: {_DEFAULT}]."
)
@click.option(
    "--mesh", help="Hull of the new vehicle, with x ahead: a closed solid as .stl, .obj, .ply, .glb or .gltf."
)
@click.option("--scale", type=_POSITIVE, help="Metres per unit of the mesh, 0.001 for millimetres [default: 1].")
@click.option(
    "--up", type=click.Choice(["y", "z"]), help="Axis of the mesh that points up [default: y for glTF, else z]."
)
@click.option("--mass", type=_POSITIVE, help="Mass in kg, with --mesh [default: neutral in sea water].")
@click.option(
    "--from-morse",
    "script",
    metavar="SCRIPT",
    help="Convert this Builder script of the simulator MORSE; it is never run.",
)
def new(
    name: str | None, vehicle: str | None, base: str | None, mesh: str | None, scale: float | None, up: str | None,
    mass: float | None, script: str | None,
) -> None:  # fmt: skip
    """Write a commented scenario NAME.toml in this folder. Without NAME, write a vehicle file.

    `uwserver new tank --vehicle bluerov2` writes the scenario tank.toml.

    `uwserver new --vehicle crab --from bluerov2 --mesh hull.stl --mass 12` writes the vehicle file crab.toml. Thrusters and sensors are those
    of the BlueROV2. Volume, centre of volume and inertia are computed from the mesh, added mass and damping by formula.

    `uwserver new sea --from-morse default.py` writes sea.toml from a scenario of the simulator MORSE.
    """
    given = {"--from": base, "--mesh": mesh, "--scale": scale, "--up": up, "--mass": mass}
    if name is not None:
        _refuse_given(given, "of a vehicle file: leave NAME out, and give the vehicle's name by --vehicle")
        _new_scenario(_stem(name, "NAME"), vehicle or _DEFAULT, script)
    elif script is not None:
        raise click.UsageError("--from-morse writes a scenario: give its NAME")
    elif vehicle is None:
        raise click.UsageError("give NAME for a scenario, or --vehicle NAME for a vehicle file")
    else:
        if mesh is None:
            _refuse_given({key: given[key] for key in ("--scale", "--up", "--mass")}, "of a mesh: give it by --mesh")
        axis = cast('Literal["y", "z"] | None', up)
        _new_vehicle(_stem(vehicle, "--vehicle"), base or _DEFAULT, mesh, scale or 1.0, axis, mass)


def _new_scenario(stem: str, vehicle: str, script: str | None) -> None:
    _found(vehicle, "--vehicle")
    text = starter(stem, vehicle) if script is None else _converted(script, stem, vehicle)
    path = _write(stem, text)
    click.echo(f"wrote {path}; next: uwserver check {path} && uwserver run {path}")


def _converted(script: str, stem: str, vehicle: str) -> str:
    """Return the scenario of a Builder script, and print what the scenario leaves out."""
    try:
        with Path(script).open("rb") as file:
            text = file.read(LONGEST + 1).decode("utf-8-sig")
        converted = scenario_from(text, stem, vehicle)
    except (OSError, UnicodeDecodeError, NoScript) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise click.BadParameter(f"{label_of(Path(script))}: {reason}", param_hint="--from-morse") from error
    for remark in converted.remarks:
        click.echo(f"{label_of(Path(script))}, {remark}")
    return converted.text


def _new_vehicle(
    stem: str, base: str, mesh: str | None, scale: float, up: Literal["y", "z"] | None, mass: float | None
) -> None:
    text = _found(base, "--from").read_text(encoding="utf-8-sig")
    begun_as = Path(base).stem
    if mesh is None:
        written = vehicle_starter(stem, begun_as, text)
    else:
        try:
            hull = mesh_hull(Path(mesh), scale, up)
        except BadSolid as error:
            raise click.BadParameter(str(error), param_hint="--mesh") from error
        reading = (f'up = "{up}"\n' if up else "") + (f"scale = {scale!r}\n" if scale != 1.0 else "")
        written = vehicle_starter(stem, begun_as, text, hull, mesh, mass, reading)
        size = " x ".join(f"{edge:.3g}" for edge in hull.size)
        click.echo(f"{mesh}: {size} m (length, width, height), {hull.volume:.4g} m3")
    path = _write(stem, written)
    click.echo(f"wrote {path}; next: uwserver manoeuvres {path}, and uwserver new tank --vehicle {path}")


@click.command()
@click.argument("name")
def show(name: str) -> None:
    """Print a shipped scenario, vehicle or device file."""
    click.echo(_shipped(name)[1].read_text(encoding="utf-8"), nl=False)


@click.command(short_help="Copy a shipped file into this folder, to change it.")
@click.argument("name")
@click.option("--as", "stem", help="Name of the copy, without .toml [default: NAME].")
def copy(name: str, stem: str | None) -> None:
    """Copy a shipped file into this folder, so that you can change it.

    NAME is the name of a scenario, vehicle or device; the copy is NAME.toml.

    Files that a scenario names, such as its seabed, are not copied: give their paths in the copy.
    """
    kind, source = _shipped(name)
    path = _write(source.stem if stem is None else _stem(stem, "--as"), source.read_text("utf-8"))
    uses = {
        "scenario": f"uwserver run {path}",
        "vehicle": f'model = "{path}" in a scenario beside it',
        "device": f'"{path}" in place of its name, in a vehicle file or scenario beside it',
    }
    click.echo(f"wrote {path}, a {kind}; use it by: {uses[kind]}")


def _shipped(name: str) -> tuple[str, Path]:
    """Return the kind of a shipped file and its path."""
    found: Mapping[str, Mapping[str, Path]] = {kind: shipped(folder) for kind, folder in _FOLDERS.items()}
    stem = name.removesuffix(".toml")
    for kind, files in found.items():
        if stem in files:
            return kind, files[stem]
    every = [known for files in found.values() for known in files]
    text = f'nothing that is shipped is called "{name}"{suggestion(name, every)}; `uwserver list` shows what there is'
    raise click.BadParameter(text, param_hint="NAME")


def _found(reference: str, option: str) -> Path:
    """Return the path of a vehicle file, shipped or not; a fault is one of the option."""

    def refuse(text: str) -> None:
        raise click.BadParameter(text, param_hint=option)

    path = find(reference, "vehicles", Path.cwd(), refuse)
    assert path is not None
    kind = format_of(path)
    if kind not in (None, "vehicle"):
        raise click.BadParameter(f"a vehicle file is needed, and {told_of(label_of(path), kind)}", param_hint=option)
    return path


def _refuse_given(options: Mapping[str, object], why: str) -> None:
    for option, value in options.items():
        if value is not None:
            raise click.UsageError(f"{option} is {why}")


def _stem(name: str, hint: str) -> str:
    stem = name.removesuffix(".toml")
    if not NAME.fullmatch(stem):
        raise click.BadParameter("begin with a letter or _, go on with letters, digits, _ and -", param_hint=hint)
    return stem


def _write(stem: str, text: str) -> Path:
    """Write a new TOML file into the working folder, and return its path."""
    path = Path(f"{stem}.toml")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise click.ClickException(f"{path} exists already: choose another name, or remove it first") from None
    except OSError as error:
        raise click.ClickException(f"cannot write {label_of(path)}: {error.strerror}") from error
    return path
