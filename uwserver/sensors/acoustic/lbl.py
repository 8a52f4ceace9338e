"""Long baseline: ranges to beacons whose places are known."""

from __future__ import annotations

from uwserver.modifiers.base import Measurement
from uwserver.ports import Field
from uwserver.sensors.acoustic.interrogation import InterrogationTable, Interrogator
from uwserver.sensors.base import Pose, Scope
from uwserver.units import NANOSECONDS


class LblConfig(InterrogationTable, tag="lbl", kw_only=True, frozen=True):
    """An interrogator of beacons, one a reading."""

    message = "BeaconRange"

    def build(self, mount: Pose) -> Lbl:
        return Lbl(mount, self)


class Lbl(Interrogator):
    """Range and travel time of one beacon a reading, in turn."""

    doc = (
        "Long baseline: range of one acoustic beacon at a time, in turn; delivered when its answer arrives. Invalid without an answer: the beacon "
        "is too far away, too weak, hidden, or out of the water."
    )
    fields = (
        Field("beacon", "1", "name of the beacon", type="str"),
        Field("range", "m", "distance at the sound speed that the device believes"),
        Field("travel_time", "s", "time of the sound there and back, without the beacon's turn-around time"),
    )

    def sense(self, scope: Scope) -> Measurement | None:
        """None until the exchange under way is over."""
        over = self.exchange(scope)
        if over is None:
            return None
        answer, delay_ns, since_ns = over.answer, round(over.wait * NANOSECONDS), scope.t_ns - over.asked_ns
        if answer is None:
            return Measurement([over.name, None, None], False, delay_ns, since_ns=since_ns)
        if self._table.ideal:
            reach = answer.distance
        else:
            reach = 0.5 * self.believed(scope.water.sound_speed(answer.p_NS[2])) * answer.travel_time
        return Measurement([over.name, reach, answer.travel_time], True, delay_ns, since_ns=since_ns)
