"""The table of a vehicle in a scenario: which model it is, where it starts, and how many copies there are."""

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
        count: how many vehicles.
        columns: vehicles in a row; default: about as many as there are rows.
        spacing_m: distance of rows and of columns; the first vehicle is at `position_ned_m`.
    """

    count: Annotated[int, Meta(ge=1, le=1000)]
    columns: Annotated[int, Meta(ge=1)] | UnsetType = UNSET
    spacing_m: tuple[Positive, Positive] = (5.0, 5.0)


class VehicleEntry(Following, kw_only=True, frozen=True):
    """One vehicle of the scenario, or several copies of it.

    Attributes:
        kind: "simulated", or "external" for a vehicle that follows poses from a log or another source; the keys from `log` to `rate_hz` are for that.
        model: name of a shipped vehicle file, or the path of one relative to the scenario file.
        copies: several vehicles in a grid; default: one vehicle, with the name of the table.
        present: false leaves it out at the start; ``world/spawn`` can add vehicles like it later.
        override: keys of the vehicle file with other values for this vehicle.
        sensors: added to those of the vehicle file. One with the same name replaces it; ``enabled = false`` removes it.
        autopilot: the built-in autopilot; default: none.
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
