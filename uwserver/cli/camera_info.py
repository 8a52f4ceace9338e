"""The command `camera-info`: the calibration file of a camera."""

from __future__ import annotations

import click
from msgspec import UnsetType

from uwserver.cli.loading import loaded
from uwserver.ports.checks import suggestion
from uwserver.sensors import CameraConfig
from uwserver.sensors.optical.camera.calibration import DISTANCE_M, Calibration, as_opencv, as_ros, calibration


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
        for key, config in vehicle.vehicle.sensors.items():
            if isinstance(config, CameraConfig):
                there[f"{name}/{key}"] = found = calibration(config, distance)
                if not isinstance(config.baseline_m, UnsetType):
                    there[f"{name}/{key}/right"] = found._replace(baseline=config.baseline_m)
    if camera not in there:
        raise click.ClickException(
            f'no camera "{camera}" in {scenario}{suggestion(camera, there)}; there are: {", ".join(there) or "none"}'
        )
    found = there[camera]
    click.echo(as_ros(camera.replace("/", "_"), found) if form == "ros" else as_opencv(found), nl=False)
    if found.error_px > 0.0:
        click.echo(
            f"a flat port is no lens: this model is off by {found.error_px:.2g} px rms at {distance:g} m", err=True
        )
