"""Commands to the copies: arrays in, checked as a world checks one command, and written into rows of all copies at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from uwserver.actuators import Thrusters
from uwserver.actuators.force_torque import ForceTorque
from uwserver.actuators.servo import Servos
from uwserver.copies.copy import Copy
from uwserver.physics.kernel.arrays import FloatArray, IntArray, Records
from uwserver.ports import Field, Port, Refused
from uwserver.ports.checks import find, suggestion
from uwserver.world.components import ActuatorSlot
from uwserver.world.piloting import Piloting

_NEVER = np.iinfo(np.int64).max

_OfWorld = tuple[int, str, dict[str, FloatArray]]

Write = Callable[[IntArray, FloatArray], None]
"""Writes values (n, m) into rows of some copies."""


class _Helm(NamedTuple):
    """An actuator whose commands are written into rows: `write` does, and `width` is m of its values."""

    write: Write
    width: int


class _Posted(NamedTuple):
    """Commands that have not acted yet: to which port, of which copies, from which tick of each on, and the values by field."""

    port: str
    which: IntArray
    due: IntArray
    values: dict[str, FloatArray]


class Commands:
    """What was commanded to the actuators of all copies, and the watchdogs.

    Attributes:
        delay: (n) ticks from a command to its effect.
    """

    def __init__(self, copies: Sequence[Copy], rows: Records) -> None:
        """`rows` has where each copy lies (`step.rows.COPY`)."""
        from uwserver.step import many

        self._kernels, self._rows, self._copies = many, rows, copies
        self.ports: dict[str, Port] = {path: slot.port for path, slot in copies[0].world.actuators.items()}
        self._helms = {
            path: helm for path, slot in copies[0].world.actuators.items() if (helm := self._helm(slot)) is not None
        }
        self._posted: list[_Posted] = []
        n = len(copies)
        self.delay: IntArray = np.zeros(n, np.int64)
        timeouts = {path: copies[0].world.actuators[path].timeout_ticks for path in self._helms}
        self._watched = {path: ticks for path, ticks in timeouts.items() if ticks}
        self._expires = {path: np.full(n, _NEVER, np.int64) for path in self._watched}
        self._is_held = any(isinstance(part, Piloting) for part in copies[0].world.parts.values())

    def _helm(self, slot: ActuatorSlot) -> _Helm | None:
        device, kernels, rows = slot.actuator, self._kernels, self._rows
        if isinstance(device, Thrusters):
            numbers, by_force = np.array(list(device.rows.values())), int(slot.port.fields[0].name == "force_N")
            return _Helm(lambda which, u: kernels.command_thrusters(which, rows, numbers, u, by_force), len(numbers))
        if isinstance(device, Servos):
            numbers = np.array(device.rows)
            return _Helm(lambda which, value: kernels.command_servos(which, rows, numbers, value), len(numbers))
        if isinstance(device, ForceTorque):
            number = device.rows[0]
            return _Helm(lambda which, wrench: kernels.command_wrench(which, rows, number, wrench), 6)
        return None

    # -- what comes in --------------------------------------------------------------------------------------------------------------

    def post(self, path: str, value: Mapping[str, Any], which: IntArray, ticks: IntArray) -> None:
        """Check commands, and keep copies of them until they act.

        Args:
            path: of the port.
            value: by field, an array of the field's shape for all copies, or (k, *shape) for those of `which`, in its order.
            which: (k) numbers of copies.
            ticks: (n) of all copies.

        Raises:
            Refused: unknown port or field, a missing one, another shape, not finite, out of range, or held by an autopilot; nothing is kept.
        """
        find("port", path, self.ports)
        port = self.ports[path]
        names = [field.name for field in port.fields]
        for key in value:
            if key not in names:
                text = f'"{path}" has no field "{key}"{suggestion(key, names)}; it takes: {", ".join(names)}'
                raise Refused("bad_argument", text, key)
        if not value:
            raise Refused("bad_argument", f'no field given for "{path}"; it takes: {", ".join(names)}', path)
        fields = {field.name: field for field in port.fields}
        values = {name: _checked(fields[name], given, which) for name, given in value.items()}
        if path in self._helms and len(names) == 1 and names[0] not in values:
            raise Refused("bad_argument", f'"{path}" needs the field "{names[0]}"', names[0])
        if self._is_held:
            for i in which.tolist():
                refusal = self._copies[i].world.actuators[path].refusal
                if refusal:
                    raise Refused("denied", f'"{path}" of copy {i} {refusal}', path)
        self._posted.append(_Posted(path, which, ticks[which] + self.delay[which], values))

    def forget(self, which: IntArray) -> None:
        """These copies are at their start: what has not acted yet is dropped, and nobody has commanded them."""
        kept = [(posted, ~np.isin(posted.which, which)) for posted in self._posted]
        self._posted = [_picked(posted, there) for posted, there in kept if there.any()]
        for expires in self._expires.values():
            expires[which] = _NEVER

    # -- in the tick ----------------------------------------------------------------------------------------------------------------

    def apply(self, ticks: IntArray, alive: Any) -> list[_OfWorld]:
        """Let commands act whose time has come, of copies that are `alive` (n).

        Returns:
            Those that are no rows, for the worlds of the copies: number, port and values.
        """
        touched: list[_OfWorld] = []
        waiting: list[_Posted] = []
        for posted in self._posted:
            is_due = (posted.due <= ticks[posted.which]) & alive[posted.which]
            if is_due.all():
                touched += self._act(posted, ticks)
                continue
            if is_due.any():
                touched += self._act(_picked(posted, is_due), ticks)
            waiting.append(_picked(posted, ~is_due))
        self._posted = waiting
        return touched

    def _act(self, posted: _Posted, ticks: IntArray) -> list[_OfWorld]:
        path, which, _, values = posted
        helm = self._helms.get(path)
        if helm is None:
            return [(i, path, {name: value[k] for name, value in values.items()}) for k, i in enumerate(which.tolist())]
        spread = np.empty((len(self._copies), helm.width))
        parts = [
            values.get(f.name, np.zeros((len(which), *f.shape))).reshape(len(which), -1)
            for f in self.ports[path].fields
        ]
        spread[which] = np.concatenate(parts, axis=1)
        helm.write(which, spread)
        if path in self._watched:
            self._expires[path][which] = ticks[which] + self._watched[path]
        return []

    def quiet(self, ticks: IntArray, which: IntArray, going: Any) -> int:
        """For how many ticks of these copies, which are those `going` (n), no command acts and no watchdog bites."""
        waits = [(posted.due - ticks[posted.which])[going[posted.which]] for posted in self._posted]
        waits += [(expires - ticks)[which] for expires in self._expires.values()]
        return min((int(wait.min(initial=_NEVER)) for wait in waits), default=_NEVER)

    def watch(self, ticks: IntArray, which: IntArray) -> list[tuple[int, str]]:
        """Let actuators of these copies go to neutral that were left without a command for too long; copies and ports of these."""
        silent: list[tuple[int, str]] = []
        for path, expires in self._expires.items():
            over = which[expires[which] <= ticks[which]]
            for i in over.tolist():
                self._copies[i].world.actuators[path].actuator.neutral()
                silent.append((i, path))
            expires[over] = _NEVER
        return silent


def _checked(field: Field, given: Any, which: IntArray) -> FloatArray:
    """An array (k, *shape) of one's own."""
    if field.type != "float":
        raise Refused("bad_argument", f'"{field.name}" takes {field.type}, which has no array', field.name)
    try:
        array = np.array(given, np.float64)
    except (TypeError, ValueError) as error:
        raise Refused("bad_argument", f'"{field.name}" must be numbers: {error}', field.name) from None
    wanted = (len(which), *field.shape)
    if array.shape == field.shape:
        array = np.broadcast_to(array, wanted).copy()
    if array.shape != wanted:
        text = f'"{field.name}" has the shape {array.shape}: {wanted} is needed, or {field.shape} for all copies alike'
        raise Refused("bad_shape", text, field.name)
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


def _picked(posted: _Posted, there: Any) -> _Posted:
    return _Posted(
        posted.port,
        posted.which[there],
        posted.due[there],
        {name: value[there] for name, value in posted.values.items()},
    )
