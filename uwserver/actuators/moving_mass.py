"""A mass that slides along an axis to trim the vehicle. Rate and moment run in the kernel."""

from __future__ import annotations

from uwserver.actuators.servo import Moved, OneServo

_DOC = "position along the axis, 0 where the centre of mass of the vehicle file holds"


class MovingMassConfig(OneServo, tag="moving_mass", kw_only=True, frozen=True):
    """One moving mass of the vehicle file; its command is its position along its axis."""

    moved = Moved("moving_masses", "moving mass", "position_m", "m", _DOC)
