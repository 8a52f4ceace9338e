"""The tables by which a scenario or ``world/set_fault`` declares faults."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, Meta, UnsetType

from uwserver.table import Name, Table

Seconds = Annotated[float, Meta(ge=0, le=1e9)]
Metres = Annotated[float, Meta(ge=-1000, le=1000)]
Part = Annotated[float, Meta(ge=0, le=1)]


class FaultTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """The keys that all faults share.

    A kind of an extension has ``build(targets, rng)``, which returns one or more faults of the kinds in this module, each with its own
    target and times. `targets` is what can fail (`Targets`), and `rng` is a random stream of the fault's own; the result depends on nothing
    else. It raises ValueError for a target or keys that are not possible. Each of the returned faults begins, ends and is saved like one of
    the scenario.

    Attributes:
        target: ``<vehicle>/<component>``, or the vehicle for faults of its hull.
        at_s: simulation time at which it begins; it acts from the first tick at or after it.
        until_s: when it ends; default: never.
    """

    target: Name
    at_s: Seconds = 0.0
    until_s: Seconds | UnsetType = UNSET


class ThrusterTable(FaultTable, kw_only=True, frozen=True):
    """A fault of the thrusters of an actuator.

    Attributes:
        members: names of the thrusters; default: all.
    """

    members: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=64)] | UnsetType = UNSET


class ThrusterDead(ThrusterTable, tag="thruster_dead", kw_only=True, frozen=True):
    """The thrusters give no thrust at all."""


class ThrusterWeak(ThrusterTable, tag="thruster_weak", kw_only=True, frozen=True):
    """The thrusters give only the part `factor` of their thrust; several faults multiply."""

    factor: Part


class ThrusterStuck(ThrusterTable, tag="thruster_stuck", kw_only=True, frozen=True):
    """The thrusters ignore commands. When the fault ends, the newest command holds again.

    Attributes:
        u: fraction of full command at which they are stuck; default: the command when the fault begins.
    """

    u: Annotated[float, Meta(ge=-1, le=1)] | UnsetType = UNSET


class SensorFrozen(FaultTable, tag="sensor_frozen", kw_only=True, frozen=True):
    """The sensor repeats its last value; its samples go on in time and number."""


class SensorSilent(FaultTable, tag="sensor_silent", kw_only=True, frozen=True):
    """The sensor gives no samples and counts none."""


class BuoyancyChange(FaultTable, tag="buoyancy_change", kw_only=True, frozen=True):
    """More or less buoyancy, about the same centre. Exactly one key is given, negative for a loss.

    Attributes:
        force_N: added to the buoyancy.
        fraction: added part of the full buoyancy.
        volume_m3: added volume.
    """

    force_N: Annotated[float, Meta(ge=-1e9, le=1e9)] | UnsetType = UNSET
    fraction: Annotated[float, Meta(ge=-1, le=10)] | UnsetType = UNSET
    volume_m3: Annotated[float, Meta(ge=-1e6, le=1e6)] | UnsetType = UNSET

    def __post_init__(self) -> None:
        given = sum(value is not UNSET for value in (self.force_N, self.fraction, self.volume_m3))
        if given != 1:
            raise ValueError(f"give exactly one of force_N, fraction and volume_m3: {given} are given")


class MassLoss(FaultTable, tag="mass_loss", kw_only=True, frozen=True):
    """Ballast or payload drops off. It leaves with its own velocity.

    Attributes:
        mass_kg: the mass that drops off.
        position_frd_m: where it sat, as a point; default: the centre of mass.
    """

    mass_kg: Annotated[float, Meta(gt=0, le=1e9)]
    position_frd_m: tuple[Metres, Metres, Metres] | UnsetType = UNSET


FaultConfig = ThrusterDead | ThrusterWeak | ThrusterStuck | SensorFrozen | SensorSilent | BuoyancyChange | MassLoss
