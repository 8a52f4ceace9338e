"""The mission protocol: upload, download, progress. Fences and rally points there are none."""

from __future__ import annotations

import re
from collections.abc import Sequence

from msgspec import Struct

from uwserver.ports import Json
from uwserver_adapters.mavlink.vehicle.autopilot import Done
from uwserver_adapters.mavlink.vehicle.bridge import INFO, WARNING, Bridge
from uwserver_adapters.mavlink.vehicle.mission_items import (
    LARGEST,
    TAKEOFF,
    WAYPOINT,
    BadItem,
    Item,
    Result,
    home_item,
    item_of,
    place_of,
    translate,
    untranslated,
)
from uwserver_adapters.mavlink.vehicle.modes import GUIDED
from uwserver_adapters.mavlink.vehicle.setpoints import LOCAL_NED
from uwserver_adapters.mavlink.wire.channel import Channel
from uwserver_adapters.mavlink.wire.dialect import Entry, Fields, Message

ASK_AGAIN_S, GIVE_UP_S = 1.0, 8.0
"""Wall time after which an item that does not come is asked for again, and the upload is given up."""
MISSION, FENCE, RALLY = "MAV_MISSION_TYPE_MISSION", "MAV_MISSION_TYPE_FENCE", "MAV_MISSION_TYPE_RALLY"
_ITEM = re.compile(r"^item (\d+)")
"""How the autopilot begins what is wrong with an item."""
GO_THERE, GO_TO_HEIGHT = 2, 3
"""Values of `current` of items that belong to no mission."""


class Upload(Struct):
    """An upload under way.

    Attributes:
        channel, peer: who uploads.
        count: items that will come.
        kind: of mission.
        asked_at, heard_at: wall time of the last request, and of what came last.
        items: that came.
        made: what they are for the autopilot; translated as they come, since all at once would take 2.5 ms of the loop.
        numbers: of those, as uploaded.
    """

    channel: Channel
    peer: tuple[int, int]
    count: int
    kind: Entry
    asked_at: float
    heard_at: float
    items: list[Item] = []
    made: list[Json] = []
    numbers: list[int] = []


