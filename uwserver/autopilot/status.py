"""The port `state` of an autopilot."""

from __future__ import annotations

import numpy as np

from uwserver.autopilot.pilot import Autopilot
from uwserver.autopilot.rows import MODES
from uwserver.autopilot.state import REASONS
from uwserver.modifiers.columns import columns_of
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Field, Value
from uwserver.sensors.base import IdealSensor, Scope
from uwserver.sensors.others import Writing

_STATE = (
    Field("mode", "1", "manual, stabilise, depth_hold ...", type="str"),
    Field("armed", "1", "it holds the actuators", type="bool"),
    Field("p_N", "m", "position of the body origin, estimated", "N", (3,)),
    Field("position_valid", "1", "the position is known or dead-reckoned", type="bool"),
    Field("v_N", "m/s", "velocity over ground, estimated", "N", (3,)),
    Field("velocity_valid", "1", "the velocity is measured", type="bool"),
    Field("q_NB", "1", "attitude, estimated, w x y z", "NB", (4,)),
    Field("w_B", "rad/s", "angular rate, measured", "B", (3,)),
    Field("depth", "m", "below the surface, estimated; nan when unknown"),
    Field("altitude", "m", "above the bottom, estimated; nan when unknown"),
    Field("p_ref_N", "m", "place to go to; nan when none", "N", (3,)),
    Field("depth_ref", "m", "depth to hold; nan when none"),
    Field("heading_ref", "rad", "heading to hold; nan when none"),
    Field("mission_index", "1", "item of the mission under way; -1 for none", type="int"),
    Field("mission_count", "1", "items of the mission", type="int"),
    Field("reached", "1", "items done since the mission was started", type="int"),
    Field("tau", "N, N m", "demanded force and moment about the body origin, in B", "", (6,)),
    Field("failsafe", "1", "why it does not do what it was told; empty when it does", type="str"),
)

TEXTS: tuple[tuple[Value, ...], ...] = tuple([(mode, reason) for mode in MODES for reason in REASONS])
"""All texts that a reading can have."""


class StateSensor(IdealSensor):
    """The estimate and the set points of an autopilot, as a sensor."""

    doc = "What the autopilot estimates from its sensors, and what it wants."
    writes = True

    def __init__(self, pilot: Autopilot) -> None:
        self._pilot = pilot
        names = pilot.spec.names
        doc = f"commands of its actuators, parts of their full commands: {', '.join(names)}"
        self.fields = (*_STATE, Field("outputs", "1", doc, "", (len(names),)))

    def begin(self, number: int) -> None:
        """Do nothing: it draws no random numbers."""

    def measure(self, scope: Scope | None) -> tuple[bool, list[Value]]:
        """Return the reading, which is always valid; its own fields say which parts are."""
        columns = columns_of(self.fields)
        row = np.zeros(columns.width)
        return True, list(columns.unpack(row, self.write(row)))

    def write(self, row: FloatArray) -> tuple[Value, ...]:
        """Write the numbers of the reading; see `Sensor.write`."""
        pilot = self._pilot
        return TEXTS[pilot.row.tell(pilot.t_ns, row)]

    @property
    def writing(self) -> Writing:  # type: ignore[override]  # its row may change
        """How compiled code writes the reading; see `Sensor.writing`."""
        return Writing(self._pilot.row.k, TEXTS)
