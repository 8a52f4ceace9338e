"""The table of a camera."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.frames import rotate
from uwserver.sensors.base import Pose, SensorTable
from uwserver.sensors.optical.camera.lens import DomePort, FlatPort, Lens, Model, Window, lens_of, outside, padded
from uwserver.table import NonNegative, Positive, Probability
from uwserver.units import rad

MOST_PIXELS = 4096 * 3072
_WIDEST_DEG = 170.0
"""Widest view of a lens that is no fisheye. At 180 degrees its picture would be infinite."""
Extent = Annotated[int, Meta(ge=8, le=8192)]
Coefficient = Annotated[float, Meta(ge=-100, le=100)]
Focal = Annotated[float, Meta(ge=1, le=1e6)]


class CameraTable(SensorTable, kw_only=True, frozen=True):
    """A camera that looks along its x axis, with y to the right of the picture and z down.

    Attributes:
        latency_s: time from the end of the read-out to the delivery, for compression and transport, as with a USB camera. In real time a picture
            that is not computed by then is lost.
        mode: colour, grey, distance along the axis in mm (uint16, 0 for nothing), or ids of objects (uint16, 0 for none).
        ideal: no noise, and constant exposure.
        width, height: size of the picture, pixels.
        field_of_view_deg: horizontal field of view of the lens behind its port. It is not used if `focal_px` is given.
        focal_px: focal lengths in x and y, from a calibration.
        centre_px: principal point, from a calibration; default: the middle of the picture.
        lens: model of the lens: pinhole, brown_conrady (k1 k2 p1 p2 k3) or fisheye (Kannala-Brandt, k1 to k4).
        distortion: coefficients, in the order of OpenCV and ROS.
        port: the window in front of the lens; default: none, which fits a calibration made in water.
        exposure_s: exposure time at the start. The service `set` changes it, and auto-exposure does.
        auto_exposure: exposure and gain follow the light within about a second.
        max_exposure_s: longest exposure; default: nine tenths of the time between two pictures.
        gain_db: gain at the start.
        max_gain_db: highest gain of auto-exposure.
        read_out_s: time from the read-out of the first row of pixels to that of the last.
        rolling_shutter: each row is exposed when it is read; otherwise all rows at once.
        pixel_um: side of a pixel.
        f_number: f-number of the lens.
        quantum_efficiency: quantum efficiency of red, green and blue, with lens and filters.
        full_well_e, read_noise_e: full well and read noise, electrons.
        dark_current_eps: dark current, electrons/s.
        white_balance: factors of red, green and blue.
        snow_pm3: flakes of marine snow per cubic metre.
        lamp_shadows: lamps throw shadows. This needs a second cast of rays for each lamp.
        baseline_m: makes this the left camera of a stereo pair. The right one, at this distance along y, has the port ``<camera>/right``.
    """

    latency_s: NonNegative | UnsetType = 0.15
    mode: Literal["rgb", "mono", "depth", "segmentation"] = "rgb"
    ideal: bool = False
    width: Extent = 640
    height: Extent = 480
    field_of_view_deg: Annotated[float, Meta(ge=1, le=240)] = 80.0
    focal_px: tuple[Focal, Focal] | UnsetType = UNSET
    centre_px: tuple[float, float] | UnsetType = UNSET
    lens: Model = "pinhole"
    distortion: Annotated[tuple[Coefficient, ...], Meta(max_length=5)] = ()
    port: FlatPort | DomePort | UnsetType = UNSET
    exposure_s: Annotated[float, Meta(gt=0, le=10)] = 0.01
    auto_exposure: bool = True
    max_exposure_s: Annotated[float, Meta(gt=0, le=10)] | UnsetType = UNSET
    gain_db: Annotated[float, Meta(ge=0, le=60)] = 0.0
    max_gain_db: Annotated[float, Meta(ge=0, le=60)] = 24.0
    read_out_s: Annotated[float, Meta(ge=0, le=1)] = 0.02
    rolling_shutter: bool = True
    pixel_um: Annotated[float, Meta(ge=0.5, le=50)] = 2.9
    f_number: Annotated[float, Meta(ge=0.5, le=64)] = 2.0
    quantum_efficiency: tuple[Probability, Probability, Probability] = (0.4, 0.5, 0.45)
    full_well_e: Annotated[float, Meta(ge=100, le=1e6)] = 12000.0
    read_noise_e: Annotated[float, Meta(ge=0, le=1000)] = 3.0
    dark_current_eps: Annotated[float, Meta(ge=0, le=1e6)] = 5.0
    white_balance: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    snow_pm3: Annotated[float, Meta(ge=0, le=10000)] = 50.0
    lamp_shadows: bool = True
    baseline_m: Annotated[float, Meta(gt=0, le=10)] | UnsetType = UNSET

    def __post_init__(self) -> None:
        """Raise ValueError if keys do not go together."""
        if self.width * self.height > MOST_PIXELS:
            raise ValueError(f"{self.width} x {self.height} pixels: at most {MOST_PIXELS} in all")
        if self.focal_px is UNSET and self.lens != "fisheye" and self.field_of_view_deg > _WIDEST_DEG:
            raise ValueError(f'field_of_view_deg is more than {_WIDEST_DEG:g}: give lens = "fisheye"')
        if self.baseline_m is not UNSET and "right" in self.streams:
            raise ValueError('the right camera of the pair is called "right": give the stream another name')
        lens = self.optics()
        lens.check()
        self.window()

    def optics(self) -> Lens:
        """Return the lens."""
        if isinstance(self.focal_px, UnsetType):
            lens = lens_of((self.width, self.height), rad(self.field_of_view_deg), self.lens, self.distortion)
        else:
            middle = 0.5 * (self.width - 1), 0.5 * (self.height - 1)
            lens = Lens(self.width, self.height, *self.focal_px, *middle, self.lens, padded(self.lens, self.distortion))
        return (
            lens if isinstance(self.centre_px, UnsetType) else lens._replace(cx=self.centre_px[0], cy=self.centre_px[1])
        )

    def window(self) -> Window:
        """Return the port. Raises ValueError if no light gets through it to the corners."""
        window = None if isinstance(self.port, UnsetType) else self.port
        if window is not None:
            u, v = np.meshgrid(np.linspace(0, self.width - 1, 9), np.linspace(0, self.height - 1, 9))
            outside(window, self.optics().directions(u.ravel(), v.ravel()))
        return window

    @property
    def longest_s(self) -> float:
        """Longest exposure, s."""
        return 0.9 / self.rate_hz if isinstance(self.max_exposure_s, UnsetType) else self.max_exposure_s

    @property
    def cores(self) -> float:
        """Part of a processor core that its pictures take, about."""
        return self.computing_s * self.rate_hz

    @property
    def given_s(self) -> float:
        """Time from the middle of an exposure, with the settings of the start, to the delivery of the picture, s."""
        exposed = 0.0 if self.mode in ("depth", "segmentation") else 0.5 * self.exposure_s
        return exposed + self.read_out_s + (self.latency_s or 0.0)

    @property
    def computing_s(self) -> float:
        """Processor time (s) of a picture, or of both pictures of a pair, on a 2.5 GHz core by day, about (`uwserver bench sensors`).

        Two lamps add a third as much.
        """
        of_each = {"rgb": 230.0, "mono": 225.0, "depth": 125.0, "segmentation": 320.0}[self.mode]
        both = 1.0 if isinstance(self.baseline_m, UnsetType) else 2.0
        return both * of_each * 1e-9 * self.width * self.height

    @property
    def piece_s(self) -> float:
        """Longest piece of that computation, s, about."""
        return min(max(6e-3, 25e-9 * self.width * self.height), self.computing_s)

    def beside(self, mount: Pose) -> Pose:
        """Return the mount of the right camera of a pair."""
        x, y, z = rotate(mount.q, (0.0, self.baseline_m or 0.0, 0.0))
        return Pose((mount.p[0] + x, mount.p[1] + y, mount.p[2] + z), mount.q)


def gain_of(gain_db: float) -> float:
    """Return a gain (dB) as a factor."""
    return math.pow(10.0, gain_db / 20.0)
