"""Draws a vehicle from its file in three views: shapes, propulsors, fins, and the centres of gravity and buoyancy. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from uwserver.physics.dynamics.appendage_params import FoilParams
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.geometry.shapes import Box, Placed, Solid, Sphere
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import SHAPE_BOX
from uwserver.scenario.load.resolved import ResolvedVehicle
from uwserver.validation.manoeuvres.particulars import outline

_VIEWS = (("from above", 0, 1), ("from starboard", 0, 2), ("from behind", 1, 2))
"""Title of each view, and the axes of B that point to the right and down in it."""
_AXES = ("x, m", "y, m", "z, m")
_HULL, _FLOAT, _THRUST, _FIN = "0.85", "tab:blue", "tab:red", "tab:green"
_ARROW = 0.16
"""Length of an arrow relative to the size of the vehicle."""
_NAME_PT = 10
"""Font size of names: they must be readable where a page shows the picture at half its width."""


def vehicle_picture(resolved: ResolvedVehicle, body: BodyParams) -> Figure:
    """Draw three views of a checked vehicle. Arrows show in which direction a propulsor pushes the vehicle at a positive command."""
    hull = outline(resolved.solid) if resolved.solid is not None else []
    floats = outline(_buoyancy(body))
    parts = [*hull, *floats, *(np.array([t.r]) for t in body.thrusters), *(_plate(f) for f in body.appendages.foils)]
    size = float(np.ptp(np.concatenate([*parts, np.zeros((1, 3))]), axis=0).max()) or 1.0
    widths = [float(np.ptp(np.concatenate(parts)[:, a])) + 0.5 * size for _, a, _ in _VIEWS]
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=widths)
    for axis, (title, right, down) in zip(axes, _VIEWS, strict=True):
        for points in hull:
            axis.fill(*_hull(points, right, down), facecolor=_HULL, edgecolor="0.5", lw=0.8, zorder=1)
        for points in floats:
            axis.fill(*_hull(points, right, down), fill=False, edgecolor=_FLOAT, lw=0.8, ls=":", zorder=2)
        _draw_foils(axis, body, right, down)
        _draw_propulsors(axis, body, right, down, _ARROW * size)
        axis.plot(body.r_g[right], body.r_g[down], "k+", ms=9, mew=1.6, zorder=6, label="centre of gravity")
        axis.plot(
            body.r_b[right], body.r_b[down], "o", ms=7, mfc="none", mec=_FLOAT, mew=1.4, zorder=6, label="centre of buoyancy"
        )  # fmt: skip
        axis.set(xlabel=_AXES[right], ylabel=_AXES[down], title=title, aspect="equal", adjustable="datalim")
        axis.invert_yaxis()
        axis.margins(0.18)
        axis.grid(visible=True, alpha=0.25)
        axis.tick_params(labelsize=7)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    figure.suptitle(
        f"{resolved.vehicle.name}: collision shapes grey, buoyancy dotted, thrust red, fins green", fontsize=9
    )
    return figure


def _buoyancy(body: BodyParams) -> Solid:
    """Return the shapes of the displaced volume, for drawing."""
    return Solid("buoyancy", tuple(
        Placed(Box(shape.half) if shape.kind == SHAPE_BOX else Sphere(shape.half[0]), shape.center) for shape in body.shapes
    ))  # fmt: skip


def _hull(points: FloatArray, right: int, down: int) -> tuple[FloatArray, FloatArray]:
    """Return the corners, in order, of the convex hull of points (n, 3) in a view: the points that lie farthest in some direction."""
    flat = points[:, [right, down]]
    angle = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    corners = flat[np.argmax(flat @ np.stack([np.cos(angle), np.sin(angle)]), axis=0)]
    return corners[:, 0], corners[:, 1]


def _plate(foil: FoilParams) -> FloatArray:
    """Return the (4, 3) corners of a plate with a foil's span and area, in B, m. The area follows from rho A / 2 in sea water."""
    hinge, chord = (np.array(v) / np.linalg.norm(v) for v in (foil.hinge, foil.chord))
    depth = foil.pressure_area / 1025.0 / max(foil.radius, 1e-6)
    signs = ((1, 1), (1, -1), (-1, -1), (-1, 1))
    return np.array([np.array(foil.r) + a * foil.radius * hinge + b * 0.5 * depth * chord for a, b in signs])


def _draw_foils(axis: Any, body: BodyParams, right: int, down: int) -> None:
    for foil in body.appendages.foils:
        style = {"facecolor": _FIN, "alpha": 0.6} if foil.servo else {"fill": False, "ls": "--"}
        axis.fill(*_hull(_plate(foil), right, down), edgecolor=_FIN, lw=1.4, zorder=3, **style)
    fins = [(foil.servo, np.array(foil.r)) for foil in body.appendages.foils if foil.servo]
    _name(axis, fins, right, down, _FIN)


def _draw_propulsors(axis: Any, body: BodyParams, right: int, down: int, length: float) -> None:
    discs = [(t.name, np.array(t.r), t.axis, t.disc_radius) for t in body.thrusters]
    discs += [(p.servo, np.array(p.r), p.axis, 0.5 * p.diameter) for p in body.appendages.propellers]
    for _, r, pushes, radius in discs:
        unit = np.array(pushes) / np.linalg.norm(pushes)
        axis.fill(*_hull(r + radius * _circle(unit), right, down), fill=False, edgecolor=_THRUST, lw=1.2, zorder=4)
        seen = length * unit[[right, down]]
        if float(np.hypot(*seen)) > 0.1 * length:
            axis.annotate(
                "", xy=(r[right] + seen[0], r[down] + seen[1]), xytext=(r[right], r[down]), zorder=5,
                arrowprops={"arrowstyle": "->", "color": _THRUST, "lw": 1.4},
            )  # fmt: skip
    _name(axis, [(name, r) for name, r, _, _ in discs], right, down, _THRUST)


def _circle(unit: FloatArray) -> FloatArray:
    """Return (n, 3) points of the circle of radius 1 about a unit vector."""
    side = np.cross(unit, [1.0, 0.0, 0.0] if abs(unit[0]) < 0.9 else [0.0, 1.0, 0.0])
    side = side / np.linalg.norm(side)
    angle = np.linspace(0.0, 2.0 * np.pi, 48)[:, None]
    circle: FloatArray = np.cos(angle) * side + np.sin(angle) * np.cross(unit, side)
    return circle


def _name(axis: Any, places: Sequence[tuple[str, FloatArray]], right: int, down: int, colour: str) -> None:
    """Write names beside places in B. Names of places that coincide in a view share a line."""
    names: dict[tuple[float, float], list[str]] = {}
    for name, r in places:
        place = round(float(r[right]), 2), round(float(r[down]), 2)
        names.setdefault(place, []).append(name.partition(".")[2] or name)
    middle = np.mean(list(names) or [(0.0, 0.0)], axis=0)
    for place, together in names.items():
        # Outwards, where arrows and other names are fewer.
        side, below = (1 if place[i] >= middle[i] else -1 for i in (0, 1))
        axis.annotate(
            ", ".join(together), place, textcoords="offset points", xytext=(9 * side, -9 * below), fontsize=_NAME_PT, color=colour,
            ha="left" if side > 0 else "right", va="top" if below > 0 else "bottom", weight="bold", zorder=7,
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
        )  # fmt: skip
