"""What can fail in a world, and why a fault is not possible."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, get_args

import numpy as np
from msgspec import UNSET, UnsetType

from uwserver.ports.checks import shown
from uwserver.world.faults.hull import Hull, HullFault, left_inertia, left_volume
from uwserver.world.faults.table import (
    BuoyancyChange,
    FaultConfig,
    FaultTable,
    SensorFrozen,
    SensorSilent,
    ThrusterTable,
)

MAX_VOLUME = 10
"""Largest volume of a hull as a multiple of its own. A larger one would shoot out of the sea and end the run for all clients."""


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
