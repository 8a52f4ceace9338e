"""`uwserver plot vehicle`: what a vehicle's file says, drawn."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner
from manoeuvre_rig import FINS, ROV, TORPEDO, vehicle, written

from uwserver.cli import main
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.world.tables import Environment
from uwserver.validation.manoeuvres.report import resolve


@pytest.mark.parametrize("raw", [ROV, TORPEDO])
def test_a_vehicle_is_drawn(tmp_path: Path, raw: dict[str, object]) -> None:
    from matplotlib.image import imread

    picture = tmp_path / "drawn.png"
    done = CliRunner().invoke(main, ["plot", "vehicle", str(written(tmp_path, raw)), "-o", str(picture)])
    assert (done.exit_code, done.output) == (0, f"wrote {picture}\n")
    image = imread(picture)
    red = (image[..., 0] > 0.7) & (image[..., 1] < 0.4)
    assert red.sum() > 100, "thrust is drawn"


def test_three_views_name_each_propulsor_and_fin(tmp_path: Path) -> None:
    from uwserver.cli.recordings.vehicle_picture import vehicle_picture

    environment = Environment()
    resolved = resolve(str(written(tmp_path, TORPEDO)), environment)
    figure = vehicle_picture(resolved, body_params(resolved.vehicle, resolved.devices, environment))
    assert [axis.get_title() for axis in figure.axes] == ["from above", "from starboard", "from behind"]
    above = {text.get_text() for text in figure.axes[0].texts}
    assert above >= {"rudder, planes", "main"}, "what lies behind each other shares a line"
    assert figure.axes[1].yaxis_inverted(), "down is down"
    assert all(text.get_fontsize() >= 9 for axis in figure.axes for text in axis.texts if text.get_text())


def test_a_hull_without_shapes_is_drawn_too(tmp_path: Path) -> None:
    bare = vehicle(fins=FINS)
    del bare["collision"]
    done = CliRunner().invoke(main, ["plot", "vehicle", str(written(tmp_path, bare)), "-o", str(tmp_path / "x.svg")])
    assert done.exit_code == 0


def test_no_picture_of_a_vehicle_that_there_is_not(tmp_path: Path) -> None:
    done = CliRunner().invoke(main, ["plot", "vehicle", "nothing", "-o", str(tmp_path / "x.png")])
    assert done.exit_code == 1
    assert 'unknown vehicle "nothing"' in done.output
