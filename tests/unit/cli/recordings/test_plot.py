"""`uwserver plot sensor`: pictures of every kind of sensor, from a scenario and from a recording."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from playback_rig import recorded
from run_rig import recorded_run

from uwserver.cli.recordings.plot import plot
from uwserver.packages import install_command
from uwserver.ports import Buffer, Field, Port, Sample
from uwserver.ports.buffer import Layout
from uwserver.recording.channels import message_of
from uwserver.recording.parts import Rotation
from uwserver.scenario.authoring.catalogue import SensorKind, sensor_kinds
from uwserver.scenario.files.convert import kinds_of
from uwserver.sensors import SensorConfig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCENARIO = """\
schema = 1
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0, 0, 4]
[seabed]
kind = "flat"
depth_m = 8
[vehicles.rov.sensors.sonar]
kind = "scanning_sonar"
rate_hz = 40
range_m = 10
step_deg = 3.6
position_frd_m = [0.0, 0.0, 0.4]
[vehicles.rov.sensors.loud]
kind = "scanning_sonar"
output = "complex"
rate_hz = 40
range_m = 10
[vehicles.rov.sensors.imaging]
kind = "multibeam"
output = "complex"
rate_hz = 5
range_m = 10
bins = 64
beams = 24
rays_vertical = 32
field_deg = 60
beam_width_horizontal_deg = 3
rpy_deg = [0.0, -30.0, 0.0]
[vehicles.rov.sensors.side]
kind = "side_scan"
rate_hz = 5
range_m = 20
bins = 100
rays_vertical = 64
[vehicles.rov.sensors.swath]
kind = "bathymetry"
rate_hz = 5
range_m = 20
bins = 200
beams = 32
beam_width_across_deg = 4
[vehicles.rov.sensors.log]
kind = "dvl"
profile = "a50"
rate_hz = 8
"""


def picture(port: Port, samples: Sequence[Sample]) -> Figure:
    from uwserver.cli.recordings.pictures import picture as drawn_of

    return drawn_of(port, samples)


def meshes(axis: Any) -> list[Any]:
    """What is drawn of cells."""
    from matplotlib.collections import QuadMesh

    return [each for each in axis.get_children() if isinstance(each, QuadMesh)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plot")
    (folder / "x.toml").write_text(SCENARIO)
    recorded_run(folder / "x.toml", folder / "x.mcap", 1.2)
    return folder


def run(folder: Path, *arguments: str) -> Result:
    paths = [str(folder / a) if a.startswith("x.") else a for a in arguments]
    return CliRunner().invoke(plot, ["sensor", *paths])


def drawn(folder: Path, source: str, name: str, target: str) -> Path:
    """A picture of the first second."""
    file = folder / target
    result = run(folder, source, f"rov/{name}", "-o", str(file), "--to", "1")
    assert result.exit_code == 0, result.output
    assert file.read_bytes().startswith(b"\x89PNG")
    assert "samples" in result.output
    return file


@pytest.mark.parametrize("name", ["log", "loud", *(pytest.param(n, marks=pytest.mark.slow) for n in ("side", "swath"))])
def test_a_picture_from_a_recording(folder: Path, name: str) -> None:
    drawn(folder, "x.mcap", name, f"x.{name}.png")


@pytest.mark.parametrize("name", ["sonar", "imaging"])
def test_a_scenario_and_a_recording_give_the_same_picture(folder: Path, name: str) -> None:
    one, other = (drawn(folder, source, name, f"same.{source}.png") for source in ("x.toml", "x.mcap"))
    assert one.read_bytes() == other.read_bytes()


def test_pictures_of_echoes_are_those_of_the_samples() -> None:
    """A waterfall of both sides, port to the left; a fan of an imaging sonar; soundings to starboard and down."""
    side = Port(
        "rov/side", "sensor", "side_scan",
        (Field("range", "m", ""), *(Field(n, "1", "", type="buffer", buffer=Layout("uint8", (3,))) for n in ("port", "starboard"))), "",
        message="SideScan",
    )  # fmt: skip
    rows = [Buffer.of(np.array(row, np.uint8)) for row in ((1, 2, 3), (4, 5, 6))]
    figure = picture(side, [Sample("rov/side", k, k * 10**9, 0, True, (30.0, *rows)) for k in range(4)])
    (image,) = figure.axes[0].images
    assert image.get_array().tolist() == [[3, 2, 1, 4, 5, 6]] * 4
    assert image.get_extent() == [-30.0, 30.0, 0.0, 3.0]
    fields = tuple(
        Field(n, "Pa", "", type="buffer", buffer=Layout("float32", s))
        for n, s in (("azimuth", (2,)), ("image", (3, 2, 2)))
    )
    fan = Port(
        "rov/fan",
        "sensor",
        "multibeam",
        (Field("range_start", "m", ""), Field("range", "m", ""), *fields),
        "",
        message="SonarImage",
    )
    wave = np.zeros((3, 2, 2), np.float32)
    wave[2, 1] = 3e-6, -4e-6
    azimuth = Buffer.of(np.array([-0.1, 0.1], np.float32))
    figure = picture(fan, [Sample("rov/fan", 0, 0, 0, True, (0.0, 6.0, azimuth, Buffer.of(wave)))])
    (mesh,) = meshes(figure.axes[0])
    levels = np.asarray(mesh.get_array())
    assert levels[2, 1] == levels.max() == pytest.approx(20.0 * math.log10(5.0))
    assert levels[0, 0] == pytest.approx(levels.max() - 80.0)
    fields = tuple(
        Field(n, "1", "", type="buffer", buffer=Layout("float32", (2,))) for n in ("angle", "range", "quality")
    )
    swath = Port("rov/swath", "sensor", "bathymetry", fields, "", message="Bathymetry")
    told = [Buffer.of(np.array(row, np.float32)) for row in ((-math.pi / 6, math.pi / 6), (10.0, 20.0), (0.5, 1.0))]
    figure = picture(swath, [Sample("rov/swath", 0, 0, 0, True, tuple(told))])
    assert np.asarray(figure.axes[0].collections[0].get_offsets()) == pytest.approx(
        np.array([[-5.0, 10.0 * math.cos(math.pi / 6)], [10.0, 20.0 * math.cos(math.pi / 6)]]), rel=1e-6
    )
    for port, nothing in ((side, (30.0, None, None)), (fan, (0.0, 6.0, None, None)), (swath, (None,) * 3)):
        with pytest.raises(ValueError, match=port.path):
            picture(port, [Sample(port.path, 0, 0, 0, False, nothing)])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("x.mcap", "rov/sona"), 'no sensor "rov/sona"'),
        (("x.toml", "rov/thrusters"), "there are: "),
        (("x.nothing.mcap", "rov/sonar"), "No such file"),
        (("nothing", "rov/sonar"), "unknown scenario"),
        (("x.mcap", "rov/sonar", "--from", "99"), "gave no samples in that time"),
        (("x.mcap", "rov/sonar", "-o", "/nowhere/at/all.png"), "No such file"),
    ],
)
def test_what_cannot_be_drawn_is_told(folder: Path, arguments: tuple[str, ...], told: str) -> None:
    result = run(folder, *arguments)
    assert result.exit_code == 1
    assert told in result.output


def test_the_samples_of_all_parts_are_drawn(tmp_path: Path) -> None:
    recorded(tmp_path / "one.mcap", 600)
    recorded(tmp_path / "run.mcap", 600, rotation=Rotation(most_s=1.0))
    assert (tmp_path / "run.0003.mcap").exists()
    for name in ("one", "run"):
        arguments = [str(tmp_path / f"{name}.mcap"), "rov/pressure", "-o", str(tmp_path / f"{name}.png")]
        result = CliRunner().invoke(plot, ["sensor", *arguments])
        assert result.exit_code == 0, result.output
    assert (tmp_path / "run.png").read_bytes() == (tmp_path / "one.png").read_bytes()
    (tmp_path / "run.0002.mcap").unlink()
    result = CliRunner().invoke(plot, ["sensor", str(tmp_path / "run.mcap"), "rov/pressure"])
    assert "its part run.0002.mcap is missing" in result.output


def test_a_file_that_is_no_recording_is_told(folder: Path) -> None:
    (folder / "x.bad.mcap").write_bytes(b"no recording")
    result = run(folder, "x.bad.mcap", "rov/sonar")
    assert result.exit_code == 1
    assert "x.bad.mcap: not an MCAP file" in result.output


def test_without_matplotlib_it_says_what_to_install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    result = run(folder, "x.mcap", "rov/sonar")
    assert result.exit_code == 1
    assert install_command("uwserver[plot]") in result.output


def samples(port: Port, n: int) -> list[Sample]:
    """Numbers that grow with time; every fourth reading is invalid and empty."""
    told = []
    for k in range(n):
        value = []
        for field in port.fields:
            if field.buffer:
                shape = tuple(2 if extent < 0 else extent for extent in field.buffer.shape)
                value.append(None if k % 4 == 3 else Buffer.of(np.full(shape, k, field.buffer.dtype)))
                continue
            if field.type == "bytes":
                value.append(None if k % 4 == 3 else Buffer(data=bytes(k)))
                continue
            part = {"float": 0.1 * (k + 1), "int": k, "bool": k % 2 == 0, "str": f"b{k % 2}"}[field.type]
            part = None if k % 4 == 3 and field.type != "str" else part
            value.append((part,) * field.size if field.shape else part)
        told.append(Sample(port.path, k, k * 10**8, k * 10**8, k % 4 != 3, tuple(value)))
    return told


@pytest.fixture(scope="module")
def kinds() -> dict[str, SensorKind]:
    return sensor_kinds()


OWN = "bathymetry", "camera", "multibeam", "scanning_sonar", "side_scan", "dvl", "adcp", "usbl", "lbl"
"""Kinds that have a picture of their own."""

RENDERED = [
    *((kind, 20) for kind in OWN),
    ("leak", 20),
    ("range_array", 20),
    ("scanning_sonar", 1),
    ("side_scan", 1),
    ("adcp", 1),
]
"""Beside them some whose numbers stand over time, true or false and as lines; and the kinds of which one sample is drawn in another way."""


@pytest.mark.parametrize("kind", kinds_of(SensorConfig))
def test_every_kind_can_be_drawn(kinds: dict[str, SensorKind], kind: str) -> None:
    from uwserver.cli.recordings.pictures import _PICTURES

    assert _PICTURES.keys() == {message_of({"kind": own}) for own in OWN}
    for output in kinds[kind].outputs:
        port = Port("rov/x", "sensor", kind, output.fields, output.doc, 10.0, message=message_of({"kind": kind}))
        assert picture(port, samples(port, 20)).axes
        with pytest.raises(ValueError, match="gave no samples"):
            picture(port, [])


@pytest.mark.parametrize(
    ("kind", "n"),
    [
        (kind, n) if (kind, n) in RENDERED else pytest.param(kind, n, marks=pytest.mark.slow)
        for kind in kinds_of(SensorConfig)
        for n in (20, 1)
    ],
)
def test_what_is_drawn_can_be_rendered(kinds: dict[str, SensorKind], tmp_path: Path, kind: str, n: int) -> None:
    for output in kinds[kind].outputs:
        port = Port("rov/x", "sensor", kind, output.fields, output.doc, 10.0, message=message_of({"kind": kind}))
        picture(port, samples(port, n)).savefig(tmp_path / "x.png")


def test_a_current_profile_stands_over_time_and_cell(kinds: dict[str, SensorKind]) -> None:
    """Over ground where it is known, else relative to the device; a single sample is a profile over distance."""
    fields = kinds["adcp"].outputs[0].fields
    port = Port("rov/x", "sensor", "adcp", fields, "", 2.0, message="CurrentProfile")
    cells = next(f for f in fields if f.name == "distances").size

    def told(ground: bool) -> list[Sample]:
        made = []
        for k in range(3):
            values: dict[str, object] = {f.name: (None,) * f.size if f.shape else None for f in fields}
            values["distances"] = tuple(0.5 * (i + 1) for i in range(cells))
            name = "velocities_N" if ground else "velocities_S"
            values[name] = tuple(float(10 * k + i) if part == 1 else 0.0 for i in range(cells) for part in range(3))
            made.append(Sample("rov/x", k, k * 10**8, 0, True, tuple(values.values())))
        return made

    for ground, title in ((True, "velocities_N"), (False, "velocities_S")):
        axes = picture(port, told(ground)).axes
        assert axes[0].get_title() == title
        (image,) = meshes(axes[1])
        assert image.get_array().reshape(cells, 3)[4].tolist() == [4.0, 14.0, 24.0]
    axis = picture(port, told(True)[:1]).axes[0]
    assert axis.lines[1].get_xdata().tolist() == list(range(cells))
    assert axis.lines[1].get_ydata()[3] == 2.0


def test_an_echo_stands_where_it_came_from(kinds: dict[str, SensorKind]) -> None:
    """One bright bin of one ping: in the picture at its angle and distance, the newest ping of an angle counts."""
    fields = kinds["scanning_sonar"].outputs[0].fields
    port = Port("rov/x", "sensor", "scanning_sonar", fields, "", 10.0, message="SonarPing")
    told = []
    for turn in range(2):
        for k in range(100):
            bins = [0.0] * 400
            bins[300] = 255.0 if turn == 1 and k == 25 else 9.0 if turn == 0 else 0.0
            angle = math.remainder(k * 2.0 * math.pi / 100, 2.0 * math.pi)
            told.append(Sample("rov/x", len(told), len(told) * 10**8, 0, True, (angle, 20.0, 0.0, tuple(bins))))
    axis = picture(port, told).axes[0]
    assert axis.get_theta_direction() == -1
    images = meshes(axis)
    bright = [(image, image.get_array()) for image in images if image.get_array().max() == 255.0]
    ((image, array),) = bright
    assert sum(int(np.count_nonzero(i.get_array())) for i in images) == 1
    row, column = np.unravel_index(int(np.argmax(array)), array.shape)
    corners = np.asarray(image.get_coordinates()[row : row + 2, column : column + 2]).reshape(4, 2)
    assert corners.mean(axis=0).tolist() == pytest.approx([math.pi / 2.0, 300.5 * 20.0 / 400], abs=1e-6)
