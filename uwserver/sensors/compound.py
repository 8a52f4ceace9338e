"""Compound sensor: the last readings of several sensors of a vehicle in one message, as an autopilot wants them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated

from msgspec import Meta, structs

from uwserver.modifiers.base import Measurement
from uwserver.ports import Field, Value
from uwserver.sensors.base import Latest, Named, Pose, Scope, Sensor, SensorTable, Traits
from uwserver.table import Name
from uwserver.units import NANOSECONDS

_AGE = Field("age", "s", "age of the oldest reading in the message")


class CompoundConfig(SensorTable, tag="compound", kw_only=True, frozen=True):
    """Several sensors in one message. It takes their readings when they are measured, so its own `latency_s` counts and theirs do not.

    Attributes:
        members: names of sensors of the vehicle, in the order of the message.
    """

    members: Annotated[tuple[Name, ...], Meta(min_length=1)]

    def traits(self) -> Traits:
        """Declare the sensors whose readings it repeats."""
        return Traits(names=tuple(Named(("members", k), "sensors", name) for k, name in enumerate(self.members)))

    def build(self, mount: Pose) -> Compound:
        """Return the sensor, without its members: `join` adds them."""
        return Compound(self)


class Compound(Sensor):
    """It reads after all other sensors of a tick, so that the message holds their newest readings."""

    fields: tuple[Field, ...] = (_AGE,)
    repeats = True

    def __init__(self, config: CompoundConfig) -> None:
        self.members = config.members
        self.doc = f"The last readings of {', '.join(config.members)} in one message; valid when all of them are."
        super().__init__()

    @property
    def needs(self) -> Collection[str]:
        """The names of its members."""
        return self.members

    def join(self, others: Mapping[str, Latest]) -> None:
        """Find the members. The fields are theirs, each with the name of the member in front."""
        self.repeated = tuple(others[name] for name in self.members)
        fields = [_AGE]
        for name, part in zip(self.members, self.repeated, strict=True):
            fields.append(Field(f"{name}_valid", "1", f"whether {name} could measure", type="bool"))
            fields += [structs.replace(field, name=f"{name}_{field.name}") for field in part.fields]
        self.fields = tuple(fields)

    def sense(self, scope: Scope) -> Measurement | None:
        """Return None until each member has measured once. If all values are numbers, the step does this (`step.readings`)."""
        values: list[Value] = []
        oldest, valid = scope.t_ns, True
        for part in self.repeated:
            if part.held is None:
                return None
            fine, read = part.held
            oldest, valid = min(oldest, part.held_ns), valid and fine
            values += [fine, *read]
        return Measurement([(scope.t_ns - oldest) / NANOSECONDS, *values], valid)
