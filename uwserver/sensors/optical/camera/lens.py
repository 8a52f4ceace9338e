"""Lenses and the ports of camera housings: from pixels to directions in the air behind the port and back, and to rays in the water.

Directions are in S, the frame of the sensor: x along the optical axis, y to the right of the picture, z down. Pixel coordinates begin at the middle
of the first pixel: u to the right, v down. Models and the order of their coefficients are those of OpenCV and ROS: Brown-Conrady k1 k2 p1 p2 k3
(D. C. Brown, Close-range camera calibration, Photogrammetric Engineering 37 (1971) 855), and Kannala-Brandt k1 to k4 (A generic camera model
and calibration method, IEEE PAMI 28 (2006) 1335), which OpenCV calls fisheye and ROS equidistant.

A port is the window of a housing. A ray is followed from the entrance pupil, the origin of S, out of the housing. A flat port bends rays so that
they do not meet in one point (T. Treibitz et al., Flat refractive geometry, IEEE PAMI 34 (2012) 51), so each pixel has an origin as well as a
direction. A dome bends nothing if its centre is the pupil.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.table import Table

Model = Literal["pinhole", "brown_conrady", "fisheye"]
STEPS = 20
"""Steps of the fixed-point iteration, after which the error of a corner at 80 degrees is below 1e-6 px."""
_NEWTON = 20
_EDGE = 64
"""Pixels along each edge that `check` tries."""
_FOLDED_PX = 0.01

WATER_INDEX = 1.34
"""Refractive index of sea water in green light (X. Quan and E. S. Fry, Appl. Opt. 34 (1995) 3477: 1.339 to 1.343 at 35, 10 degC)."""
ACRYLIC_INDEX = 1.49


class Lens(NamedTuple):
    """The intrinsic parameters of a camera.

    Attributes:
        width, height: size of the picture, pixels.
        fx, fy: focal lengths, pixels.
        cx, cy: the principal point, pixels.
        model: model of the distortion.
        coefficients: five for brown_conrady (k1 k2 p1 p2 k3), four for fisheye, none for pinhole.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: Model = "pinhole"
    coefficients: tuple[float, ...] = ()

    def directions(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return (n, 3) unit directions in S of pixels (n)."""
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        if self.model == "fisheye":
            return _fisheye_directions(x, y, self.coefficients)
        if self.model == "brown_conrady":
            x, y = _undistorted(x, y, self.coefficients)
        rays: FloatArray = np.stack((np.ones_like(x), x, y), axis=-1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        return rays

    def pixels(self, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return u and v (n) of directions (n, 3) in S; nan for a direction to the back of a lens that is no fisheye."""
        ahead, right, down = direction[..., 0], direction[..., 1], direction[..., 2]
        if self.model == "fisheye":
            across = np.hypot(right, down)
            theta = np.arctan2(across, ahead)
            scale = np.where(
                across > 0.0, _fisheye_radius(theta, self.coefficients) / np.where(across > 0.0, across, 1.0), 1.0
            )
            x, y = right * scale, down * scale
        else:
            ahead = np.where(ahead > 0.0, ahead, np.nan)
            x, y = right / ahead, down / ahead
            if self.model == "brown_conrady":
                radial, dx, dy = _distortion_terms(x, y, self.coefficients)
                x, y = x * radial + dx, y * radial + dy
        return self.fx * x + self.cx, self.fy * y + self.cy

    def table(self) -> FloatArray:
        """Return (height width, 3) directions of all pixels, row after row."""
        u, v = np.meshgrid(np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64))
        return self.directions(u.ravel(), v.ravel())

    def check(self) -> None:
        """Raise ValueError if the distortion folds the picture, so that no direction maps to some pixels."""
        along = np.linspace(0.0, 1.0, _EDGE)
        ends = np.zeros_like(along), np.ones_like(along)
        u = np.concatenate((along, along, *ends)) * (self.width - 1)
        v = np.concatenate((*ends, along, along)) * (self.height - 1)
        with np.errstate(all="ignore"):
            back = self.pixels(self.directions(u, v))
            off = np.hypot(back[0] - u, back[1] - v)
        if not bool((off < _FOLDED_PX).all()):
            raise ValueError(
                "the distortion folds the corners of the picture: no direction maps to those pixels; "
                "check the coefficients, or give a smaller field of view"
            )


def lens_of(
    size: tuple[int, int], field_of_view: float, model: Model = "pinhole", coefficients: tuple[float, ...] = ()
) -> Lens:
    """Return a lens with its axis in the middle of the picture and square pixels.

    Args:
        size: width and height.
        field_of_view: horizontal, between the middles of the outer pixels, rad. Distortion does not count, except that of a fisheye.
        model, coefficients: see `Lens`.
    """
    width, height = size
    half, reach = 0.5 * max(width - 1, 1), 0.5 * field_of_view
    coefficients = padded(model, coefficients)
    if model == "fisheye":
        edge = float(_fisheye_radius(np.array([reach]), coefficients)[0])
        if not edge > 0.0:
            raise ValueError("the distortion folds the picture within the field of view: check the coefficients")
        f = half / edge
    else:
        f = half / math.tan(reach)
    return Lens(width, height, f, f, 0.5 * (width - 1), 0.5 * (height - 1), model, coefficients)


