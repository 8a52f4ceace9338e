"""Battery and its meter: charge, and the voltage that sags under the thrusters' current and so limits their thrust."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Meta

from uwserver.modifiers.base import Measurement, Memory, Number
from uwserver.ports import Argument, Field
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable, Settings
from uwserver.table import NonNegative, Positive, Probability

_LEAST = 0.2
"""Part of the open-circuit voltage below which it does not sag: force tables end somewhere above."""


class BatteryConfig(SensorTable, tag="battery", kw_only=True, frozen=True):
    """A battery that feeds all thrusters whose device file has `[electric]`. Its rate is that at which the voltage follows the load.

    Attributes:
        ideal: the meter is exact; the battery itself stays as it is.
        cells: in series.
        capacity_Ah: of the pack.
        charge: at the start, part of the capacity.
        cell_curve_V: open-circuit voltage of a cell, from empty to full in equal steps of charge.
        resistance_ohm: of pack and cable.
        hotel_load_W: what everything but the thrusters draws.
        current_accuracy_A: standard deviation of a constant error of the meter, drawn once a run.
        current_sigma_A, voltage_sigma_V: standard deviation of white noise of the meter.
    """

    ideal: bool = False
    cells: Annotated[int, Meta(ge=1, le=200)] = 4
    capacity_Ah: Positive = 18.0
    charge: Probability = 1.0
    cell_curve_V: Annotated[tuple[Positive, ...], Meta(min_length=2)] = (3.0, 3.7, 4.2)
    resistance_ohm: NonNegative = 0.0
    hotel_load_W: NonNegative = 0.0
    current_accuracy_A: NonNegative = 0.0
    current_sigma_A: NonNegative = 0.0
    voltage_sigma_V: NonNegative = 0.0

    def build(self, mount: Pose) -> Battery:
        """The instrument; its mount does not matter."""
        return Battery(self)


class BatterySettings(Settings, frozen=True):
    """What a lamp or a sonar that is switched on adds."""

    hotel_load_W: Annotated[float, Meta(ge=0)]


class BatteryMemory(Memory):
    """Attributes:
    charge: what is left, A s.
    energy: delivered since the start, J.
    bias: constant error of the current meter, over its standard deviation."""

    charge: Annotated[float, Meta(ge=0)] = 0.0
    energy: Annotated[float, Meta(ge=0)] = 0.0
    bias: Number = 0.0


class Battery(Sensor):
    """Charge is counted and the supply set at each reading. While the sensor is deactivated both stand still."""

    doc = "Battery: voltage under load, current, power, what is left. It sets the supply voltage of the thrusters, and stops them when it is empty."
    fields = (
        Field("voltage", "V", "at the terminals"),
        Field("current", "A", "drawn from the battery"),
        Field("power", "W", "drawn from the battery"),
        Field("energy", "J", "delivered since the start"),
        Field("charge", "1", "part of the capacity that is left"),
    )
    paces = True
    settings: BatterySettings
    memory: BatteryMemory

    def __init__(self, config: BatteryConfig) -> None:
        self._config = config
        self._meter = (0.0, 0.0, 0.0) if config.ideal else (
            config.current_accuracy_A, config.current_sigma_A, config.voltage_sigma_V,
        )  # fmt: skip
        self._capacity = config.capacity_Ah * 3600.0
        self.arguments = (
            Argument("hotel_load_W", "float", "power that everything but the thrusters draws", "W", False, minimum=0.0),
        )
        super().__init__(BatterySettings(config.hotel_load_W))

    def turn_on(self) -> BatteryMemory:
        """The charge at the start."""
        return BatteryMemory(self._config.charge * self._capacity, bias=self.rng.standard_normal())

    def valid(self, record: Memory | Settings) -> None:
        """No more charge than the battery holds."""
        super().valid(record)
        if isinstance(record, BatteryMemory) and record.charge > self._capacity:
            raise ValueError(f'"charge" is {record.charge:g} A s, the battery holds {self._capacity:g}')

    def sense(self, scope: Scope) -> Measurement:
        """Always valid; an empty battery reads 0 V."""
        m, wiring = self.memory, scope.wiring
        supply = 0.0 if wiring is None else wiring.voltage
        # Thrust follows the voltage, so that motors draw much as a resistance does: with a constant power the two would hunt each other.
        conductance = wiring.power() / (supply * supply) if wiring is not None and supply > 0.0 else 0.0
        voltage, current = self._loaded(conductance) if m.charge > 0.0 else (0.0, 0.0)
        m.charge = max(0.0, m.charge - current * self.dt)
        m.energy += voltage * current * self.dt
        if wiring is not None:
            wiring.supply(voltage)
        draws = self.rng.standard_normal(2).tolist()
        shown = current + self._meter[0] * m.bias + self._meter[1] * draws[0]
        volts = voltage + self._meter[2] * draws[1]
        return Measurement([volts, shown, volts * shown, m.energy, m.charge / self._capacity], True)

    def _loaded(self, conductance: float) -> tuple[float, float]:
        """Terminal voltage and current: V = E - I R with I = G V + P / V, G the motors' conductance (1/ohm) and P the hotel load.

        A hotel load that the battery cannot carry is cut to what it can.
        """
        e, r = self.open_circuit(self.memory.charge / self._capacity), self._config.resistance_ohm
        share, power = 1.0 + r * conductance, self.settings.hotel_load_W
        root = e * e - 4.0 * share * r * power
        if root <= 0.0:
            voltage = 0.5 * e / share
            return voltage, (e - voltage) / r
        voltage = max(_LEAST * e, 0.5 * (e + math.sqrt(root)) / share)
        return voltage, (e - voltage) / r if r > 0.0 else conductance * voltage + power / voltage

    def open_circuit(self, charge: float) -> float:
        """Voltage without load at a charge (part of the capacity), V."""
        curve = self._config.cell_curve_V
        x = charge * (len(curve) - 1)
        k = min(int(x), len(curve) - 2)
        return self._config.cells * (curve[k] + (curve[k + 1] - curve[k]) * (x - k))
