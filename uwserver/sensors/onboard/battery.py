"""Battery and its meter. The voltage sags under the current of the thrusters, and so limits their thrust."""

from __future__ import annotations

import math
from typing import Annotated, Any

from msgspec import Meta

from uwserver.modifiers.base import Memory, Number
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, normals
from uwserver.ports import Argument, Field
from uwserver.sensors.base import Pose, SensorTable, Settings
from uwserver.sensors.compiled import SensorKernel, TableSensor, loop, power, record, supply, supply_voltage
from uwserver.table import NonNegative, Positive, Probability

MOST_POINTS = 101
"""Most points of the curve of a cell."""
_LEAST = 0.2
"""The voltage never sags below this part of the open-circuit voltage. Force tables end above it."""


class BatteryConfig(SensorTable, tag="battery", kw_only=True, frozen=True):
    """A battery that feeds all thrusters whose device file has `[electric]`. The voltage follows the load at the rate of the sensor.

    Attributes:
        ideal: the meter is exact; the battery itself does not change.
        cells: number of cells in series.
        capacity_Ah: capacity of the pack.
        charge: charge at the start, as a part of the capacity.
        cell_curve_V: open-circuit voltage of a cell, from empty to full in equal steps of charge.
        resistance_ohm: resistance of pack and cable.
        hotel_load_W: power that everything except the thrusters draws.
        current_accuracy_A: standard deviation of a constant error of the meter, drawn once a run.
        current_sigma_A, voltage_sigma_V: standard deviation of white noise of the meter.
    """

    message = "BatteryState"
    ideal: bool = False
    cells: Annotated[int, Meta(ge=1, le=200)] = 4
    capacity_Ah: Positive = 18.0
    charge: Probability = 1.0
    cell_curve_V: Annotated[tuple[Positive, ...], Meta(min_length=2, max_length=MOST_POINTS)] = (3.0, 3.7, 4.2)
    resistance_ohm: NonNegative = 0.0
    hotel_load_W: NonNegative = 0.0
    current_accuracy_A: NonNegative = 0.0
    current_sigma_A: NonNegative = 0.0
    voltage_sigma_V: NonNegative = 0.0

    def build(self, mount: Pose) -> Battery:
        """Return the sensor; its mount does not matter."""
        return Battery(self)


class BatterySettings(Settings, frozen=True):
    """The load of everything except the thrusters, for example after a lamp or a sonar is switched on."""

    hotel_load_W: Annotated[float, Meta(ge=0)]


class BatteryMemory(Memory):
    """Attributes:
    charge: charge that is left, A s.
    energy: energy delivered since the start, J.
    bias: constant error of the current meter, in units of its standard deviation."""

    charge: Annotated[float, Meta(ge=0)] = 0.0
    energy: Annotated[float, Meta(ge=0)] = 0.0
    bias: Number = 0.0


_RECORD = record(
    [
        ("cells", "f8"), ("capacity", "f8"), ("resistance", "f8"), ("hotel", "f8"), ("accuracy", "f8"), ("sigma_A", "f8"), ("sigma_V", "f8"),
        ("points", "i8"), ("curve", "f8", (MOST_POINTS,)),
    ],
    [("charge", "f8"), ("energy", "f8"), ("bias", "f8")],
)  # fmt: skip


@compiled
def open_circuit(row: Any, charge: float) -> float:
    """Return the voltage without load at a charge (part of the capacity), V."""
    x = charge * (row.points - 1)
    k = min(int(x), row.points - 2)
    return float(row.cells * (row.curve[k] + (row.curve[k + 1] - row.curve[k]) * (x - k)))


@compiled
def _loaded(row: Any, conductance: float) -> tuple[float, float]:
    """Return terminal voltage and current: V = E - I R with I = G V + P / V, where G is the motors' conductance (1/ohm) and P the hotel load.

    A hotel load that is too large for the battery is cut to the largest possible one.
    """
    e, r = open_circuit(row, row.m.charge / row.capacity), row.resistance
    share, load = 1.0 + r * conductance, row.hotel
    root = e * e - 4.0 * share * r * load
    if root <= 0.0:
        voltage = 0.5 * e / share
        return voltage, (e - voltage) / r
    voltage = max(_LEAST * e, 0.5 * (e + math.sqrt(root)) / share)
    return voltage, (e - voltage) / r if r > 0.0 else conductance * voltage + load / voltage


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Discharge the battery, set the supply of the thrusters, and write the reading. It is always valid; an empty battery has 0 V."""
    m, before = row.m, supply_voltage(head, surroundings)
    # Thrust follows the voltage, so motors draw current much as a resistor does. With constant power, voltage and load would oscillate.
    conductance = power(head, surroundings) / (before * before) if before > 0.0 else 0.0
    voltage, current = 0.0, 0.0
    if m.charge > 0.0:
        voltage, current = _loaded(row, conductance)
    m.charge = max(0.0, m.charge - current * head.dt)
    m.energy += voltage * current * head.dt
    if head.shadow == 0:
        supply(head, surroundings, voltage)
    shown, volts = current, voltage
    if head.exact == 0:
        a, b = normals(head.key, head.number, SAMPLE, 0)
        shown, volts = current + row.accuracy * m.bias + row.sigma_A * a, voltage + row.sigma_V * b
    out[0], out[1], out[2], out[3], out[4] = volts, shown, volts * shown, m.energy, m.charge / row.capacity


class Battery(TableSensor[BatteryConfig]):
    """Each reading counts the charge and sets the supply. While the sensor is deactivated, neither changes."""

    doc = "Battery: voltage under load, current, power, and charge. It sets the supply voltage of the thrusters, and stops them when it is empty."
    fields = (
        Field("voltage", "V", "voltage at the terminals"),
        Field("current", "A", "current drawn from the battery"),
        Field("power", "W", "power drawn from the battery"),
        Field("energy", "J", "energy delivered since the start"),
        Field("charge", "1", "part of the capacity that is left"),
    )
    kernel = SensorKernel(_RECORD, loop(measure), acts=True)
    supplies = True
    random = ("sigma_A", "sigma_V")
    memory_type = BatteryMemory
    settings: BatterySettings

    def __init__(self, config: BatteryConfig) -> None:
        self._capacity = config.capacity_Ah * 3600.0
        self.arguments = (
            Argument(
                "hotel_load_W", "float", "power that everything except the thrusters draws", "W", False, minimum=0.0
            ),
        )
        super().__init__(Pose(), config, BatterySettings(config.hotel_load_W))

    def fill(self, row: Any) -> None:
        c = self._config
        row["cells"], row["capacity"], row["resistance"] = c.cells, self._capacity, c.resistance_ohm
        row["hotel"], row["accuracy"] = self.settings.hotel_load_W, c.current_accuracy_A
        row["sigma_A"], row["sigma_V"] = c.current_sigma_A, c.voltage_sigma_V
        row["points"] = len(c.cell_curve_V)
        row["curve"][: len(c.cell_curve_V)] = c.cell_curve_V

    def turn_on_row(self, memory: Any) -> None:
        """Write the charge at the start, and draw the error of the meter."""
        memory["charge"], memory["bias"] = self._config.charge * self._capacity, self.drawn(1)[0]

    def valid(self, record: Memory | Settings) -> None:
        """Refuse more charge than the battery holds."""
        super().valid(record)
        if isinstance(record, BatteryMemory) and record.charge > self._capacity:
            raise ValueError(f'"charge" is {record.charge:g} A s, the battery holds {self._capacity:g}')
