"""Ports, and the values that pass through them between all parts of uwserver.

All types are immutable. Values are SI, angles radians, times integer nanoseconds of simulation time since the start of the scenario.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Literal

from msgspec import UNSET, Struct, UnsetType

from uwserver.ports.buffer import LARGEST, Buffer, Layout

Scalar = float | int | bool | str | None
"""One component of a field."""
Value = Scalar | Buffer | tuple[Scalar, ...]
"""Value of one field: a scalar, the row-major components of an array, or a buffer; None if the sensor has no value."""
Item = tuple[float, ...] | str | Buffer
"""One field of a checked command. Numbers are a tuple of floats, even a single one; bytes are a buffer without type."""
Items = tuple[Item | None, ...]
"""One entry for each field of an actuator's port; None if the sender left the field out."""
MOST_BYTES = 1 << 16
"""Longest text (UTF-8) or bytes in a command, bytes, if its field gives no lower limit."""
Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]
"""Anything that a service takes or returns."""


class Field(Struct, frozen=True, gc=False):
    """One named value of a port.

    Attributes:
        name: on every wire.
        unit: SI unit; "1" if there is none.
        doc: one sentence.
        frame: frame of the components of a vector (N, B, S), or two frames of a rotation ("NB"); "" if none applies.
        shape: () for a scalar, (3,) for a vector.
        type: type of each component; values of "bytes" and "buffer" are a `Buffer` and have the shape ().
        minimum, maximum: limits of each component; a command outside them is refused.
        buffer: type and shape of a buffer.
        max_bytes: longest text (UTF-8), bytes or buffer in a command; absent for 64 KiB, or 1 MiB for a buffer.
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
        """Whether the value is a quaternion w x y z between the two frames of `frame`."""
        return self.shape == (4,) and len(self.frame) == 2

    @property
    def is_packed(self) -> bool:
        """Whether the values are bytes or buffers."""
        return self.type in ("bytes", "buffer")

    def holds(self, buffer: Buffer) -> bool:
        """Return whether a buffer, or plain bytes, may be the value."""
        return self.type == ("buffer" if buffer.dtype else "bytes") and (not self.buffer or self.buffer.fits(buffer))

    @property
    def form(self) -> str:
        """Form of a value for people: ``scalar``, ``3``, ``bytes`` or ``uint8 nx512``."""
        if self.is_packed:
            return str(self.buffer or "bytes")
        return "x".join(map(str, self.shape)) or "scalar"

    @property
    def most_bytes(self) -> int:
        """Longest text, bytes or buffer in a command, bytes."""
        return self.max_bytes or (LARGEST if self.type == "buffer" else MOST_BYTES)

    @property
    def size(self) -> int:
        """Number of components."""
        return math.prod(self.shape)

    @property
    def axes(self) -> str:
        """Names of the components of a vector or a quaternion, a letter each: xyz, or wxyz; "" if they have only numbers."""
        if self.is_rotation:
            return "wxyz"
        return "xyz" if self.frame and self.shape[-1:] == (3,) else ""

    def part(self, k: int) -> str:
        """Return the name of component k for the legend of a plot: an axis, or its number from 1."""
        return self.axes[k] if self.size == len(self.axes) else str(k + 1)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components, in row-major order, as columns of a table: ``depth``, ``f_S_x``, ``q_NB_w``, ``beam_ranges_0``.

        The rows of a matrix are numbered, ``velocities_S_4_x``; those of a covariance have the axes of its columns, ``covariance_S_x_y``.
        """
        names, axes = [self.name], self.axes
        for depth, size in enumerate(self.shape, start=1):
            named = axes and (depth == len(self.shape) or (self.name.startswith("covariance") and size == len(axes)))
            names = [f"{name}_{part}" for name in names for part in (axes if named else range(size))]
        return tuple(names)


class Propulsor(Struct, frozen=True):
    """The thruster behind one component of a command: its name, its place (m) and the direction of its force at a positive command, in B."""

    name: str
    r_B: tuple[float, float, float]
    axis_B: tuple[float, float, float]


