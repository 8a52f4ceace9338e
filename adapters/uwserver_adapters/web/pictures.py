"""Pictures and sonar rows for the pages that show them, encoded once. A slow page lowers only its own rate.

Camera pictures are encoded as JPEG on a thread. Without a JPEG library, and where the values are data rather than a picture, they are sent as
they are. The bytes of states and pictures are little endian (docs/reference/web.md), in one message for all pages.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Mapping, Sequence
from typing import Final, Protocol

from uwserver.adapter import AdapterContext, Worker
from uwserver.adapter.pictures import can_encode_jpeg, jpeg, picture_place, pixels
from uwserver.ports import Buffer, Port, Refused, Sample, SceneState, Value

STATE: Final = 1
PICTURE: Final = 2
PAUSED: Final = 1
"""Flag of a state: the world is paused."""
HIDDEN: Final = 2
"""Flag of a state: this server does not show where bodies are."""

_STATE = struct.Struct("<BBHIq")
_COUNT = struct.Struct("<H")
_PICTURE = struct.Struct("<BBHHHq")
RAW: Final = 0
JPEG: Final = 1
DEPTH: Final = 2
SONAR: Final = 3
FAN: Final = 4
SIDES: Final = 5
"""Codings of a picture.

RAW is u8, JPEG a JPEG file, and DEPTH u16 in mm. SONAR is a row of a scanning sonar: f32 bearing (rad), f32 range (m), u8. FAN is a picture of an
imaging sonar: f32 azimuths of the first and the last beam (rad), f32 ranges at the begin of the first and the end of the last row (m), u8. SIDES is
a ping of a side-scan sonar: f32 range (m), u8 to port, u8 to starboard.
"""
MOST_PORTS = 32
"""Ports whose pictures one page may show."""
_SONAR_HEAD, _FAN_HEAD, _SIDES_HEAD = struct.Struct("<ff"), struct.Struct("<ffff"), struct.Struct("<f")
_SIDE_LIMIT = 0xFFFF


def state_frame(state: SceneState, flags: int) -> bytes:
    """Return `u8 kind, u8 flags, u16 count, u32 revision, i64 t_ns`, f32 x, y, z, w, x, y, z of each body, `u16 count`, i8 of each actuator."""
    is_shown = not flags & HIDDEN
    bodies = state.poses if is_shown else state.poses[:0]
    achieved = state.achieved if is_shown else state.achieved[:0]
    return b"".join((
        _STATE.pack(STATE, flags, len(bodies), state.entities.revision, state.t_ns),
        bodies.astype("<f4").tobytes(),
        _COUNT.pack(len(achieved)),
        achieved.tobytes(),
    ))  # fmt: skip


def picture_frame(codec: int, port: int, width: int, height: int, t_ns: int, data: bytes) -> bytes:
    """Return `u8 kind, u8 codec, u16 port, u16 width, u16 height, i64 t_ns`, then the picture."""
    return _PICTURE.pack(PICTURE, codec, port, width, height, t_ns) + data


class Viewer(Protocol):
    """A page that shows pictures."""

    @property
    def is_clear(self) -> bool:
        """Whether everything sent so far has left this process, so that one more message does not queue up."""

    def send_frame(self, body: bytes) -> None:
        """Send a binary message."""


class Pictures:
    """Which viewer shows which ports, and which pictures it has not confirmed yet.

    Args:
        context: the adapter's context.
    """

    def __init__(self, context: AdapterContext) -> None:
        self._context = context
        self._numbers: dict[str, int] = {}
        self._subscriptions: dict[str, dict[Viewer, None]] = {}
        self._unseen: set[tuple[Viewer, int]] = set()
        self._loop = asyncio.get_running_loop()
        self._worker = Worker("web pictures", context.stats)
        self._in_work: set[str] = set()

    @property
    def subscriptions(self) -> frozenset[str]:
        """Ports that somebody shows."""
        return frozenset(self._subscriptions)

    def show(self, viewer: Viewer, ports: Sequence[str]) -> dict[str, int]:
        """Send a viewer the pictures of these ports, and of no others, from now on.

        Returns:
            The numbers of the ports in frames.

        Raises:
            Refused: unknown ports, ports without pictures, or too many.
        """
        if len(ports) > MOST_PORTS:
            raise Refused(
                "too_large", f"a page can show pictures of at most {MOST_PORTS} ports, not {len(ports)}", "pictures"
            )
        for path in ports:
            port = self._context.ports.get(path)
            if port is None:
                raise Refused("unknown_port", f'no port "{path[:200]}"', "pictures")
            if not has_picture(port):
                raise Refused("bad_argument", f'"{path}" has no pictures: subscribe to its samples', "pictures")
        self.leave(viewer)
        for path in ports:
            self._subscriptions.setdefault(path, {})[viewer] = None
        self._context.subscriptions_changed()
        return {path: self._numbers.setdefault(path, len(self._numbers) % _SIDE_LIMIT) for path in ports}

    def seen(self, viewer: Viewer, numbers: Sequence[int]) -> None:
        """Note that a viewer has shown its pictures of these ports, and can take the next ones."""
        self._unseen -= {(viewer, number) for number in numbers}

    def leave(self, viewer: Viewer) -> None:
        """Send a viewer no pictures any more."""
        for path in [path for path, viewers in self._subscriptions.items() if viewer in viewers]:
            del self._subscriptions[path][viewer]
            if not self._subscriptions[path]:
                del self._subscriptions[path]
        self._unseen = {(who, number) for who, number in self._unseen if who is not viewer}

    def forget(self) -> None:
        """Forget unconfirmed pictures, because the world was reset."""
        self._unseen.clear()

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Send pictures to the viewers that can take them."""
        if not self._subscriptions:
            return
        for sample in samples:
            port = self._context.ports.get(sample.port)
            if port is None or sample.port in self._in_work or not self._takers(sample.port):
                continue
            number = self._numbers[sample.port]
            if _is_photo(port):
                self._encode(port, sample, number)
            else:
                self._send(sample.port, number, encoded(port, sample, number))

    def _takers(self, path: str) -> list[Viewer]:
        """Return the viewers that have confirmed the last picture of a port, and can take the next."""
        viewers = self._subscriptions.get(path, ())
        return [v for v in viewers if (v, self._numbers[path]) not in self._unseen and v.is_clear]

    def _send(self, path: str, number: int, frame: bytes | None) -> None:
        for viewer in self._takers(path) if frame is not None else ():
            self._unseen.add((viewer, number))
            viewer.send_frame(frame or b"")

    def _encode(self, port: Port, sample: Sample, number: int) -> None:
        """Encode a picture on the thread, one of each port at a time. A viewer that joins in the meantime gets later ones."""

        def work() -> None:
            frame = None
            try:
                frame = jpeg_frame(port, sample, number)
            finally:
                self._loop.call_soon_threadsafe(done, frame)

        def done(frame: bytes | None) -> None:
            self._in_work.discard(port.path)
            self._send(port.path, number, frame)

        if self._worker.send(work):
            self._in_work.add(port.path)

    async def close(self) -> None:
        """End the thread."""
        await self._worker.run(lambda: None)  # the picture in work ends first
        await self._worker.close(lambda: None)


