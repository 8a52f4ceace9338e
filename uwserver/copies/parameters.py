"""Values that may differ from copy to copy: factors of the scenario's numbers, a current, latencies."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from uwserver.copies.copy import Copy, for_copies
from uwserver.modifiers.noise import GAUSS_MARKOV, OUTLIER, WHITE
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.ports import Refused
from uwserver.ports.checks import suggestion
from uwserver.sensors.compiled import CompiledSensor
from uwserver.units import NANOSECONDS
from uwserver.world.sensing.sensor_slot import SensorSlot


class Parameter(NamedTuple):
    """One parameter.

    Attributes:
        shape: shape of its value for one copy.
        unit, default: those of the value; nan stands for the value of the scenario.
        minimum, maximum: limits.
        doc: one sentence.
    """

    shape: tuple[int, ...]
    unit: str
    default: float
    minimum: float
    maximum: float
    doc: str


PARAMETERS: Mapping[str, Parameter] = {
    "mass": Parameter((), "1", 1.0, 0.01, 100.0, "factor of mass and inertia, and so of the weight; buoyancy stays"),
    "added_mass": Parameter((), "1", 1.0, 0.0, 100.0, "factor of the added mass"),
    "damping": Parameter((), "1", 1.0, 0.0, 100.0, "factor of the damping matrices; drag of fins and propellers stays"),
    "thruster_gain": Parameter((), "1", 1.0, 0.0, 100.0, "factor of the thrust; the power that thrusters draw stays"),
    "current": Parameter((3,), "m/s", np.nan, -100.0, 100.0, "uniform, steady part of the current in N; nan: as in the scenario"),
    "latency": Parameter((), "s", 0.0, 0.0, 60.0, "additional time from a measurement to its delivery, for all sensors except ground truth"),
    "command_latency": Parameter((), "s", 0.0, 0.0, 60.0, "time from a command to its effect, to the nearest tick"),
    "noise": Parameter((), "1", 1.0, 0.0, 1000.0, "factor of the random errors of all sensors; systematic errors stay"),
}  # fmt: skip


class Parameters:
    """The parameters of n copies.

    Attributes:
        values: (n, *shape) of each, by name.
    """

    def __init__(self, n: int, unscaled: Collection[str] = ()) -> None:
        """Begin with the defaults. `unscaled` are sensors whose random errors cannot be scaled."""
        self._unscaled = unscaled
        self.values: dict[str, FloatArray] = {
            name: np.full((n, *each.shape), each.default) for name, each in PARAMETERS.items()
        }

    def set(self, given: Mapping[str, Any], which: IntArray) -> None:
        """Set values for some copies, all or none: a number (or vector) for all of them, or (k, *shape).

        Raises:
            Refused: no such parameter, another shape, out of range, or a factor of errors that cannot be scaled.
        """
        checked = {name: _checked(name, value, which) for name, value in given.items()}
        if self._unscaled and np.any(checked.get("noise", 1.0) != 1.0):
            text = f"sensors in plain Python draw errors that cannot be scaled: {', '.join(self._unscaled)}; leave them out of sensors="
            raise Refused("denied", text, "noise")
        for name, value in checked.items():
            self.values[name][which] = value

    def is_nominal(self, i: int) -> bool:
        """Return whether copy i is as in the scenario."""
        return all(
            np.array_equal(values[i], np.full(PARAMETERS[name].shape, PARAMETERS[name].default), equal_nan=True)
            for name, values in self.values.items()
        )

    def apply(self, copy: Copy, i: int) -> None:
        """Change a copy to its values. It must be at its start, and as in the scenario."""
        values = {name: value[i] for name, value in self.values.items()}
        world = copy.world
        _change_bodies(copy, float(values["mass"]), float(values["added_mass"]), float(values["damping"]))
        world.hydro.thrusters["per_force"] *= values["thruster_gain"]
        if not np.isnan(values["current"]).any():
            north, east, down = values["current"].tolist()
            world.set_current((north, east, down))
        for slot in world.sensors.values():
            if "/truth/" not in slot.path:
                world.sensor_arrays.heads.rows["latency_ns"][slot.head] += round(float(values["latency"]) * NANOSECONDS)
                _scale_errors(copy, slot, float(values["noise"]))


def _checked(name: str, given: Any, which: IntArray) -> FloatArray:
    parameter = PARAMETERS.get(name)
    if parameter is None:
        text = f'no parameter "{name}"{suggestion(name, PARAMETERS)}; there are: {", ".join(PARAMETERS)}'
        raise Refused("bad_argument", text, name)
    value = for_copies(name, given, parameter.shape, which)
    wrong = ~((value >= parameter.minimum) & (value <= parameter.maximum))
    if np.isnan(parameter.default):
        wrong &= ~np.isnan(value)
    if wrong.any():
        k = int(np.argwhere(wrong)[0][0])
        text = f'"{name}" of copy {int(which[k])} is {value[k]}: {parameter.minimum:g} to {parameter.maximum:g} {parameter.unit}'
        raise Refused("out_of_range", text, name)
    return value


def _change_bodies(copy: Copy, mass: float, added_mass: float, damping: float) -> None:
    hydro = copy.world.hydro
    if (mass, added_mass, damping) == (1.0, 1.0, 1.0):
        hydro.params = copy.params
        return
    hydro.params = tuple(
        replace(
            body,
            M_RB=mass * body.M_RB,
            weight=mass * body.weight,
            M_A=added_mass * body.M_A,
            D_L=damping * body.D_L,
            D_Q=damping * body.D_Q,
            D_S=damping * body.D_S,
        )
        for body in copy.params
    )
    for row, body in enumerate(hydro.params):
        hydro.change(row, body)


def _scale_errors(copy: Copy, slot: SensorSlot, factor: float) -> None:
    """Scale the random errors of a sensor: those of its kind (`CompiledSensor.random`), and those of its modifiers."""
    sensor, sensor_arrays = slot.sensor, copy.world.sensor_arrays
    if factor == 1.0 or not isinstance(sensor, CompiledSensor):
        return
    row = sensor.rows.rows[sensor.row]
    for path in sensor.random:
        *outer, name = path.split(".")
        record = row
        for part in outer:
            record = record[part]
        record[name] *= factor
    operations, numbers = sensor_arrays.operations.rows, sensor_arrays.numbers.rows
    for k in slot.stream_numbers:
        stream = sensor_arrays.streams.rows[k]
        for op in operations[stream["operation_first"] : stream["operation_first"] + stream["operation_count"]]:
            code = int(op["code"])
            if code in (WHITE, GAUSS_MARKOV):
                op["p"][: 2 if code == WHITE else 1] *= factor
            elif code == OUTLIER:
                op["p"][1] *= factor
            if code == GAUSS_MARKOV:
                # The first number of the memory is the time of the last reading.
                numbers[op["memory"] + 1 : op["memory"] + 1 + op["count"]] *= factor
