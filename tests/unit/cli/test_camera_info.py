"""`uwserver camera-info` on a shipped scenario."""

from __future__ import annotations

from click.testing import CliRunner

from uwserver.cli import main


def test_both_forms_and_a_name_that_is_none() -> None:
    done = CliRunner().invoke(main, ["camera-info", "one_of_everything", "heavy/camera"])
    assert done.exit_code == 0, done.output
    assert "camera_name: heavy_camera" in done.stdout
    done = CliRunner().invoke(main, ["camera-info", "one_of_everything", "heavy/ranger", "--form", "opencv"])
    assert done.stdout.startswith("%YAML:1.0")
    done = CliRunner().invoke(main, ["camera-info", "one_of_everything", "heavy/camra"])
    assert done.exit_code == 1
    assert 'did you mean "heavy/camera"' in done.output