def _fan(picture: Buffer, by_name: Mapping[str, Value], number: int, t_ns: int) -> bytes | None:
    """Return a picture of ranges and beams as a frame; None if it does not hold counts for each azimuth."""
    azimuth, near, far = by_name["azimuth"], by_name.get("range_start", 0.0), by_name.get("range")
    fits = (
        isinstance(near, int | float)
        and isinstance(far, int | float)
        and picture.dtype == "uint8"
        and len(picture.shape) == 2
    )
    if not fits or not isinstance(azimuth, Buffer) or azimuth.dtype != "float32" or max(picture.shape) > _SIDE_LIMIT:
        return None
    angles = azimuth.array()
    if angles.shape != picture.shape[1:] or not len(angles):
        return None
    head = _FAN_HEAD.pack(angles[0], angles[-1], near, far)
    return picture_frame(FAN, number, picture.shape[1], picture.shape[0], t_ns, head + picture.data)


def _sides(by_name: Mapping[str, Value], number: int, t_ns: int) -> bytes | None:
    """Return a ping of a side-scan sonar as a frame, nearest counts first; None if the sides are not counts of the same length."""
    port, starboard, reach = by_name.get("port"), by_name.get("starboard"), by_name.get("range")
    if not isinstance(port, Buffer) or not isinstance(starboard, Buffer) or not isinstance(reach, int | float):
        return None
    shape = port.shape
    if {port.dtype, starboard.dtype} != {"uint8"} or starboard.shape != shape or len(shape) != 1:
        return None
    if not 0 < shape[0] <= _SIDE_LIMIT:
        return None
    body = _SIDES_HEAD.pack(reach) + port.data + starboard.data
    return picture_frame(SIDES, number, shape[0], 2, t_ns, body)


