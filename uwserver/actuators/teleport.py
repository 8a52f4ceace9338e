"""Sets the pose and velocity of a vehicle at once: for set-up, resets of an experiment, and replay of a log."""

from __future__ import annotations

import math

from uwserver.actuators.base import ActuatorTable, Body, Given, Timeout
from uwserver.physics.kernel.layout import NU, P, Q
from uwserver.ports import Field


class TeleportConfig(ActuatorTable, tag="teleport", kw_only=True, frozen=True):
    """Sets pose and velocity at once; it has no watchdog."""

    message = "Teleport"
    own_wrench = False
    timeout_s: Timeout = 0.0

    def build(self, body: Body) -> Teleport:
        """Return the actuator."""
        return Teleport(body)


class Teleport:
    """Sets pose and velocity. A field that is left out keeps its value.

    Without the limits one careless command could make the body diverge, which would end the run for everybody.
    """

    doc = "Sets pose and velocity at the start of the next tick; a field that is left out keeps its value."
    fields = (
        Field("p_NB", "m", "position of the body origin", "N", (3,), minimum=-1e6, maximum=1e6),
        Field("q_NB", "1", "attitude, w x y z; normalised", "NB", (4,), minimum=-1e6, maximum=1e6),
        Field("v_NB_B", "m/s", "velocity of the body origin", "B", (3,), minimum=-100.0, maximum=100.0),
        Field("w_NB_B", "rad/s", "angular velocity", "B", (3,), minimum=-100.0, maximum=100.0),
    )

    def __init__(self, body: Body) -> None:
        self._hydro, self._row = body.hydro, body.row

    def apply(self, value: Given) -> None:
        """Move the body now. A quaternion of zero length is ignored."""
        p, q, v, w = value
        state = self._hydro.state[self._row]
        if p is not None:
            state[P : P + 3] = p
        if q is not None and (norm := math.hypot(*q)) > 0.0:
            state[Q : Q + 4] = [c / norm for c in q]
        if v is not None:
            state[NU : NU + 3] = v
        if w is not None:
            state[NU + 3 : NU + 6] = w

    def neutral(self) -> None:
        """Do nothing: there is nothing to undo."""
