"""The outputs of the actuators of an external body, as its log or its peer gives them. Viewers show them; they exert no force."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, Protocol

import numpy as np
from msgspec import Meta, Struct

from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.ports import ACHIEVED_FULL, Field, Items
from uwserver.units import NANOSECONDS

HELD_S = 2.0
"""A value holds for so long if no newer one comes. MAVLink sends outputs at 0.5 Hz and faster."""
PULSE_MIDDLE_S, PULSE_HALF_S = 1500e-6, 400e-6
"""Length of a servo's pulse at rest, and the difference to full: 1100 to 1900 us, as in ArduPilot's `SERVOn_MIN` and `SERVOn_MAX`."""
Kind = Literal["part", "angle", "pulse"]
"""A value is a fraction of the full output (-1..1), an angle (rad), or the length of a servo's pulse (s)."""
Bytes = np.ndarray[tuple[int, ...], np.dtype[np.int8]]


@dataclass(frozen=True, eq=False)
class Motion:
    """The outputs of actuators at instants of a track's clock.

    Attributes:
        t_ns: (n,) int64, strictly rising.
        names: (k) names of actuators in the vehicle's file, or numbers from 1 in the order of that file.
        kinds: (k) kinds of the values.
        values: (n, k); NaN where the log says nothing.
    """

    t_ns: IntArray
    names: tuple[str, ...]
    kinds: tuple[Kind, ...]
    values: FloatArray


class ShownActuator(NamedTuple):
    """An actuator of the vehicle's file that viewers show: its name, and for a fin the angle at full output (rad), else 0."""

    name: str
    limit: float = 0.0


class Moving(Protocol):
    """Gives the outputs of a body's actuators."""

    def achieved(self, t_ns: int) -> Bytes:
        """Return the outputs at a simulation time, each -127..127, as in `SceneState.achieved`."""


class RecordedMotion:
    """Outputs from a log that was read before the run.

    Args:
        shown: actuators in the order of the view.
        motion: outputs in the log, in simulation time; None if it has none.
    """

    def __init__(self, shown: Sequence[ShownActuator], motion: Motion | None) -> None:
        self._still = np.zeros(len(shown), np.int8)
        self._t_ns: IntArray = np.zeros(0, np.int64)
        self._rows: Bytes = np.zeros((0, len(shown)), np.int8)
        if motion is not None:
            self._t_ns, self._rows = motion.t_ns, _rows(shown, motion)

    def achieved(self, t_ns: int) -> Bytes:
        """See `Moving`."""
        k = int(np.searchsorted(self._t_ns, t_ns, side="right")) - 1
        if k < 0 or t_ns - int(self._t_ns[k]) > HELD_S * NANOSECONDS:
            return self._still
        row: Bytes = self._rows[k]
        return row


class NewestOutputs(Struct, frozen=True):
    """The newest outputs: simulation time at which they came (ns; -1 before the first), and the value of each actuator, -1..1."""

    t_ns: Annotated[int, Meta(ge=-1, le=2**62)] = -1
    u: tuple[Annotated[float, Meta(ge=-1.0, le=1.0)], ...] = ()


class LiveMotion:
    """Outputs that come as commands to an actuator's port.

    Attributes:
        memory: the newest outputs.
    """

    doc = "Sets the outputs of its thrusters, fins and propellers that viewers show; they exert no force. A value holds for 2 s."

    def __init__(self, shown: Sequence[ShownActuator], now_ns: Callable[[], int]) -> None:
        """Take the actuators that are shown, at least one, and a function that gives the simulation time, ns."""
        names = ", ".join(each.name for each in shown)
        doc = f"fraction of the full output of each, -1 to 1: {names}"
        self.fields = (Field("u", "1", doc, shape=(len(shown),), minimum=-1.0, maximum=1.0),)
        self._still, self._now_ns = np.zeros(len(shown), np.int8), now_ns
        self.memory = NewestOutputs()

    def apply(self, value: Items) -> None:
        """Take over a checked command."""
        if value[0] is not None:
            u: Any = value[0]
            self.memory = NewestOutputs(self._now_ns(), tuple(float(part) for part in u))

    def neutral(self) -> None:
        """Do nothing: the outputs exert no force."""

    def achieved(self, t_ns: int) -> Bytes:
        """See `Moving`."""
        newest = self.memory
        is_known = newest.t_ns >= 0 and t_ns - newest.t_ns <= HELD_S * NANOSECONDS and len(newest.u) == len(self._still)
        return _bytes(np.array(newest.u)) if is_known else self._still


def _rows(shown: Sequence[ShownActuator], motion: Motion) -> Bytes:
    """Return the outputs (n, m) of the actuators of the view; 0 for an actuator that the log does not have."""
    parts = np.zeros((len(motion.t_ns), len(shown)))
    names = {each.name: k for k, each in enumerate(shown)} | {str(k + 1): k for k in range(len(shown))}
    for name, kind, column in zip(motion.names, motion.kinds, motion.values.T, strict=True):
        place = names.get(name)
        if place is None:
            continue  # an output without an actuator, such as that of a lamp
        if kind == "pulse":  # A servo that is switched off gets no pulse.
            column = np.where(column > 0.0, (column - PULSE_MIDDLE_S) / PULSE_HALF_S, 0.0)
        elif kind == "angle" and shown[place].limit > 0.0:
            column = column / shown[place].limit
        parts[:, place] = column
    return _bytes(parts)


def _bytes(parts: FloatArray) -> Bytes:
    clipped = np.clip(np.nan_to_num(parts, nan=0.0), -1.0, 1.0)
    return np.rint(ACHIEVED_FULL * clipped).astype(np.int8)
