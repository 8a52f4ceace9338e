"""Messages DAT of a SeaTrac: they send and receive datagrams through a modem of the world."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any, cast

from uwserver.adapter import AdapterContext, CannotServe
from uwserver.frames import rotate
from uwserver.ports import Buffer, Progress, Refused, Sample
from uwserver.ports import Reply as Answer
from uwserver_adapters.devices import seatrac_messages as wire
from uwserver_adapters.devices.device import DeviceInput, Reply
from uwserver_adapters.devices.seatrac_messages import Found, Local, SeaTracMessage, encode

LONGEST = 31
"""Most bytes of a datagram."""
EVERYBODY = 0
_CODES = {"busy": wire.BUSY}
"""Status codes of faults; all other faults are FAIL."""


class Datagrams:
    """Sends and receives the datagrams of one beacon.

    Args:
        own: number of this beacon.
        modem: path of its modem, without ``/send`` and ``/received``.
        context: of the adapter.

    Attributes:
        subscriptions: path of the port where the modem receives.

    Raises:
        CannotServe: there is no such modem.
    """

    def __init__(self, own: int, modem: str, context: AdapterContext) -> None:
        self._own, self._context = own, context
        fields = ("event", "source", "destination", "data", "range", "bearing", "elevation")
        self._heard = DeviceInput("modem", f"{modem}/received", context.ports, fields)
        self._port = f"{modem}/send"
        if self._port not in context.ports:
            raise CannotServe(f'modem: there is no port "{self._port}": name a modem, without /send')
        self.subscriptions: Collection[str] = (self._heard.path,)

    def send(self, payload: bytes, reply: Reply) -> str:
        """Carry out DAT_SEND: beacon, kind of message, length, data. The answer comes once the modem has taken or refused it."""
        destination = payload[0] if payload else 0

        def tell(code: int) -> None:
            reply(encode(SeaTracMessage(wire.DAT_SEND, bytes((code, destination)))))

        reason, code = self._fault(payload)
        if code != wire.OK:
            tell(code)
            return reason
        wants = payload[1] in (wire.REQ, wire.REQU, wire.REQX)

        def answered(answer: Answer | Progress) -> None:
            if isinstance(answer, Answer):
                tell(_CODES.get(answer.fault.code, wire.FAIL) if answer.fault else wire.OK)

        value = {"destination": destination, "data": payload[3:], "acknowledge": float(wants)}
        try:
            self._context.command(self._port, value, self._context.name, answered)
        except Refused as refused:
            tell(wire.FAIL)
            return f"the modem refuses it: {refused.fault.text}"
        return ""

    def _fault(self, payload: bytes) -> tuple[str, int]:
        """Return why a datagram cannot be sent, and the status code of that; "" and OK where it can."""
        if len(payload) < 3:
            return "a datagram: beacon, kind of message and length are needed", wire.PARAM_MISSING
        destination, kind, length = payload[:3]
        wants_nothing = kind in (wire.ONE_WAY, wire.ONE_WAY_USBL)
        there = len(payload) - 3
        faults = (
            (
                length != there or length > LONGEST,
                f"a datagram of {length} bytes: {there} are there, at most {LONGEST}",
            ),
            (not length and wants_nothing, "a datagram without data that wants no answer"),
            (destination > 15 or destination == self._own, f"beacon {destination}: 0 to 15, and not its own"),
            (not wants_nothing and kind not in (wire.REQ, wire.REQU, wire.REQX), f"message type {kind}"),
            (destination == EVERYBODY and not wants_nothing, "a message to all wants no answer"),
        )
        reason = next((text for is_wrong, text in faults if is_wrong), "")
        return reason, wire.PARAM_INVALID if reason else wire.OK

    def hear(self, sample: Sample, local: Local) -> list[bytes]:
        """Take a sample of the modem: a datagram came, was delivered, or got no answer. Returns its message for the peers."""
        if not sample.valid:
            return []
        said = cast(dict[str, Any], self._heard.values(sample))
        if said["event"] == "failed":
            return [encode(SeaTracMessage(wire.DAT_ERROR, bytes((wire.TIMED_OUT, said["destination"] & 0xFF))))]
        is_answer = said["event"] == "delivered"
        other = (said["destination"] if is_answer else said["source"]) & 0xFF
        data = said["data"].data[:LONGEST] if isinstance(said["data"], Buffer) and not is_answer else b""
        found, kind = self._found(said, local), wire.ONE_WAY
        if is_answer:
            kind = (wire.REQ if found.bearing is None else wire.REQU) + 1
        elif found.bearing is not None:
            kind = wire.ONE_WAY_USBL
        addressed = self._own if is_answer else said["destination"] & 0xFF
        record = wire.fix(addressed, other, kind, local, found)
        return [encode(SeaTracMessage(wire.DAT_RECEIVE, record + bytes((is_answer, len(data))) + data + b"\x01"))]

    def _found(self, said: dict[str, Any], local: Local) -> Found:
        reach, bearing, elevation = said["range"], said["bearing"], said["elevation"] or 0.0
        p_N = None
        if reach is not None and bearing is not None and local.q_NS is not None:
            flat = reach * math.cos(elevation)
            p_S = (flat * math.cos(bearing), flat * math.sin(bearing), reach * math.sin(elevation))
            p_N = rotate(local.q_NS, p_S)
        travel_time = 0.0 if reach is None else 2.0 * reach / local.sound_speed
        return Found(reach, travel_time, bearing, elevation, p_N)
