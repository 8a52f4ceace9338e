"""Faults of a hull: mass that drops off, and volume that floods or fills. All changes add up, in any order."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from msgspec import UnsetType

from uwserver.frames import Vec3
from uwserver.physics.dynamics.params import BodyParams, rigid_body_inertia
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.world.faults.table import BuoyancyChange, MassLoss

HullFault = BuoyancyChange | MassLoss


class Hull(NamedTuple):
    """A hull without faults, and the weight of the water around it.

    Attributes:
        M_RB: (6, 6) about the origin.
        r_g: centre of mass in B, m.
        volume: displaced volume when fully submerged, m3.
        water: weight of the water, N/m3.
    """

    M_RB: FloatArray
    r_g: Vec3
    volume: float
    water: float


def left_inertia(hull: Hull, faults: Iterable[HullFault]) -> FloatArray:
    """Return M_RB (6, 6) of the mass that is left. It may not be positive definite."""
    M_RB = hull.M_RB.copy()
    for fault in faults:
        if isinstance(fault, MassLoss):
            M_RB -= rigid_body_inertia(fault.mass_kg, np.zeros((3, 3)), _place(hull, fault))
    return M_RB


def left_volume(hull: Hull, faults: Iterable[HullFault]) -> float:
    """Return the volume (m3) with all changes. It may be negative."""
    volume = hull.volume
    for fault in faults:
        if not isinstance(fault, BuoyancyChange):
            continue
        if not isinstance(fault.volume_m3, UnsetType):
            volume += fault.volume_m3
        elif not isinstance(fault.fraction, UnsetType):
            volume += fault.fraction * hull.volume
        elif not isinstance(fault.force_N, UnsetType):
            volume += fault.force_N / hull.water
    return volume


def damaged(body: BodyParams, hull: Hull, faults: Iterable[HullFault], density: float, gravity: float) -> BodyParams:
    """Return the body with its faults. A negative volume counts as zero; it can occur after a fault has ended that had made room for
    another one.

    Args:
        body, hull: without faults.
        faults: the active ones.
        density, gravity: of the water (kg/m3), and m/s2.
    """
    faults = list(faults)
    lost = [fault for fault in faults if isinstance(fault, MassLoss)]
    volume = max(0.0, left_volume(hull, faults))
    mass = float(hull.M_RB[0, 0])
    left = mass - sum(fault.mass_kg for fault in lost)
    moments = [mass * r - sum(f.mass_kg * _place(hull, f)[i] for f in lost) for i, r in enumerate(hull.r_g)]
    return replace(
        body,
        M_RB=left_inertia(hull, lost),
        weight=body.weight - gravity * (mass - left),
        r_g=(moments[0] / left, moments[1] / left, moments[2] / left) if lost else body.r_g,
        buoyancy=body.buoyancy + hull.water * (volume - hull.volume),
        displaced=density * volume,
    )


def _place(hull: Hull, fault: MassLoss) -> Vec3:
    return hull.r_g if isinstance(fault.position_frd_m, UnsetType) else fault.position_frd_m
