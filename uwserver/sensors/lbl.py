"""Long baseline: ranges to beacons whose places are known."""

from __future__ import annotations

from uwserver.modifiers.base import Measurement
from uwserver.ports import Field
from uwserver.sensors.base import Pose, Scope
from uwserver.sensors.interrogation import InterrogationTable, Interrogator
from uwserver.units import NANOSECONDS


class LblConfig(InterrogationTable, tag="lbl", kw_only=True, frozen=True):
    """An interrogator of beacons, one a reading."""

    def build(self, mount: Pose) -> Lbl:
        """The instrument."""
        return Lbl(mount, self)


class Lbl(Interrogator):
    """Range and travel time of one beacon a reading, in turn."""

    doc = (
        "Long baseline: range of one acoustic beacon, each in its turn; delivered when its answer arrives. Invalid without answer: too far, "
        "too weak, hidden, or out of the water."
    )
    fields = (
        Field("beacon", "1", "name of the beacon", type="str"),
        Field("range", "m", "distance at the sound speed that the device believes"),
        Field("travel_time", "s", "of the sound there and back, without the beacon's turn-around time"),
    )

    def sense(self, scope: Scope) -> Measurement | None:
        """An exchange with the next beacon; None while the last one is not over."""
        if not self.is_ready(scope):
            return None
        p_NS = scope.position(self._mount.p)
        name, answer, wait = self.ask(scope, p_NS)
        if answer is None:
            return Measurement([name, None, None], False, round(wait * NANOSECONDS))
        if self._table.ideal:
            reach = answer.distance
        else:
            reach = 0.5 * self.believed(scope.water.sound_speed(p_NS[2])) * answer.travel_time
        return Measurement([name, reach, answer.travel_time], True, round(wait * NANOSECONDS))
