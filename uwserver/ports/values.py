"""What crosses every wall: ports and the values that travel through them.

All types are immutable. Values are SI, angles radians, times integer nanoseconds of simulation time since the start of the scenario.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Literal

from msgspec import UNSET, Struct, UnsetType

from uwserver.ports.buffer import LARGEST, Buffer, Layout

Scalar = float | int | bool | str | None
"""One component of a field."""
Value = Scalar | Buffer | tuple[Scalar, ...]
"""One field: a scalar, the row-major components of an array, or a buffer; None where a sensor has no value."""
Item = tuple[float, ...] | str | Buffer
"""One field of a checked command: numbers (also one alone) are a tuple of floats, bytes a buffer without type."""
Items = tuple[Item | None, ...]
"""One entry for each field of an actuator's port; None where the sender left the field out."""
MOST_BYTES = 1 << 16
"""Most bytes of a text (UTF-8) or of bytes in a command, where its field says no less."""
Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]
"""Anything a service takes or gives."""


class Field(Struct, frozen=True, gc=False):
    """One named value of a port.

    Attributes:
        name: name on every wire.
        unit: SI unit, "1" where there is none.
        doc: one sentence.
        frame: frame of a vector's components (N, B, S, or "NB" of a rotation); "" where none applies.
        shape: () for a scalar, (3,) for a vector.
        type: type of each component; the values of "bytes" and "buffer" are a `Buffer`, and their shape is ().
        minimum, maximum: limits of each component; a command outside is refused.
        buffer: type and shape of a buffer's items.
        max_bytes: longest text (UTF-8), bytes or buffer that a command may bring; absent for 64 KiB, or 1 MiB of a buffer.
    """

    name: str
    unit: str
    doc: str
    frame: str = ""
    shape: tuple[int, ...] = ()
    type: Literal["float", "int", "bool", "str", "bytes", "buffer"] = "float"
    minimum: float | None = None
    maximum: float | None = None
    buffer: Layout | UnsetType = UNSET
    max_bytes: int | UnsetType = UNSET

    @property
    def is_rotation(self) -> bool:
        """Whether it is a quaternion w x y z between the two frames of its `frame`."""
        return self.shape == (4,) and len(self.frame) == 2

    @property
    def is_packed(self) -> bool:
        """Whether its values are bytes or buffers."""
        return self.type in ("bytes", "buffer")

    def holds(self, buffer: Buffer) -> bool:
        """Whether a buffer, or plain bytes, may be its value."""
        return self.type == ("buffer" if buffer.dtype else "bytes") and (not self.buffer or self.buffer.fits(buffer))

    @property
    def form(self) -> str:
        """What one value looks like, for people: ``scalar``, ``3``, ``bytes`` or ``uint8 nx512``."""
        if self.is_packed:
            return str(self.buffer or "bytes")
        return "x".join(map(str, self.shape)) or "scalar"

    @property
    def most_bytes(self) -> int:
        """Longest text, bytes or buffer of a command."""
        return self.max_bytes or (LARGEST if self.type == "buffer" else MOST_BYTES)

    @property
    def size(self) -> int:
        """Number of components."""
        size = 1
        for extent in self.shape:
            size *= extent
        return size


class Propulsor(Struct, frozen=True):
    """What one component of a thruster command pushes with: its name, its place (m) and the direction of its force at a positive command, in B."""

    name: str
    r_B: tuple[float, float, float]
    axis_B: tuple[float, float, float]


class Port(Struct, frozen=True, gc=False):
    """A typed place where samples come out or commands go in.

    Attributes:
        path: ``<vehicle>/<component>``.
        direction: sensor (samples out) or actuator (commands in).
        kind: the component's kind in the scenario file.
        fields: in the order of every value tuple.
        doc: one or two sentences.
        rate_hz: sample rate; None for actuators.
        timeout_s: an actuator goes to neutral after this long without a command; None for never.
        propulsors: of an actuator of thrusters, in the order of its components; absent where there are none.
    """

    path: str
    direction: Literal["sensor", "actuator"]
    kind: str
    fields: tuple[Field, ...]
    doc: str
    rate_hz: float | None = None
    timeout_s: float | None = None
    propulsors: tuple[Propulsor, ...] | UnsetType = UNSET

    @property
    def is_truth(self) -> bool:
        """Whether the port tells what no instrument could know."""
        return "/truth/" in self.path


class Argument(Struct, frozen=True, gc=False):
    """One argument of a service; `type` "json" takes anything."""

    name: str
    type: Literal["float", "int", "bool", "str", "json"]
    doc: str
    unit: str = "1"
    required: bool = True
    default: Json = None
    shape: tuple[int, ...] = ()
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()


