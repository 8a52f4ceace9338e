"""Draws what a sensor sent: sonar images, beams, and values over time. Needs matplotlib (extra `plot`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uwserver.adapter.pictures import amplitudes
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Buffer, Field, Port, Sample
from uwserver.units import NANOSECONDS

_RANGE_DB = 80.0
"""Range of levels below the largest that is drawn, for echoes that are pressures."""
_WIDE = 6
"""Components of a field above which it is drawn as an image over time."""
_STEP_RAD = 0.0157
"""Width of a single beam whose neighbours are not known."""


def picture(port: Port, samples: Sequence[Sample]) -> Figure:
    """Draw the samples of a sensor in the way that suits the standard message of its port; others over time.

    Args:
        port: the port of the sensor.
        samples: its samples in order; at least one.

    Raises:
        ValueError: there is nothing to draw.
    """
    if not samples:
        raise ValueError(f'"{port.path}" gave no samples in that time')
    figure = _PICTURES.get(port.message or "", _over_time)(port, samples)
    figure.suptitle(port.path, fontsize=10)
    return figure


def _panels(width: float, height: float, rows: int = 1) -> tuple[Figure, list[Any]]:
    """Return a figure of a size in inches, and its plots: one above the other, with one x axis."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])


def _fan(width: float, height: float, reach: float, title: str) -> tuple[Figure, Any]:
    """Return a figure of a size in inches, and its polar plot up to a range in m: x of the sensor is up, y to the right."""
    figure = Figure(figsize=(width, height), layout="constrained")
    axis: Any = figure.add_subplot(projection="polar", theta_offset=0.5 * math.pi, theta_direction=-1)
    axis.set_ylim(0.0, reach)
    axis.set_title(f"{title}, x of the sensor up", fontsize=8)
    axis.tick_params(labelsize=7)
    return figure, axis


def _scanning_sonar(port: Port, samples: Sequence[Sample]) -> Figure:
    """Draw the last full image: the newest ping at each head angle."""
    angles, ranges = (_column(port, samples, name)[:, 0] for name in ("head_angle", "range"))
    bins = _rows(port, samples, "bins") if _field(port, "bins").is_packed else _column(port, samples, "bins")
    heard = np.flatnonzero(np.isfinite(bins).any(axis=1)).tolist()
    newest: dict[float, int] = {round(float(angles[k]), 6): k for k in heard}
    if not newest:
        raise ValueError(f'"{port.path}" had no picture: is it under water?')
    # Pings at another range setting do not fit into the image of the newest one.
    reach = float(ranges[max(newest.values())])
    kept = np.array([k for k in newest.values() if ranges[k] == reach])
    kept = kept[np.argsort(angles[kept])]
    theta, image = angles[kept], bins[kept]
    figure, axis = _fan(6.0, 5.6, reach, f"echoes to {reach:g} m, {len(kept)} pings")
    step = float(np.median(np.diff(theta))) if len(theta) > 1 else _STEP_RAD
    distance = np.linspace(0.0, reach, image.shape[1] + 1)
    levels = {"vmin": np.nanmin(image), "vmax": np.nanmax(image)}
    for first, last in _runs(theta, step):
        edges = np.append(theta[first:last] - step / 2.0, theta[last - 1] + step / 2.0)
        axis.pcolormesh(edges, distance, image[first:last].T, cmap="inferno", **levels)
    axis.grid(alpha=0.3)
    return figure


def _multibeam(port: Port, samples: Sequence[Sample]) -> Figure:
    """Draw the last image as a fan."""
    newest = next((sample for sample in reversed(samples) if isinstance(_value(port, sample, "image"), Buffer)), None)
    if newest is None:
        raise ValueError(f'"{port.path}" made no picture in that time')
    near, far = (float(_value(port, newest, name)) for name in ("range_start", "range"))
    theta = _value(port, newest, "azimuth").array().astype(float)
    unit = _field(port, "image").unit
    image = _levels(amplitudes(_value(port, newest, "image"), 2), unit)
    figure, axis = _fan(6.4, 5.2, far, f"echoes to {far:g} m at {newest.t_ns / NANOSECONDS:g} s")
    step = float(np.median(np.diff(theta))) or _STEP_RAD
    edges = np.append(theta - step / 2.0, theta[-1] + step / 2.0)
    drawn = axis.pcolormesh(edges, np.linspace(near, far, len(image) + 1), image, cmap="inferno")
    axis.set_thetalim(edges[0], edges[-1])
    axis.grid(alpha=0.3)
    figure.colorbar(drawn, ax=axis, label=_unit_of_levels(unit), shrink=0.7)
    return figure


