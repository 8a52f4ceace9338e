"""What an autopilot shows by its port `state`."""

from __future__ import annotations

from uwserver.autopilot.pilot import Autopilot
from uwserver.autopilot.rows import MODES
from uwserver.autopilot.state import REASONS
from uwserver.ports import Field, Value
from uwserver.sensors.base import IdealSensor, Scope

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


class StateSensor(IdealSensor):
    """What the autopilot believes and wants, as a sensor's port."""

    doc = "What the autopilot believes, from its sensors, and what it wants."

    def __init__(self, pilot: Autopilot) -> None:
        self._pilot = pilot
        names = pilot.craft.names
        doc = f"what its actuators were told, parts of their full commands: {', '.join(names)}"
        self.fields = (*_STATE, Field("outputs", "1", doc, "", (len(names),)))

    def begin(self, number: int) -> None:
        """Nothing: it draws no random numbers."""

    def measure(self, scope: Scope | None) -> tuple[bool, list[Value]]:
        """Always valid: each part tells by itself whether it is."""
        pilot = self._pilot
        x, outputs = pilot.seat.show(pilot.t_ns)
        mode, armed, position, velocity, index, reached, failsafe = map(int, x[26:])
        return True, [
            MODES[mode], armed != 0, tuple(x[0:3]), position != 0, tuple(x[3:6]), velocity != 0, tuple(x[6:10]), tuple(x[10:13]), x[13], x[14],
            tuple(x[15:18]), x[18], x[19], index, len(pilot.orders.items), reached, tuple(x[20:26]), REASONS[failsafe], outputs,
        ]  # fmt: skip
