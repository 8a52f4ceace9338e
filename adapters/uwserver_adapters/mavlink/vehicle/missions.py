"""The mission protocol: upload, download and progress. There are no fences and no rally points."""

from __future__ import annotations

import re
from collections.abc import Sequence

from msgspec import Struct

from uwserver.ports import Json
from uwserver_adapters.mavlink.vehicle.bridge import INFO, WARNING, Bridge, Done
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
from uwserver_adapters.mavlink.wire.dialect import Fields, MavlinkMessage, Value, addressed_to

ASK_AGAIN_S, GIVE_UP_S = 1.0, 8.0
"""Wall time after which a missing item is requested again, and after which an upload is given up."""
MISSION, FENCE, RALLY = "MAV_MISSION_TYPE_MISSION", "MAV_MISSION_TYPE_FENCE", "MAV_MISSION_TYPE_RALLY"
_ITEM = re.compile(r"^item (\d+)")
"""How the autopilot begins a text about a wrong item."""
GO_TO_PLACE, GO_TO_HEIGHT = 2, 3
"""Values of `current` of items that belong to no mission."""


class Upload(Struct):
    """An upload in progress.

    Attributes:
        request: the MISSION_COUNT that began it.
        channel: the channel on which it came.
        count: number of items that will come.
        asked_at, heard_at: wall time of the last request for an item, and of the last item.
        items: items received so far.
        translated: the same for the autopilot. They are translated one by one, because all at once would hold up the loop for 2.5 ms.
        numbers: the uploaded numbers of the translated items.
    """

    request: MavlinkMessage
    channel: Channel
    count: int
    asked_at: float
    heard_at: float
    items: list[Item] = []
    translated: list[Json] = []
    numbers: list[int] = []


