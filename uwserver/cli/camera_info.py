"""The command `camera-info`: the calibration file of a camera."""

from __future__ import annotations

import click

from uwserver.cli.loading import loaded
from uwserver.ports.checks import suggestion
from uwserver.sensors.optical.camera.calibration import DISTANCE_M, Calibration, as_opencv, as_ros, calibrations


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
