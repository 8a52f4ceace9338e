"""What can fail in a world, why a fault is not possible, and what faults do to a hull: mass drops off, and volume floods or fills."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np
from msgspec import UNSET, UnsetType

from uwserver.frames import Vec3
from uwserver.physics.dynamics.params import BodyParams, rigid_body_inertia
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports.checks import shown
from uwserver.world.faults.table import (
    BuoyancyChange,
    FaultConfig,
    FaultTable,
    MassLoss,
    SensorFrozen,
    SensorSilent,
    ThrusterTable,
)

HullFault = BuoyancyChange | MassLoss
MAX_VOLUME = 10
"""Largest volume of a hull as a multiple of its own. A larger one would shoot out of the sea and end the run for all clients."""


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
        density, gravity: those of the water (kg/m3), and m/s2.
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


class Targets(NamedTuple):
    """What can fail.

    Attributes:
        hulls: by vehicle.
        thrusters: names of the thrusters by path of their actuator.
        sensors: paths.
    """

    hulls: Mapping[str, Hull]
    thrusters: Mapping[str, tuple[str, ...]]
    sensors: tuple[str, ...]


def effects(name: str, fault: FaultTable, targets: Targets, rng: np.random.Generator) -> dict[str, FaultConfig]:
    """Return the faults to carry out, by name: the fault itself, or those that a kind of an extension builds, named `name/1` and so on.

    Raises:
        ValueError: `build` of the kind returns something else. Other errors of `build` pass through.
    """
    kinds: tuple[type[FaultConfig], ...] = get_args(FaultConfig)
    if isinstance(fault, kinds):
        return {name: fault}
    built: object = fault.build(targets, rng)  # type: ignore[attr-defined]  # every kind of an extension has it
    if not isinstance(built, tuple | list) or not built or not all(isinstance(each, kinds) for each in built):
        raise ValueError(f"build() must give a tuple of faults of shipped kinds, not {built!r}")
    return {f"{name}/{k}": each for k, each in enumerate(built, 1)}


def refusals(fault: FaultConfig, targets: Targets, others: Iterable[FaultConfig] = ()) -> Iterator[tuple[str, str]]:
    """Yield the key and a text for each reason why this fault is not possible beside the others."""
    if not isinstance(fault.until_s, UnsetType) and fault.until_s <= fault.at_s:
        yield "until_s", f"{fault.until_s:g} s is not after its begin at {fault.at_s:g} s"
    noun, there = "vehicle", tuple(targets.hulls)
    if isinstance(fault, ThrusterTable):
        noun, there = "actuator of thrusters", tuple(targets.thrusters)
    elif isinstance(fault, SensorFrozen | SensorSilent):
        noun, there = "sensor", targets.sensors
    if fault.target not in there:
        yield "target", f'no {noun} "{shown(fault.target)}", there are: {", ".join(there) or "none"}'
    elif isinstance(fault, ThrusterTable):
        members = targets.thrusters[fault.target]
        for name in () if isinstance(fault.members, UnsetType) else fault.members:
            if name not in members:
                yield "members", f'no thruster "{shown(name)}" in "{fault.target}", there are: {", ".join(members)}'
    elif isinstance(fault, HullFault):
        same = [other for other in others if isinstance(other, HullFault) and other.target == fault.target]
        yield from _hull_refusals(fault, targets.hulls[fault.target], [*same, fault])


def _hull_refusals(fault: HullFault, hull: Hull, faults: list[HullFault]) -> Iterator[tuple[str, str]]:
    if isinstance(fault, BuoyancyChange):
        if not isinstance(fault.force_N, UnsetType) and hull.water == 0.0:
            yield "force_N", "there is no buoyancy without gravity: give fraction or volume_m3"
            return
        key = next(key for key in ("force_N", "fraction", "volume_m3") if getattr(fault, key) is not UNSET)
        volume = left_volume(hull, faults)
        if volume < 0.0:
            yield key, f"it takes away more than the {hull.volume:g} m3 that the hull has"
        elif volume > MAX_VOLUME * hull.volume:
            yield key, f"{volume:g} m3 would be more than {MAX_VOLUME} times the {hull.volume:g} m3 of the hull"
    elif np.linalg.eigvalsh(left_inertia(hull, faults))[0] <= 0.0:
        yield "mass_kg", f"it leaves no mass or no moment of inertia of the {hull.M_RB[0, 0]:g} kg"