def _side_scan(port: Port, samples: Sequence[Sample]) -> Figure:
    """Draw both sides of each ping along the track, the newest ping at the top."""
    sides = [_rows(port, samples, name) for name in ("port", "starboard")]
    reach = _column(port, samples, "range")[:, 0]
    heard = np.isfinite(sides[0]).any(axis=1) & np.isfinite(sides[1]).any(axis=1)
    if not heard.any():
        raise ValueError(f'"{port.path}" had no picture: is it under water?')
    far, unit = float(reach[heard][-1]), _field(port, "port").unit
    kept = heard & (reach == far)
    image = _levels(np.hstack([sides[0][kept, ::-1], sides[1][kept]]), unit)
    t = _times(samples)[kept]
    figure, (axis,) = _panels(7.0, 5.2)
    extent = (-far, far, float(t[0]), float(t[-1]) if len(t) > 1 else float(t[0]) + 1.0)
    drawn = axis.imshow(image, cmap="copper", aspect="auto", origin="lower", extent=extent, interpolation="nearest")
    axis.set(xlabel="slant range, m: port, starboard", ylabel="time, s")
    figure.colorbar(drawn, ax=axis, label=_unit_of_levels(unit))
    axis.set_title(f"{len(t)} pings", fontsize=8)
    return figure


def _bathymetry(port: Port, samples: Sequence[Sample]) -> Figure:
    """Draw the soundings as the sensor sees them, down over starboard, coloured by quality."""
    names = "angle", "range", "quality"
    pings = [[_value(port, sample, name) for name in names] for sample in samples]
    heard = [[v.array() for v in ping] for ping in pings if all(isinstance(v, Buffer) for v in ping)]
    if not heard:
        raise ValueError(f'"{port.path}" had no soundings: is it under water?')
    angle, distance, quality = (np.concatenate(rows) for rows in zip(*heard, strict=True))
    figure, (axis,) = _panels(7.0, 4.2)
    drawn = axis.scatter(
        distance * np.sin(angle), distance * np.cos(angle), c=quality, s=2, cmap="viridis", vmin=0.0, vmax=1.0
    )
    axis.invert_yaxis()
    axis.set(xlabel="to starboard, m", ylabel="down, m")
    axis.grid(alpha=0.3)
    figure.colorbar(drawn, ax=axis, label="quality")
    axis.set_title(f"soundings of {len(heard)} pings, in axes of the sensor", fontsize=8)
    return figure


def _rows(port: Port, samples: Sequence[Sample], name: str) -> FloatArray:
    """Return (n, k) echoes from a field of buffers, with NaN where there is none."""
    found = [_value(port, sample, name) for sample in samples]
    width = max((value.shape[0] for value in found if isinstance(value, Buffer) and value.shape), default=1)
    rows = np.full((len(found), width), math.nan)
    for row, value in zip(rows, found, strict=True):
        if isinstance(value, Buffer):
            heard = amplitudes(value)
            row[: len(heard)] = heard
    return rows


def _levels(echoes: Any, unit: str) -> FloatArray:
    """Return counts as they are, and pressures (Pa), which span many powers of ten, as levels in dB."""
    numbers: FloatArray = np.asarray(echoes, float)
    if unit == "Pa":
        largest = max(float(np.nanmax(numbers)), 1e-30)
        numbers = 20.0 * np.log10(np.maximum(numbers, largest * 10.0 ** (-0.05 * _RANGE_DB)) * 1e6)
    return numbers


def _unit_of_levels(unit: str) -> str:
    return "dB re 1 uPa" if unit == "Pa" else "counts"


