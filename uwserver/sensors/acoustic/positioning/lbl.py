"""Long baseline: ranges to beacons whose positions are known."""

from __future__ import annotations

from uwserver.ports import Field, Value
from uwserver.sensors.acoustic.positioning.interrogation import Answer, InterrogationTable, Interrogator
from uwserver.sensors.base import Pose, Scope


class LblConfig(InterrogationTable, tag="lbl", kw_only=True, frozen=True):
    """An interrogator that asks one beacon a reading."""

    message = "BeaconRange"

    def build(self, mount: Pose) -> Lbl:
        return Lbl(mount, self)


class Lbl(Interrogator):
    """Gives range and travel time of one beacon a reading, in turn."""

    doc = (
        "Long baseline: range of one acoustic beacon at a time, in turn; delivered when its answer arrives. Invalid without an answer: the beacon "
        "is too far away, too weak, hidden, or out of the water."
    )
    fields = (
        Field("beacon", "1", "name of the beacon", type="str"),
        Field("range", "m", "distance at the sound speed that the device believes"),
        Field("travel_time", "s", "time of the sound there and back, without the beacon's turn-around time"),
    )

    def values(self, scope: Scope, answer: Answer) -> list[Value]:
        """Return range and travel time."""
        if self._table.ideal:
            return [answer.distance, answer.travel_time]
        return [0.5 * self.believed(scope.water.sound_speed(answer.p_NS[2])) * answer.travel_time, answer.travel_time]
