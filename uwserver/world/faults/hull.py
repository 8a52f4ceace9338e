"""What faults make of a hull: mass that drops off, volume that floods or fills. All changes add up, whatever their order."""

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
        volume: displaced fully submerged, m3.
        water: weight of the water, N/m3.
    """

    M_RB: FloatArray
    r_g: Vec3
    volume: float
    water: float


def left_inertia(hull: Hull, faults: Iterable[HullFault]) -> FloatArray:
    """M_RB (6, 6) of what is left; it may be no longer positive definite."""
    M_RB = hull.M_RB.copy()
    for fault in faults:
        if isinstance(fault, MassLoss):
            M_RB -= rigid_body_inertia(fault.mass_kg, np.zeros((3, 3)), _place(hull, fault))
    return M_RB


def left_volume(hull: Hull, faults: Iterable[HullFault]) -> float:
    """Volume (m3) with all changes; it may be negative."""
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
    """The body with faults; a volume below nothing is nothing (when the fault that made room for it has ended).

    Args:
        body, hull: without faults.
        faults: that act.
        density, gravity: of the water, kg/m3, and m/s2.
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