def _runs(theta: FloatArray, step: float) -> Iterable[tuple[int, int]]:
    """Return the first index and the last index + 1 of each run of angles without a gap."""
    breaks = [0, *(np.flatnonzero(np.diff(theta) > 1.5 * step) + 1).tolist(), len(theta)]
    return [(a, b) for a, b in pairwise(breaks) if b > a]


def _dvl(port: Port, samples: Sequence[Sample]) -> Figure:
    """Draw the velocities over ground and through the water, and the range and velocity of each beam."""
    t = _times(samples)
    figure, panels = _panels(7.0, 5.2, 3)
    top, middle, bottom = panels
    for name, style in (("v_S", "-"), ("v_water_S", ":")):
        for value, part in zip(_column(port, samples, name).T, "xyz", strict=True):
            top.plot(t, value, style, lw=1.0, label=f"{name}.{part}")
    ranges, speeds = _column(port, samples, "beam_ranges"), _column(port, samples, "beam_velocities")
    for k in range(ranges.shape[1]):
        middle.plot(t, ranges[:, k], ".-", ms=2, lw=0.8, label=f"beam {k + 1}")
        bottom.plot(t, speeds[:, k], ".-", ms=2, lw=0.8)
    middle.plot(t, _column(port, samples, "altitude")[:, 0], "k--", lw=0.8, label="altitude")
    middle.invert_yaxis()
    for axis, label in zip(panels, ("m/s", "beam range, m", "beam velocity, m/s"), strict=True):
        axis.set_ylabel(label)
        _shade(axis, t, samples)
        axis.grid(alpha=0.3)
    bottom.set_xlabel("time, s")
    top.legend(fontsize=7, ncols=6)
    middle.legend(fontsize=7, ncols=5)
    return figure


def _adcp(port: Port, samples: Sequence[Sample]) -> Figure:
    """Draw the velocities of the water by cell and time, over ground if they are known. A single sample is drawn as a profile."""
    t, cells = _times(samples), _field(port, "distances").size
    ground = np.isfinite(_column(port, samples, "velocities_N")).any()
    name, parts = ("velocities_N", ("north", "east", "down")) if ground else ("velocities_S", ("x", "y", "z"))
    velocities = _column(port, samples, name).reshape(-1, cells, 3)
    if len(t) == 1:
        figure, (axis,) = _panels(5.0, 5.2)
        for k, part in enumerate(parts):
            axis.plot(velocities[0, :, k], _column(port, samples, "distances")[0], ".-", ms=3, lw=0.8, label=part)
        axis.set(xlabel=f"{name}, m/s", ylabel="distance, m")
        axis.invert_yaxis()
        axis.legend(fontsize=7)
        axis.grid(alpha=0.3)
        return figure
    figure, panels = _panels(7.0, 5.6, 3)
    for k, (axis, part) in enumerate(zip(panels, parts, strict=True)):
        image = axis.pcolormesh(t, np.arange(1, cells + 1), velocities[:, :, k].T, cmap="viridis", shading="nearest")
        axis.invert_yaxis()
        axis.set_ylabel(f"{part}, cell", fontsize=8)
        figure.colorbar(image, ax=axis, label="m/s")
    panels[0].set_title(name, fontsize=8)
    panels[-1].set_xlabel("time, s")
    return figure


def _beacons(port: Port, samples: Sequence[Sample]) -> Figure:
    """Draw the ranges of each beacon over time, and for a USBL also the directions."""
    t, names = _times(samples), np.array([str(_value(port, sample, "beacon")) for sample in samples])
    drawn = [field for field in port.fields if field.name in ("range", "bearing", "elevation")]
    figure, panels = _panels(7.0, 1.4 + 1.4 * len(drawn), len(drawn))
    for axis, field in zip(panels, drawn, strict=True):
        values = _column(port, samples, field.name)[:, 0]
        for beacon in dict.fromkeys(names.tolist()):
            own = names == beacon
            axis.plot(t[own], values[own], ".", ms=4, label=beacon)
        axis.set_ylabel(f"{field.name}, {field.unit}", fontsize=8)
        axis.grid(alpha=0.3)
    panels[0].legend(fontsize=7)
    panels[-1].set_xlabel("time, s")
    return figure