class Missions:
    """The vehicle's mission. Runs on the loop thread. Times are wall time, s.

    Args:
        bridge: the way to ground stations and autopilot.
    """

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self._upload: Upload | None = None
        self._items: list[Item | dict[str, Json]] = []
        self._numbers: list[int] = []
        self._told: list[Json] = []
        self._reached = 0
        self._start_at = 0

    # -- progress ---------------------------------------------------------------------------------------------------------------------

    def current(self) -> Fields:
        """Return the fields of MISSION_CURRENT."""
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
        """Announce waypoints that were reached, and continue or give up an upload that has stopped."""
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

    def begin_upload(self, message: MavlinkMessage, channel: Channel, now: float) -> None:
        """Take MISSION_COUNT: a ground station wants to upload."""
        kind, count = message.entry("mission_type").name, message.integer("count")
        if self._upload is not None and self._upload.request.sender != message.sender:
            self._acknowledge(message, channel, "DENIED")
        elif kind != MISSION:
            is_empty = not count and kind in (FENCE, RALLY)
            self._acknowledge(message, channel, "ACCEPTED" if is_empty else "UNSUPPORTED")
        elif count > LARGEST:
            self._bridge.tell(WARNING, f"Mission of {count} items: at most {LARGEST}")
            self._acknowledge(message, channel, "NO_SPACE")
        elif count == 0:
            self.clear(message, channel)
        else:
            self._upload = Upload(message, channel, count, now, now)
            self._ask(self._upload, now)

    def take(self, message: MavlinkMessage, channel: Channel, now: float) -> None:
        """Take one item: MISSION_ITEM_INT or MISSION_ITEM."""
        if message.integer("current") in (GO_TO_PLACE, GO_TO_HEIGHT):
            self._go(message, channel)
            return
        upload = self._upload
        if upload is None or upload.request.sender != message.sender:
            self._acknowledge(message, channel, "INVALID_SEQUENCE" if upload is None else "DENIED")
            return
        upload.heard_at = now
        seq = message.integer("seq")
        if seq < len(upload.items):
            return  # a repeated item
        if seq > len(upload.items):
            self._ask(upload, now)
            return
        try:
            item = item_of(message)
            if seq and item.command.name != TAKEOFF:
                upload.translated.append(translate(item, self._bridge.home))
                upload.numbers.append(seq)
        except BadItem as reason:
            self._bridge.counters["refused"] += 1
            self._bridge.tell(WARNING, str(reason))
            self._end(upload, reason.result)
            return
        upload.items.append(item)
        if len(upload.items) < upload.count:
            self._ask(upload, now)
        else:
            self._complete(upload)

    def _go(self, message: MavlinkMessage, channel: Channel) -> None:
        """Go to a place at once, in GUIDED, or stay there and change the height. This is ArduPilot's own way, which QGroundControl uses."""
        bridge = self._bridge
        state = bridge.readings.state()
        try:
            item = item_of(message)
            point = place_of(item, bridge.home)
        except BadItem as reason:
            bridge.counters["refused"] += 1
            bridge.tell(WARNING, str(reason))
            self._acknowledge(message, channel, reason.result, MISSION)
            return
        place = point if message.integer("current") == GO_TO_PLACE else state.p_ref_N or state.p_N

        def done(reason: str) -> None:
            if reason:
                bridge.counters["refused"] += 1
                bridge.tell(WARNING, f"Go there: {reason}")
            self._acknowledge(message, channel, "ERROR" if reason else "ACCEPTED", MISSION)

        if item.command.name != WAYPOINT or state.mode != GUIDED.autopilot:
            done("only in GUIDED, to a waypoint")
        elif place is None:
            done("the position is not known")
        else:
            bridge.autopilot.command("position", {"p_N": [place[0], place[1], point[2]]}, done)

    def _complete(self, upload: Upload) -> None:
        def done(reason: str) -> None:
            if reason:
                self._bridge.tell(WARNING, f"Mission refused: {_numbered(reason, upload.numbers)}")
            else:
                if len(upload.translated) < upload.count - 1:
                    self._bridge.tell(INFO, "Mission: the take-off is left out")
                self._items, self._numbers = [*upload.items], upload.numbers
                self._told, self._reached, self._start_at = upload.translated, 0, 0
            self._end(upload, "INVALID" if reason else "ACCEPTED")

        if not self._bridge.autopilot.is_there:
            self._bridge.tell(WARNING, self._bridge.autopilot.absence)
            self._end(upload, "ERROR")
            return
        self._bridge.autopilot.call("set_mission", {"items": upload.translated}, done)

    def _ask(self, upload: Upload, now: float) -> None:
        upload.asked_at = now
        request = upload.request
        fields = {
            **addressed_to(request.sender), "seq": len(upload.items), "mission_type": request.integer("mission_type")
        }  # fmt: skip
        self._bridge.send("MISSION_REQUEST_INT", fields, upload.channel)

    def _end(self, upload: Upload, result: Result) -> None:
        if self._upload is upload:
            self._upload = None
        self._acknowledge(upload.request, upload.channel, result)

    def _acknowledge(
        self, message: MavlinkMessage, channel: Channel, result: Result, kind: Value | None = None
    ) -> None:
        """Send MISSION_ACK to the sender of a message, for the mission type of that message unless another is given."""
        kind = message.integer("mission_type") if kind is None else kind
        fields: Fields = {**addressed_to(message.sender), "type": f"MAV_MISSION_{result}", "mission_type": kind}
        self._bridge.send("MISSION_ACK", fields, channel)

    # -- download and the rest --------------------------------------------------------------------------------------------------------

    def tell_count(self, message: MavlinkMessage, channel: Channel) -> None:
        """Answer MISSION_REQUEST_LIST: a ground station wants to download."""
        is_mission = message.entry("mission_type").name == MISSION

        def tell(_: str) -> None:
            count, kind = len(self._items) if is_mission else 0, message.integer("mission_type")
            fields = {**addressed_to(message.sender), "count": count, "mission_type": kind}
            self._bridge.send("MISSION_COUNT", fields, channel)

        if is_mission and self._bridge.autopilot.is_there:
            self._bridge.autopilot.call("get_mission", {}, tell, self._learn)
        else:
            tell("")

    def _learn(self, result: Json) -> None:
        """Take the autopilot's mission if somebody else has changed it. A sample of its state would tell that too late: it may be older than the last
        upload."""
        items = result.get("items") if isinstance(result, dict) else None
        if not isinstance(items, list) or _is_same(items, self._told):
            return
        found = [item if isinstance(item, dict) else {} for item in items]
        self._items = [home_item(self._bridge.home, self._bridge.dialect.entry), *found] if found else []
        self._numbers = list(range(1, len(self._items)))
        self._told = [*items]

    def _item(self, seq: int) -> Item:
        """Return one item. An item that was not uploaded here is converted when it is first asked for."""
        item = self._items[seq]
        if not isinstance(item, Item):
            item = self._items[seq] = untranslated(seq, item, self._bridge.home, self._bridge.dialect.entry)
        return item

    def tell_item(self, message: MavlinkMessage, channel: Channel) -> None:
        """Answer MISSION_REQUEST_INT, or the older MISSION_REQUEST with a place in floats: send one item."""
        seq = message.integer("seq")
        if message.entry("mission_type").name != MISSION or seq >= len(self._items):
            self._acknowledge(message, channel, "INVALID_SEQUENCE")
            return
        item = self._item(seq)
        is_current = seq == self.current()["seq"] and seq > 0
        fields: dict[str, int | float] = {
            **addressed_to(message.sender), **item.fields(), "current": int(is_current)
        }  # fmt: skip
        if message.name == "MISSION_REQUEST_INT":
            self._bridge.send("MISSION_ITEM_INT", fields, channel)
            return
        scale = 1e-4 if item.frame.name == LOCAL_NED else 1e-7
        fields |= {"x": fields["x"] * scale, "y": fields["y"] * scale}
        self._bridge.send("MISSION_ITEM", fields, channel)

    def clear(self, message: MavlinkMessage, channel: Channel) -> None:
        """Take MISSION_CLEAR_ALL, or the upload of an empty mission."""

        def done(reason: str) -> None:
            if not reason:
                self._items, self._numbers, self._told, self._reached, self._start_at = [], [], [], 0, 0
            self._acknowledge(message, channel, "ERROR" if reason else "ACCEPTED")

        if message.entry("mission_type").name in (FENCE, RALLY):
            self._acknowledge(message, channel, "ACCEPTED")
        elif self._bridge.autopilot.is_there:
            self._bridge.autopilot.call("clear_mission", {}, done)
        else:
            done("")

    def set_current(self, seq: int) -> bool:
        """Begin with this item: at once in AUTO, else when the mission starts. Returns False when there is no such item."""
        if not 0 <= seq < len(self._items):
            return False
        self._start_at = seq
        if self._bridge.readings.state().mode == "mission":
            self.start(self._bridge.failure_teller())
        self._bridge.send("MISSION_CURRENT", {**self.current(), "seq": seq})
        return True

    def start(self, done: Done) -> None:
        """Carry out the mission from the current item on. `done` gets the outcome."""
        index = next((k for k, number in enumerate(self._numbers) if number >= self._start_at), 0)
        self._reached = 0
        self._bridge.autopilot.call("start_mission", {"index": index}, done)

    def forget(self, channel: Channel) -> None:
        """Forget the upload on a channel that has been closed."""
        if self._upload is not None and self._upload.channel is channel:
            self._upload = None


def _is_same(items: Sequence[Json], told: Sequence[Json]) -> bool:
    """Tell whether the autopilot's items are those that it was told. It leaves out values that are the default."""
    return len(items) == len(told) and all(
        isinstance(item, dict) and isinstance(its, dict) and all(its.get(key) == value for key, value in item.items())
        for item, its in zip(items, told, strict=True)
    )


def _numbered(reason: str, numbers: Sequence[int]) -> str:
    """Return a text of the autopilot with the ground station's number of the item. The autopilot counts without home and take-offs."""
    return _ITEM.sub(lambda found: f"item {numbers[int(found[1])]}", reason, count=1)
