"""The table of a camera."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.frames import rotate
from uwserver.sensors.base import Pose, SensorTable
from uwserver.sensors.optical.camera.lens import Lens, Model, lens_of, padded
from uwserver.sensors.optical.camera.window import ACRYLIC_INDEX, DomePort, FlatPort, Window, outside
from uwserver.table import NonNegative, Positive, Probability, Table
from uwserver.units import rad

MOST_PIXELS = 4096 * 3072
_WIDEST_DEG = 170.0
"""Of a lens that is no fisheye: its picture would be without end at 180."""
Extent = Annotated[int, Meta(ge=8, le=8192)]
Index = Annotated[float, Meta(ge=1, le=3)]
Coefficient = Annotated[float, Meta(ge=-100, le=100)]
Focal = Annotated[float, Meta(ge=1, le=1e6)]


class FlatTable(Table, tag="flat", tag_field="kind", kw_only=True, frozen=True):
    """A plane window across the axis: the picture shrinks by a third, and more towards its corners.

    Attributes:
        distance_m: of its inner face from the entrance pupil.
        thickness_m, index: of the window.
    """

    distance_m: Annotated[float, Meta(ge=0, le=1)] = 0.01
    thickness_m: Annotated[float, Meta(ge=0, le=0.5)] = 0.005
    index: Index = ACRYLIC_INDEX

    def window(self) -> Window:
        """As rays see it."""
        return FlatPort(self.distance_m, self.thickness_m, self.index)


class DomeTable(Table, tag="dome", tag_field="kind", kw_only=True, frozen=True):
    """A dome.

    Attributes:
        radius_m: of its outer face.
        thickness_m, index: of its wall.
        offset_m: of its centre ahead of the entrance pupil; at 0 it bends nothing.
    """

    radius_m: Annotated[float, Meta(gt=0, le=1)] = 0.05
    thickness_m: Annotated[float, Meta(ge=0, le=0.2)] = 0.003
    offset_m: Annotated[float, Meta(ge=-1, le=1)] = 0.0
    index: Index = ACRYLIC_INDEX

    def window(self) -> Window:
        """As rays see it."""
        return DomePort(self.radius_m, self.thickness_m, self.offset_m, self.index)


class CameraTable(SensorTable, kw_only=True, frozen=True):
    """A camera that looks along its x axis, with y to the right of the picture and z down.

    Attributes:
        latency_s: from the end of the read-out to the delivery, for compression and transport as a USB camera has them. In real time a picture
            that is not computed by then is lost.
        mode: colours, grey, distance along the axis in mm (uint16, 0 for nothing), or ids of objects (uint16, 0 for none).
        ideal: without noise, and of constant exposure.
        width, height: of the picture, pixels.
        field_of_view_deg: horizontal, of the lens behind its port; where `focal_px` is given it is not used.
        focal_px: focal lengths of a calibration, x and y.
        centre_px: its principal point; default: the middle of the picture.
        lens: how it maps angles: pinhole, brown_conrady (k1 k2 p1 p2 k3) or fisheye (Kannala-Brandt, k1 to k4).
        distortion: coefficients, in the order of OpenCV and ROS.
        port: the window before the lens; default: none, as calibrations in water have it.
        exposure_s: at the start; changed by the service `set`, or by itself.
        auto_exposure: whether exposure and gain follow the light, within a second or so.
        max_exposure_s: default: nine tenths of the time between two pictures.
        gain_db: at the start.
        max_gain_db: of auto-exposure.
        read_out_s: from the first row of pixels to the last.
        rolling_shutter: each row is exposed as it is read; otherwise all at once.
        pixel_um: side of a pixel.
        f_number: of the lens.
        quantum_efficiency: of red, green and blue, with lens and filters.
        full_well_e, read_noise_e: electrons.
        dark_current_eps: electrons/s.
        white_balance: factors of red, green and blue.
        snow_pm3: flakes of marine snow in a cubic metre.
        lamp_shadows: whether lamps throw shadows, which costs a second cast for each.
        baseline_m: makes it the left one of a stereo pair; the right one, so far along y, has the port ``<camera>/right``.
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
    port: FlatTable | DomeTable | UnsetType = UNSET
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
        """ValueError where keys do not go together."""
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
        """The lens."""
        if isinstance(self.focal_px, UnsetType):
            lens = lens_of((self.width, self.height), rad(self.field_of_view_deg), self.lens, self.distortion)
        else:
            middle = 0.5 * (self.width - 1), 0.5 * (self.height - 1)
            lens = Lens(self.width, self.height, *self.focal_px, *middle, self.lens, padded(self.lens, self.distortion))
        return (
            lens if isinstance(self.centre_px, UnsetType) else lens._replace(cx=self.centre_px[0], cy=self.centre_px[1])
        )

    def window(self) -> Window:
        """The port; ValueError where it lets no light to the corners."""
        window = None if isinstance(self.port, UnsetType) else self.port.window()
        if window is not None:
            u, v = np.meshgrid(np.linspace(0, self.width - 1, 9), np.linspace(0, self.height - 1, 9))
            outside(window, self.optics().directions(u.ravel(), v.ravel()))
        return window

    @property
    def longest_s(self) -> float:
        """Of an exposure."""
        return 0.9 / self.rate_hz if isinstance(self.max_exposure_s, UnsetType) else self.max_exposure_s

    @property
    def cores(self) -> float:
        """About what part of a core its pictures take."""
        return self.computing_s * self.rate_hz

    @property
    def given_s(self) -> float:
        """From the middle of an exposure, as it starts, to the delivery of its picture, s."""
        exposed = 0.0 if self.mode in ("depth", "segmentation") else 0.5 * self.exposure_s
        return exposed + self.read_out_s + (self.latency_s or 0.0)

    @property
    def computing_s(self) -> float:
        """About the processor time (s) of a picture, or of both of a pair, on a 2.5 GHz core by day (`uwserver bench sensors`).

        Two lamps add a third as much.
        """
        of_each = {"rgb": 230.0, "mono": 225.0, "depth": 125.0, "segmentation": 320.0}[self.mode]
        both = 1.0 if isinstance(self.baseline_m, UnsetType) else 2.0
        return both * of_each * 1e-9 * self.width * self.height

    @property
    def piece_s(self) -> float:
        """About the longest of the pieces in which they are computed, s."""
        return min(max(6e-3, 25e-9 * self.width * self.height), self.computing_s)

    def beside(self, mount: Pose) -> Pose:
        """Where the right camera of a pair sits."""
        x, y, z = rotate(mount.q, (0.0, self.baseline_m or 0.0, 0.0))
        return Pose((mount.p[0] + x, mount.p[1] + y, mount.p[2] + z), mount.q)


def gain_of(gain_db: float) -> float:
    """As a factor."""
    return math.pow(10.0, gain_db / 20.0)
