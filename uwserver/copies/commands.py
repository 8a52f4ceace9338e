"""Commands to the copies: arrays that are checked as a world checks one command, and written into the rows of all copies at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uwserver.actuators import Thrusters
from uwserver.actuators.force_torque import ForceTorque
from uwserver.actuators.servo import Servos
from uwserver.copies.copy import Copy, for_copies
from uwserver.physics.kernel.arrays import FloatArray, IntArray, Records
from uwserver.ports import Field, Port, Refused
from uwserver.ports.checks import check_names, find
from uwserver.world.stepping.commands import ActuatorSlot
from uwserver.world.stepping.piloting import Piloting

_NEVER = np.iinfo(np.int64).max

_WorldCommand = tuple[int, str, dict[str, FloatArray]]

Write = Callable[[IntArray, FloatArray], None]
"""Writes values (n, m) into rows of some copies."""


class _RowWriter(NamedTuple):
    """An actuator whose commands are written into rows: `write` does it, and `width` is the number m of its values."""

    write: Write
    width: int


class _Posted(NamedTuple):
    """Commands that have not acted yet: the port, the copies, the tick of each copy at which they act, and the values by field."""

    port: str
    which: IntArray
    due: IntArray
    values: dict[str, FloatArray]


class Commands:
    """The commands to the actuators of all copies, and their watchdogs.

    Attributes:
        ports: the actuators of a copy, by path.
        delay: (n) ticks from a command to its effect.
        written: (n) whether commands were written into the rows of a copy. The caller clears it.
    """

    def __init__(self, copies: Sequence[Copy], rows: Records) -> None:
        """Begin without commands. `rows` has the addresses of each copy's arrays (`step.rows.COPY`)."""
        from uwserver.step import many

        self._kernels, self._rows, self._copies = many, rows, copies
        self.ports: dict[str, Port] = {path: slot.port for path, slot in copies[0].world.actuators.items()}
        self._writers = {
            path: writer
            for path, slot in copies[0].world.actuators.items()
            if (writer := self._writer_of(slot)) is not None
        }
        self._posted: list[_Posted] = []
        n = len(copies)
        self.delay: IntArray = np.zeros(n, np.int64)
        self.written: NDArray[np.bool_] = np.zeros(n, np.bool_)
        timeouts = {path: copies[0].world.actuators[path].timeout_ticks for path in self._writers}
        self._watched = {path: ticks for path, ticks in timeouts.items() if ticks}
        self._expires = {path: np.full(n, _NEVER, np.int64) for path in self._watched}
        self._is_held = any(isinstance(part, Piloting) for part in copies[0].world.parts.values())

    def _writer_of(self, slot: ActuatorSlot) -> _RowWriter | None:
        device, kernels, rows = slot.actuator, self._kernels, self._rows
        if isinstance(device, Thrusters):
            numbers, by_force = np.array(list(device.rows.values())), int(slot.port.fields[0].name == "force_N")
            return _RowWriter(
                lambda which, u: kernels.command_thrusters(which, rows, numbers, u, by_force), len(numbers)
            )
        if isinstance(device, Servos):
            numbers = np.array(device.rows)
            return _RowWriter(lambda which, value: kernels.command_servos(which, rows, numbers, value), len(numbers))
        if isinstance(device, ForceTorque):
            number = device.rows[0]
            return _RowWriter(lambda which, wrench: kernels.command_wrench(which, rows, number, wrench), 6)
        return None

    # -- commands from the caller --------------------------------------------------------------------------------------------------------

    def post(self, path: str, value: Mapping[str, Any], which: IntArray, ticks: IntArray) -> None:
        """Check commands, and keep them until they act.

        Args:
            path: path of the port.
            value: by field, an array of the field's shape for all copies, or (k, *shape) for the copies `which`, in their order.
            which: (k) numbers of copies.
            ticks: (n) of all copies.

        Raises:
            Refused: unknown port or field, a missing one, another shape, not finite, out of range, or held by an autopilot; nothing is
                kept.
        """
        find("port", path, self.ports)
        port = self.ports[path]
        check_names(port, value)
        fields = {field.name: field for field in port.fields}
        values = {name: _checked(fields[name], given, which) for name, given in value.items()}
        if self._is_held:
            for i in which.tolist():
                refusal = self._copies[i].world.actuators[path].refusal
                if refusal:
                    raise Refused("denied", f'"{path}" of copy {i} {refusal}', path)
        self._posted.append(_Posted(path, which, ticks[which] + self.delay[which], values))

    def forget(self, which: IntArray) -> None:
        """Drop the commands to these copies that have not acted yet, and stop their watchdogs, as they are at their start."""
        kept = [(posted, ~np.isin(posted.which, which)) for posted in self._posted]
        self._posted = [_selected(posted, there) for posted, there in kept if there.any()]
        for expires in self._expires.values():
            expires[which] = _NEVER

    # -- in the tick ----------------------------------------------------------------------------------------------------------------

    def apply(self, ticks: IntArray, alive: Any) -> list[_WorldCommand]:
        """Let the commands act that are due, for copies that are `alive` (n).

        Returns:
            Number, port and values of commands that cannot be written into rows: the worlds of the copies have to take them.
        """
        touched: list[_WorldCommand] = []
        waiting: list[_Posted] = []
        for posted in self._posted:
            is_due = (posted.due <= ticks[posted.which]) & alive[posted.which]
            if is_due.all():
                touched += self._act(posted, ticks)
                continue
            if is_due.any():
                touched += self._act(_selected(posted, is_due), ticks)
            waiting.append(_selected(posted, ~is_due))
        self._posted = waiting
        return touched

    def _act(self, posted: _Posted, ticks: IntArray) -> list[_WorldCommand]:
        path, which, _, values = posted
        writer = self._writers.get(path)
        if writer is None:
            return [(i, path, {name: value[k] for name, value in values.items()}) for k, i in enumerate(which.tolist())]
        spread = np.empty((len(self._copies), writer.width))
        parts = [
            values.get(f.name, np.zeros((len(which), *f.shape))).reshape(len(which), -1)
            for f in self.ports[path].fields
        ]
        spread[which] = np.concatenate(parts, axis=1)
        writer.write(which, spread)
        self.written[which] = True
        if path in self._watched:
            self._expires[path][which] = ticks[which] + self._watched[path]
        return []

    def quiet(self, ticks: IntArray, which: IntArray, going: Any) -> int:
        """Return for how many ticks no command acts and no watchdog expires in these copies. `going` (n) is a mask of the same copies."""
        waits = [(posted.due - ticks[posted.which])[going[posted.which]] for posted in self._posted]
        waits += [(expires - ticks)[which] for expires in self._expires.values()]
        return min((int(wait.min(initial=_NEVER)) for wait in waits), default=_NEVER)

    def watch(self, ticks: IntArray, which: IntArray) -> list[tuple[int, str]]:
        """Set the actuators of these copies to neutral that had no command for too long. Returns the copies and ports."""
        silent: list[tuple[int, str]] = []
        for path, expires in self._expires.items():
            over = which[expires[which] <= ticks[which]]
            for i in over.tolist():
                self._copies[i].world.actuators[path].actuator.neutral()
                silent.append((i, path))
            expires[over] = _NEVER
        return silent


def _checked(field: Field, given: Any, which: IntArray) -> FloatArray:
    """Return the values of a field as a new array (k, *shape)."""
    if field.type != "float":
        raise Refused("bad_argument", f'"{field.name}" takes {field.type}, which has no array', field.name)
    array = for_copies(field.name, given, field.shape, which)
    for wrong, code, what in (
        (~np.isfinite(array), "not_finite", "not finite"),
        (array < (-np.inf if field.minimum is None else field.minimum), "out_of_range", f"below {field.minimum}"),
        (array > (np.inf if field.maximum is None else field.maximum), "out_of_range", f"above {field.maximum}"),
    ):
        if wrong.any():
            k = int(np.argwhere(wrong)[0][0])
            text = f'"{field.name}" of copy {int(which[k])} is {what} {field.unit}'.rstrip()
            raise Refused(code, text, field.name)  # type: ignore[arg-type]  # two of its codes
    return array


def _selected(posted: _Posted, there: Any) -> _Posted:
    return _Posted(
        posted.port,
        posted.which[there],
        posted.due[there],
        {name: value[there] for name, value in posted.values.items()},
    )