class Service(Struct, frozen=True, gc=False):
    """A request with a reply.

    Attributes:
        path: ``world/<name>`` or ``<vehicle>/<component>/<name>``.
        doc: one or two sentences.
        arguments: what it takes.
        reads_only: answered at once from the last published state; the others run at the start of the next tick.
        long_running: may reply many ticks later, with progress, and can be cancelled.
    """

    path: str
    doc: str
    arguments: tuple[Argument, ...] = ()
    reads_only: bool = False
    long_running: bool = False


class Sample(Struct, frozen=True, gc=False):
    """What a sensor said.

    Attributes:
        port: path of the port.
        seq: counts what this sensor produced, from 0.
        t_ns: simulation time at which it was true; by the clock of the device where that drifts.
        t_sent_ns: simulation time at which the device delivers it.
        valid: False when the sensor could not measure.
        value: one entry per field of the port, in its order.
    """

    port: str
    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool
    value: tuple[Value, ...]


class Command(Struct, frozen=True):
    """A value for an actuator; `value` holds one entry per field of the port, checked against it.

    `source` names who sent it (adapter and client), so that two commanders of one actuator are seen.
    """

    port: str
    value: Items
    source: str = ""


class Call(Struct, frozen=True):
    """A service request with checked arguments."""

    service: str
    args: Mapping[str, Json]
    source: str = ""


ErrorCode = Literal[
    "parse_error",
    "invalid_request",
    "unknown_method",
    "unknown_port",
    "unknown_service",
    "bad_argument",
    "bad_shape",
    "not_finite",
    "out_of_range",
    "busy",
    "preempted",
    "timeout",
    "denied",
    "too_large",
    "overload",
    "version",
    "internal",
    "shutdown",
]


class Fault(Struct, frozen=True):
    """Why a request was refused: a code, a text that says what to do, and the argument, field, port or service at fault."""

    code: ErrorCode
    text: str
    where: str = ""


class Refused(Exception):
    """Raised where a request is refused; carries the fault that the sender is told."""

    def __init__(self, code: ErrorCode, text: str, where: str = "") -> None:
        super().__init__(text)
        self.fault = Fault(code, text, where)


class Reply(Struct, frozen=True):
    """The one answer to a command or call: the tick at whose start it was carried out, and its result or its fault."""

    tick: int
    t_ns: int
    result: Json = None
    fault: Fault | None = None
    conflict: bool = False


class Progress(Struct, frozen=True):
    """How far a long-running call has come, 0 to 1."""

    fraction: float
    t_ns: int


class Event(Struct, frozen=True):
    """Something that every client should know."""

    event: Literal[
        "paused",
        "resumed",
        "reset",
        "ports_changed",
        "conflict",
        "watchdog",
        "fault",
        "diverged",
        "shutdown",
        "adapter_failed",
        "autopilot",
        "recording",
    ]
    tick: int
    t_ns: int
    text: str


OnReply = Callable[[Reply | Progress], None]
"""Receives any number of Progress, then exactly one Reply."""


def matches(pattern: str, path: str) -> bool:
    """Whether a path fits a pattern: ``*`` stands for one level, ``**`` for any number of levels, also none."""
    return _fits(pattern.split("/"), path)


def matching(pattern: str, paths: Collection[str]) -> list[str]:
    """Those of many paths that fit a pattern, see `matches`: whatever the pattern is, a microsecond each."""
    given = pattern.split("/")
    words = [word for word, before in zip(given, ["", *given], strict=False) if not word == before == "**"]
    if words == ["**"]:
        return list(paths)
    deepest = max((path.count("/") for path in paths), default=0) + 1
    if len(words) - words.count("**") > deepest:
        return []
    if deepest > _SHALLOW:
        return [path for path in paths if _fits(words, path)]
    # So few words are left that trying all ways to split a path takes no time.
    fits = re.compile("".join(_LEVELS.get(word) or re.escape(word) + "/" for word in words)).fullmatch
    return [path for path in paths if fits(path + "/")]


_SHALLOW = 8
_LEVELS = {"*": "[^/]*/", "**": "(?:[^/]*/)*"}


def _fits(words: Sequence[str], path: str) -> bool:
    levels = path.split("/")
    # How many levels of the path the pattern may have used up so far. A set, as trying every split would take exponential time.
    used = {0}
    for word in words:
        if word == "**":
            used = set(range(min(used), len(levels) + 1))
        else:
            used = {k + 1 for k in used if k < len(levels) and word in ("*", levels[k])}
        if not used:
            return False
    return len(levels) in used