def has_picture(port: Port) -> bool:
    """Return whether a sensor gives pictures or rows of bytes."""
    return port.direction == "sensor" and any(field.type == "buffer" for field in port.fields)


def _is_photo(port: Port) -> bool:
    """Return whether a port gives pictures for people. Sonar echoes, which have a range, are data that the page arranges itself."""
    place = picture_place(port)
    return place is not None and can_encode_jpeg() and all(field.name != "range" for field in port.fields)


def jpeg_frame(port: Port, sample: Sample, number: int) -> bytes | None:
    """Return a picture as a frame with a JPEG; None if the sample has no picture."""
    place = picture_place(port)
    shown = pixels(sample.value[place]) if place is not None and place < len(sample.value) else None
    if shown is None or max(shown.shape) > _SIDE_LIMIT:
        return None
    return picture_frame(JPEG, number, shown.shape[1], shown.shape[0], sample.t_ns, jpeg(shown))


def encoded(port: Port, sample: Sample, number: int) -> bytes | None:
    """Return a sample as a frame; None if it has no picture that a page can draw.

    A row with `head_angle` and `range` is from a scanning sonar, and a picture with an `azimuth` for each column from an imaging sonar. Rows named
    `port` and `starboard` with a `range` are a ping of a side-scan sonar.
    """
    names = [field.name for field in port.fields]
    if len(names) != len(sample.value):
        return None
    by_name = dict(zip(names, sample.value, strict=True))
    place = picture_place(port)
    shown = sample.value if place is None else (sample.value[place],)
    picture = next((value for value in shown if isinstance(value, Buffer)), None)
    if picture is None:
        return None
    if isinstance(by_name.get("azimuth"), Buffer):
        return _fan(picture, by_name, number, sample.t_ns)
    if "starboard" in by_name and (sides := _sides(by_name, number, sample.t_ns)) is not None:
        return sides
    angle, reach = by_name.get("head_angle"), by_name.get("range")
    if picture.dtype == "uint8" and isinstance(angle, int | float) and isinstance(reach, int | float):
        head = _SONAR_HEAD.pack(angle, reach)
        if len(picture.data) > _SIDE_LIMIT:
            return None
        return picture_frame(SONAR, number, len(picture.data), 1, sample.t_ns, head + picture.data)
    codec = {"uint8": RAW, "uint16": DEPTH}.get(picture.dtype)
    if codec is None or not picture.shape:
        return None
    height, width = picture.shape[:2] if len(picture.shape) > 1 else (1, picture.shape[0])
    if max(height, width) > _SIDE_LIMIT:
        return None
    return picture_frame(codec, number, width, height, sample.t_ns, picture.data)
