"""States and pictures as bytes, one message for all pages (docs/reference/web.md). Little endian."""

from __future__ import annotations

import struct
from typing import Final

from uwserver.ports import SceneState

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