class Missions:
    """Loop thread. Times are wall time, s.

    Args:
        bridge: to ground stations and autopilot.
    """

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self._upload: Upload | None = None
        self._items: list[Item | dict[str, Json]] = []
        self._numbers: list[int] = []
        self._known_count = 0
        self._reached = 0
        self._start_at = 0

    # -- progress ---------------------------------------------------------------------------------------------------------------------

    def current(self) -> Fields:
        """Fields of MISSION_CURRENT."""
        state = self._bridge.readings.state()
        total = max(0, len(self._items) - 1)
        if not total:
            return {"seq": 0, "total": 0xFFFF, "mission_state": "MISSION_STATE_NO_MISSION"}
        is_on = state.mode == "mission" and state.mission_index >= 0
        is_done = state.mission_count > 0 and state.reached >= state.mission_count
        mission_state = "ACTIVE" if is_on else "COMPLETE" if is_done else "NOT_STARTED"
        return {
            "seq": self._number(state.mission_index),
            "total": total,
            "mission_state": f"MISSION_STATE_{mission_state}",
        }

    def _number(self, index: int) -> int:
        if 0 <= index < len(self._numbers):
            return self._numbers[index]
        return max(0, index + 1) if index >= 0 else self._start_at

    def tick(self, now: float) -> None:
        """Tell what was reached; go on with an upload that has stopped."""
        state = self._bridge.readings.state()
        if state.reached < self._reached:
            self._reached = state.reached
        while self._reached < min(state.reached, state.mission_count):
            self._bridge.send("MISSION_ITEM_REACHED", {"seq": self._number(self._reached)})
            self._bridge.tell(INFO, f"Reached command #{self._number(self._reached)}")
            self._reached += 1
        upload = self._upload
        if upload is None:
            return
        if now - upload.heard_at > GIVE_UP_S:
            self._bridge.tell(WARNING, "Mission upload timeout")
            self._end(upload, "OPERATION_CANCELLED")
        elif now - upload.asked_at > ASK_AGAIN_S:
            self._ask(upload, now)

    # -- upload -----------------------------------------------------------------------------------------------------------------------

    def begin_upload(self, message: Message, channel: Channel, now: float) -> None:
        """MISSION_COUNT: somebody wants to upload."""
        peer, kind, count = (message.system, message.component), message.entry("mission_type"), message.whole("count")
        if self._upload is not None and self._upload.peer != peer:
            self._acknowledge(channel, peer, kind, "DENIED")
        elif kind.name != MISSION:
            is_none = not count and kind.name in (FENCE, RALLY)
            self._acknowledge(channel, peer, kind, "ACCEPTED" if is_none else "UNSUPPORTED")
        elif count > LARGEST:
            self._bridge.tell(WARNING, f"Mission of {count} items: at most {LARGEST}")
            self._acknowledge(channel, peer, kind, "NO_SPACE")
        elif count == 0:
            self._clear(channel, peer, kind)
        else:
            self._upload = Upload(channel, peer, count, kind, now, now)
            self._ask(self._upload, now)

    def take(self, message: Message, channel: Channel, now: float) -> None:
        """MISSION_ITEM_INT or MISSION_ITEM: one item."""
        if message.whole("current") in (GO_THERE, GO_TO_HEIGHT):
            self._go(message, channel)
            return
        upload, peer = self._upload, (message.system, message.component)
        if upload is None or upload.peer != peer:
            self._acknowledge(channel, peer, message.entry("mission_type"), "INVALID_SEQUENCE" if upload is None else "DENIED")  # fmt: skip
            return
        upload.heard_at = now
        seq = message.whole("seq")
        if seq < len(upload.items):
            return  # it came twice
        if seq > len(upload.items):
            self._ask(upload, now)
            return
        try:
            item = item_of(message)
            if seq and item.command.name != TAKEOFF:
                upload.made.append(translate(item, self._bridge.home))
                upload.numbers.append(seq)
        except BadItem as reason:
            self._refuse(upload, reason)
            return
        upload.items.append(item)
        if len(upload.items) < upload.count:
            self._ask(upload, now)
        else:
            self._complete(upload)

    def _go(self, message: Message, channel: Channel) -> None:
        """Go there at once, in GUIDED, or keep the place and go to its height: ArduPilot's way, which QGroundControl takes with submarines."""
        bridge, peer = self._bridge, (message.system, message.component)
        state, kind = bridge.readings.state(), bridge.dialect.entry(MISSION)
        try:
            item = item_of(message)
            point = place_of(item, bridge.home)
        except BadItem as reason:
            bridge.counters["refused"] += 1
            bridge.tell(WARNING, str(reason))
            self._acknowledge(channel, peer, kind, reason.result)
            return
        here = point if message.whole("current") == GO_THERE else state.p_ref_N or state.p_N

        def done(reason: str) -> None:
            if reason:
                bridge.counters["refused"] += 1
                bridge.tell(WARNING, f"Go there: {reason}")
            self._acknowledge(channel, peer, kind, "ERROR" if reason else "ACCEPTED")

        if item.command.name != WAYPOINT or state.mode != GUIDED.autopilot:
            done("only in GUIDED, to a waypoint")
        elif here is None:
            done("the position is not known")
        else:
            bridge.autopilot.command("position", {"p_N": [here[0], here[1], point[2]]}, done)

    def _complete(self, upload: Upload) -> None:
        def done(reason: str) -> None:
            if reason:
                self._bridge.tell(WARNING, f"Mission refused: {_numbered(reason, upload.numbers)}")
            else:
                if len(upload.made) < upload.count - 1:
                    self._bridge.tell(INFO, "Mission: the take-off is left out")
                self._items, self._numbers, self._known_count = [*upload.items], upload.numbers, len(upload.made)
                self._reached, self._start_at = 0, 0
            self._end(upload, "INVALID" if reason else "ACCEPTED")

        if not self._bridge.autopilot.is_there:
            self._bridge.tell(WARNING, self._bridge.autopilot.absence)
            self._end(upload, "ERROR")
            return
        self._bridge.autopilot.call("set_mission", {"items": upload.made}, done)

    def _refuse(self, upload: Upload, reason: BadItem) -> None:
        self._bridge.counters["refused"] += 1
        self._bridge.tell(WARNING, str(reason))
        self._end(upload, reason.result)

    def _ask(self, upload: Upload, now: float) -> None:
        upload.asked_at = now
        fields = {**_to(upload.peer), "seq": len(upload.items), "mission_type": upload.kind.number}
        self._bridge.send("MISSION_REQUEST_INT", fields, upload.channel)

    def _end(self, upload: Upload, result: Result) -> None:
        if self._upload is upload:
            self._upload = None
        self._acknowledge(upload.channel, upload.peer, upload.kind, result)

    def _acknowledge(self, channel: Channel, peer: tuple[int, int], kind: Entry, result: Result) -> None:
        self._bridge.send(
            "MISSION_ACK", {**_to(peer), "type": f"MAV_MISSION_{result}", "mission_type": kind.number}, channel
        )

    # -- download and the rest --------------------------------------------------------------------------------------------------------

    def tell_count(self, message: Message, channel: Channel) -> None:
        """MISSION_REQUEST_LIST: somebody wants to download."""
        peer, kind = (message.system, message.component), message.entry("mission_type")
        if kind.name != MISSION:
            self._bridge.send("MISSION_COUNT", {**_to(peer), "count": 0, "mission_type": kind.number}, channel)
            return

        def tell(_: str) -> None:
            self._bridge.send("MISSION_COUNT", {**_to(peer), "count": len(self._items)}, channel)

        if self._bridge.readings.state().mission_count != self._known_count:
            self._bridge.autopilot.call("get_mission", {}, tell, self._learn)
        else:
            tell("")

    def _learn(self, result: Json) -> None:
        """The mission has been changed by somebody else."""
        items = result.get("items") if isinstance(result, dict) else None
        if isinstance(items, list):
            told = [item if isinstance(item, dict) else {} for item in items]
            self._items = [home_item(self._bridge.home, self._bridge.dialect.entry), *told] if told else []
            self._numbers = list(range(1, len(self._items)))
            self._known_count = len(told)

    def _item(self, seq: int) -> Item:
        """One item; of a mission that came another way it is made when it is asked for."""
        item = self._items[seq]
        if isinstance(item, Item):
            return item
        self._items[seq] = made = untranslated(seq, item, self._bridge.home, self._bridge.dialect.entry)
        return made

    def tell_item(self, message: Message, channel: Channel) -> None:
        """MISSION_REQUEST_INT or MISSION_REQUEST: one item, with a place in integers or, for the older, in floats."""
        peer, kind, seq = (message.system, message.component), message.entry("mission_type"), message.whole("seq")
        if kind.name != MISSION or seq >= len(self._items):
            self._acknowledge(channel, peer, kind, "INVALID_SEQUENCE")
            return
        item = self._item(seq)
        fields: dict[str, int | float] = {**_to(peer), **item.fields()}
        is_current = seq == self.current()["seq"] and seq > 0
        if message.name == "MISSION_REQUEST_INT":
            self._bridge.send("MISSION_ITEM_INT", {**fields, "current": int(is_current)}, channel)
            return
        scale = 1e-4 if item.frame.name == LOCAL_NED else 1e-7
        fields |= {"x": fields["x"] * scale, "y": fields["y"] * scale, "current": int(is_current)}
        self._bridge.send("MISSION_ITEM", fields, channel)

    def clear(self, message: Message, channel: Channel) -> None:
        """MISSION_CLEAR_ALL."""
        peer, kind = (message.system, message.component), message.entry("mission_type")
        if kind.name in (FENCE, RALLY):
            self._acknowledge(channel, peer, kind, "ACCEPTED")
        else:
            self._clear(channel, peer, kind)

    def _clear(self, channel: Channel, peer: tuple[int, int], kind: Entry) -> None:
        def done(reason: str) -> None:
            if not reason:
                self._items, self._numbers, self._known_count, self._reached, self._start_at = [], [], 0, 0, 0
            self._acknowledge(channel, peer, kind, "ERROR" if reason else "ACCEPTED")

        if self._bridge.autopilot.is_there:
            self._bridge.autopilot.call("clear_mission", {}, done)
        else:
            done("")

    def set_current(self, seq: int) -> bool:
        """Begin with this item: at once in AUTO, else when the mission is started. False when there is none."""
        if not 0 <= seq < len(self._items):
            return False
        self._start_at = seq
        if self._bridge.readings.state().mode == "mission":
            self.start(lambda reason: self._bridge.tell(WARNING, reason) if reason else None)
        self._bridge.send("MISSION_CURRENT", {**self.current(), "seq": seq})
        return True

    def start(self, done: Done) -> None:
        """Fly the mission from the current item on; `done` gets why not, or ""."""
        index = next((k for k, number in enumerate(self._numbers) if number >= self._start_at), 0)
        self._reached = 0
        self._bridge.autopilot.call("start_mission", {"index": index}, done)

    def forget(self, channel: Channel) -> None:
        """The channel is closed."""
        if self._upload is not None and self._upload.channel is channel:
            self._upload = None


def _numbered(reason: str, numbers: Sequence[int]) -> str:
    """A reason of the autopilot, whose items are those without home and take-offs, with the number that the ground station gave the item."""
    return _ITEM.sub(lambda found: f"item {numbers[int(found[1])]}", reason, count=1)


def _to(peer: tuple[int, int]) -> dict[str, int]:
    return {"target_system": peer[0], "target_component": peer[1]}