class Port(Struct, frozen=True, gc=False):
    """A typed endpoint that gives samples or takes commands.

    Attributes:
        path: ``<vehicle>/<component>``.
        direction: sensor (samples out) or actuator (commands in).
        kind: the component's kind in the scenario file.
        fields: in the order of every value tuple.
        doc: one or two sentences.
        rate_hz: sample rate; None for actuators.
        timeout_s: time without a command after which an actuator goes to neutral; None for never.
        propulsors: propulsors of a thruster actuator, in the order of its components; absent for other ports.
        message: plain name of the standard message that the fields fit ("Imu", "Range"); absent if there is none.
    """

    path: str
    direction: Literal["sensor", "actuator"]
    kind: str
    fields: tuple[Field, ...]
    doc: str
    rate_hz: float | None = None
    timeout_s: float | None = None
    propulsors: tuple[Propulsor, ...] | UnsetType = UNSET
    message: str | UnsetType = UNSET

    @property
    def is_truth(self) -> bool:
        """Whether the port gives ground truth."""
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
    """Description of a request that gets a reply.

    Attributes:
        path: ``world/<name>`` or ``<vehicle>/<component>/<name>``.
        doc: one or two sentences.
        arguments: arguments of a call.
        reads_only: whether it is answered at once from the last published state; other services run at the start of the next tick.
        long_running: whether it may reply many ticks later, with progress reports, and can be cancelled.
    """

    path: str
    doc: str
    arguments: tuple[Argument, ...] = ()
    reads_only: bool = False
    long_running: bool = False


class Sample(Struct, frozen=True, gc=False):
    """One output of a sensor.

    Attributes:
        port: path of the port.
        seq: number of the sample at this sensor, from 0.
        t_ns: simulation time of the measurement, by the clock of the device if that drifts.
        t_sent_ns: simulation time at which the device delivers it.
        valid: False if the sensor could not measure.
        value: one entry for each field of the port, in its order.
    """

    port: str
    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool
    value: tuple[Value, ...]


class Command(Struct, frozen=True):
    """A command to an actuator; `value` has one checked entry for each field of the port.

    `source` names the sender (adapter and client), so that two senders to one actuator are noticed.
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
    """Why a request was refused: a code, a text that says what to do, and the argument, field, port or service concerned."""

    code: ErrorCode
    text: str
    where: str = ""


class Refused(Exception):
    """Raised to refuse a request; the sender gets its `fault`."""

    def __init__(self, code: ErrorCode, text: str, where: str = "") -> None:
        super().__init__(text)
        self.fault = Fault(code, text, where)

    def __reduce__(self) -> tuple[type[Refused], tuple[ErrorCode, str, str]]:
        return type(self), (self.fault.code, self.fault.text, self.fault.where)


class Reply(Struct, frozen=True):
    """The final answer to a command or call: the tick at whose start it was carried out, and its result or fault."""

    tick: int
    t_ns: int
    result: Json = None
    fault: Fault | None = None
    conflict: bool = False


class Progress(Struct, frozen=True):
    """Progress of a long-running call, 0 to 1."""

    fraction: float
    t_ns: int


class Event(Struct, frozen=True):
    """Something that every client is told."""

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
        "held",
        "recording",
    ]
    tick: int
    t_ns: int
    text: str


OnReply = Callable[[Reply | Progress], None]
"""Receives any number of Progress, then exactly one Reply."""


def matches(pattern: str, path: str) -> bool:
    """Return whether a path fits a pattern: ``*`` stands for one level, ``**`` for any number of levels, or none."""
    return _fits(pattern.split("/"), path)


def matching(pattern: str, paths: Collection[str]) -> list[str]:
    """Return the paths that fit a pattern, see `matches`. It takes about a microsecond for each path, whatever the pattern is."""
    given = pattern.split("/")
    words = [word for word, before in zip(given, ["", *given], strict=False) if not word == before == "**"]
    if words == ["**"]:
        return list(paths)
    deepest = max((path.count("/") for path in paths), default=0) + 1
    if len(words) - words.count("**") > deepest:
        return []
    if deepest > _SHALLOW:
        return [path for path in paths if _fits(words, path)]
    # The regular expression backtracks, which is quick as pattern and paths have few levels here.
    fits = re.compile("".join(_LEVELS.get(word) or re.escape(word) + "/" for word in words)).fullmatch
    return [path for path in paths if fits(path + "/")]


_SHALLOW = 8
_LEVELS = {"*": "[^/]*/", "**": "(?:[^/]*/)*"}


def _fits(words: Sequence[str], path: str) -> bool:
    levels = path.split("/")
    # The possible numbers of path levels that the words so far have used. Trying one split after the other would take exponential time.
    used = {0}
    for word in words:
        if word == "**":
            used = set(range(min(used), len(levels) + 1))
        else:
            used = {k + 1 for k in used if k < len(levels) and word in ("*", levels[k])}
        if not used:
            return False
    return len(levels) in used