def _camera(port: Port, samples: Sequence[Sample]) -> Figure:
    """Draw the last picture; depths and object numbers get false colours."""
    newest = next((sample.value[0] for sample in reversed(samples) if isinstance(sample.value[0], Buffer)), None)
    if newest is None:
        raise ValueError(f'"{port.path}" made no picture in that time')
    image = newest.array()
    figure, (axis,) = _panels(6.4, 4.8)
    shown = axis.imshow(image, cmap="gray" if image.dtype == np.uint8 else "viridis", interpolation="nearest")
    if image.ndim == 2 and image.dtype != np.uint8:
        figure.colorbar(shown, label=port.fields[0].unit)
    axis.set_axis_off()
    return figure


def _over_time(port: Port, samples: Sequence[Sample]) -> Figure:
    """Draw every number over time, with a panel for each field; long arrays become images."""
    numbers = [f for f in port.fields if f.type != "str" and not f.is_packed]
    drawn = [f for f in numbers if np.isfinite(_column(port, samples, f.name)).any()]
    if not drawn:
        raise ValueError(f'"{port.path}" gave no numbers: it was never valid')
    t = _times(samples)
    figure, panels = _panels(7.0, 0.8 + 1.15 * len(drawn), len(drawn))
    for axis, field in zip(panels, drawn, strict=True):
        values = _column(port, samples, field.name)
        if values.shape[1] > _WIDE and len(t) > 1:
            axis.pcolormesh(t, np.arange(values.shape[1]), values.T, cmap="viridis", shading="nearest")
        else:
            style = {"drawstyle": "steps-post"} if field.type in ("bool", "int") else {}
            for k, column in enumerate(values.T):
                axis.plot(t, column, ".-" if len(t) < 200 else "-", ms=2, lw=0.9, label=field.part(k), **style)
            if field.size > 1:
                axis.legend(fontsize=6, ncols=field.size, loc="upper right")
        unit = "" if field.unit == "1" else f"\n{field.unit}"
        axis.set_ylabel(f"{field.name}{unit}", fontsize=7)
        axis.tick_params(labelsize=7)
        axis.grid(alpha=0.3)
        _shade(axis, t, samples)
    panels[-1].set_xlabel("time, s", fontsize=8)
    return figure


_PICTURES: Mapping[str, Callable[[Port, Sequence[Sample]], Figure]] = {
    "Bathymetry": _bathymetry,
    "Image": _camera,
    "SonarImage": _multibeam,
    "SonarPing": _scanning_sonar,
    "SideScan": _side_scan,
    "Dvl": _dvl,
    "CurrentProfile": _adcp,
    "BeaconFix": _beacons,
    "BeaconRange": _beacons,
}


def _shade(axis: Any, t: FloatArray, samples: Sequence[Sample]) -> None:
    """Draw grey where the samples are not valid."""
    invalid = np.array([not sample.valid for sample in samples])
    if invalid.any():
        whole_height = axis.get_xaxis_transform()
        axis.fill_between(t, 0.0, 1.0, where=invalid, color="0.85", transform=whole_height, step="mid", lw=0)


def _times(samples: Sequence[Sample]) -> FloatArray:
    return np.array([sample.t_ns / NANOSECONDS for sample in samples])


def _field(port: Port, name: str) -> Field:
    return next(field for field in port.fields if field.name == name)


def _value(port: Port, sample: Sample, name: str) -> Any:
    return sample.value[port.fields.index(_field(port, name))]


def _column(port: Port, samples: Sequence[Sample], name: str) -> FloatArray:
    """Return (n, size) numbers of a field, with NaN where there is no value."""
    size = _field(port, name).size
    rows = [_value(port, sample, name) for sample in samples]
    tuples = [row if isinstance(row, (tuple, list)) else (row,) * size if row is None else (row,) for row in rows]
    return np.array([[math.nan if v is None else float(v) for v in row] for row in tuples])