def padded(model: Model, coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """Return coefficients padded with zeros to the number that a model has. Raises ValueError if there are more."""
    wanted = {"pinhole": 0, "brown_conrady": 5, "fisheye": 4}[model]
    if len(coefficients) > wanted:
        raise ValueError(f"{model} has {wanted} coefficients, not {len(coefficients)}")
    return coefficients + (0.0,) * (wanted - len(coefficients))


def _distortion_terms(x: FloatArray, y: FloatArray, k: tuple[float, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    k1, k2, p1, p2, k3 = k
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    return radial, 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x), p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y


def _undistorted(x: FloatArray, y: FloatArray, k: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    ideal_x, ideal_y = x, y
    with np.errstate(all="ignore"):  # `check` finds a lens that folds
        for _ in range(STEPS):
            radial, dx, dy = _distortion_terms(ideal_x, ideal_y, k)
            ideal_x, ideal_y = (x - dx) / radial, (y - dy) / radial
    return ideal_x, ideal_y


def _fisheye_radius(theta: FloatArray, k: tuple[float, ...]) -> FloatArray:
    """Return the radius (in focal lengths) at an angle off the axis."""
    s = theta * theta
    radius: FloatArray = theta * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))
    return radius


def _fisheye_directions(x: FloatArray, y: FloatArray, k: tuple[float, ...]) -> FloatArray:
    radius = np.hypot(x, y)
    theta = radius.copy()
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON):
            s = theta * theta
            slope = 1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3])))
            theta = theta - (_fisheye_radius(theta, k) - radius) / slope
    across = np.where(radius > 0.0, np.sin(theta) / np.where(radius > 0.0, radius, 1.0), 1.0)
    rays: FloatArray = np.stack((np.cos(theta), across * x, across * y), axis=-1)
    return rays


_Index = Annotated[float, Meta(ge=1, le=3)]


class FlatPort(Table, tag="flat", tag_field="kind", kw_only=True, frozen=True):
    """A plane window across the optical axis. The picture shrinks by a third, and more towards its corners.

    Attributes:
        distance_m: distance of its inner face from the entrance pupil.
        thickness_m, index: thickness and refractive index of the window.
    """

    distance_m: Annotated[float, Meta(ge=0, le=1)] = 0.01
    thickness_m: Annotated[float, Meta(ge=0, le=0.5)] = 0.005
    index: _Index = ACRYLIC_INDEX


class DomePort(Table, tag="dome", tag_field="kind", kw_only=True, frozen=True):
    """A spherical window.

    Attributes:
        radius_m: radius of its outer face.
        thickness_m, index: thickness and refractive index of its wall.
        offset_m: distance of its centre ahead of the entrance pupil. With 0 it bends no light.
    """

    radius_m: Annotated[float, Meta(gt=0, le=1)] = 0.05
    thickness_m: Annotated[float, Meta(ge=0, le=0.2)] = 0.003
    offset_m: Annotated[float, Meta(ge=-1, le=1)] = 0.0
    index: _Index = ACRYLIC_INDEX


Window = FlatPort | DomePort | None


class Bundle(NamedTuple):
    """Rays outside the housing, in S: origins (n, 3), m, and unit directions (n, 3)."""

    origin: FloatArray
    direction: FloatArray


def outside(window: Window, direction: FloatArray, water: float = WATER_INDEX) -> Bundle:
    """Return the rays outside the housing.

    Args:
        window: None if the lens is in the water, or if the camera was calibrated in water.
        direction: (n, 3) unit directions inside the housing.
        water: refractive index of the medium outside; 1 for a camera in air.

    Raises:
        ValueError: a ray does not get through.
    """
    if window is None:
        return Bundle(np.zeros_like(direction), direction.copy())
    if isinstance(window, FlatPort):
        if bool((direction[:, 0] <= 1e-3).any()):
            raise ValueError(
                "a flat port lets nothing in from the side: give a field of view below 175 degrees, or a dome"
            )
        axis = np.zeros_like(direction)
        axis[:, 0] = 1.0
        at = direction * (window.distance_m / direction[:, :1])
        inside = bent(direction, axis, 1.0 / window.index)
        at = at + inside * (window.thickness_m / inside[:, :1])
        return Bundle(at, bent(inside, axis, window.index / water))
    inner = window.radius_m - window.thickness_m
    if not abs(window.offset_m) < inner:
        raise ValueError("the pupil lies outside the dome: give a smaller offset or thickness")
    centre = np.array((window.offset_m, 0.0, 0.0))
    at, inside = np.zeros_like(direction), direction
    for radius, ratio in ((inner, 1.0 / window.index), (window.radius_m, window.index / water)):
        at = at + inside * _reach(at - centre, inside, radius)
        inside = bent(inside, (at - centre) / radius, ratio)
    return Bundle(at, inside)


def bent(direction: FloatArray, normal: FloatArray, ratio: float) -> FloatArray:
    """Return unit directions (n, 3) after a face (Snell), whose unit normals (n, 3) point in the direction in which rays are followed.

    Args:
        direction, normal: those of each ray.
        ratio: refractive index before the face over the index after it.
    """
    along = np.einsum("ij,ij->i", direction, normal)[:, None]
    square = 1.0 - ratio * ratio * (1.0 - along * along)
    if bool((square < 0.0).any()):
        raise ValueError("light is totally reflected in the port: give a smaller field of view or offset")
    out: FloatArray = ratio * direction + (np.sqrt(square) - ratio * along) * normal
    return out


def _reach(start: FloatArray, direction: FloatArray, radius: float) -> FloatArray:
    """Return (n, 1) the distance from points inside a sphere about zero to the sphere, along rays."""
    b = np.einsum("ij,ij->i", start, direction)
    c = np.einsum("ij,ij->i", start, start) - radius * radius
    reach: FloatArray = (-b + np.sqrt(b * b - c))[:, None]
    return reach
