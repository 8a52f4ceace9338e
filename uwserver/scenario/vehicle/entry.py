"""A vehicle in a scenario: where it is, what it is made of, and how many there are."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import UNSET, Meta, UnsetType, field

from uwserver.autopilot.config import AutopilotConfig
from uwserver.scenario.vehicle.external import Following
from uwserver.sensors import SensorConfig
from uwserver.sensors.truth import Truth
from uwserver.table import Name, Positive, Table, Vector3


class Copies(Table, kw_only=True, frozen=True):
    """Several vehicles from one table, ``<name>_1``, ``<name>_2`` and so on, in rows to the north and columns to the east.

    Attributes:
        count: of vehicles.
        columns: vehicles in a row; default: as many as makes a square.
        spacing_m: of rows and columns; the first vehicle is at `position_ned_m`.
    """

    count: Annotated[int, Meta(ge=1, le=1000)]
    columns: Annotated[int, Meta(ge=1)] | UnsetType = UNSET
    spacing_m: tuple[Positive, Positive] = (5.0, 5.0)


class VehicleEntry(Following, kw_only=True, frozen=True):
    """One vehicle of the scenario, or several alike.

    Attributes:
        kind: "simulated", or "external" for one that follows poses from a log or from elsewhere; the keys from `log` to `rate_hz` are for that.
        model: name of a shipped vehicle file, or the path of one relative to the scenario file.
        copies: several of them in a grid; default: one, with the name of the table.
        present: False keeps it out at the start; ``world/spawn`` can add vehicles like it.
        override: tables of the vehicle file, key by key replaced for this vehicle.
        sensors: added to those of the vehicle file (same name: replaces it; ``enabled = false`` removes it).
        autopilot: the built-in one; default: none.
    """

    model: Name
    position_ned_m: Vector3 = (0.0, 0.0, 0.0)
    attitude_rpy_deg: Vector3 = (0.0, 0.0, 0.0)
    velocity_frd_mps: Vector3 = (0.0, 0.0, 0.0)
    angular_velocity_frd_degps: Vector3 = (0.0, 0.0, 0.0)
    copies: Copies | UnsetType = UNSET
    present: bool = True
    truth: Truth | UnsetType = UNSET
    override: dict[str, Any] = field(default_factory=dict)
    sensors: dict[str, SensorConfig] = field(default_factory=dict)
    autopilot: AutopilotConfig | UnsetType = UNSET
