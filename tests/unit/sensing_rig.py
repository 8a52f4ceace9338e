"""What tests of sensors in a world share: kinds in plain Python, and arrays without a world in which they are read and delivered."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, structs

from uwserver.environment.earth import Earth
from uwserver.environment.water import Water
from uwserver.modifiers import Measurement, Modifier, Stream
from uwserver.modifiers.base import Memory
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.rays.raycast import OpenWater
from uwserver.ports import Argument, Field, Port, Sample
from uwserver.sensors import Sensor
from uwserver.sensors.base import SEDIMENT, Settings
from uwserver.world.sensing.sensing import Sensing
from uwserver.world.sensing.sensor_arrays import Around, SensorArrays
from uwserver.world.sensing.sensor_rows import SensorStream
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.stepping.piloting import Pilots
from uwserver.world.stepping.step_table import StepTable
from uwserver.world.stepping.stepping import Stepping

FIELDS = (Field("x", "m", "a number"),)
WORDS = (*FIELDS, Field("said", "1", "a text", type="str"))
RATE_HZ = Fraction(10**8)
"""A tick of 10 ns."""


class Gain(Settings, frozen=True):
    gain: Annotated[float, Meta(ge=0, le=10)] = 1.0


class Counted(Memory):
    n: Annotated[int, Meta(ge=0)] = 0


class Counter(Sensor):
    """Counts its readings; each is `lag` ns old, and none while `ready` is False."""

    fields = FIELDS
    arguments = (Argument("gain", "float", ""),)
    settings: Any = Gain()
    memory: Any
    ready, noisy, lag = True, False, 0

    def turn_on(self) -> Memory:
        return Counted()

    def values(self) -> list[Any]:
        noise = self.rng.standard_normal() if self.noisy else 0.0
        return [self.settings.gain * self.memory.n + noise]

    def sense(self, scope: Any) -> Measurement | None:
        if not self.ready:
            return None
        self.memory.n += 1
        return Measurement(self.values(), True, delay_ns=3, since_ns=self.lag)


class Speaker(Counter):
    """Also says which reading it is."""

    fields = WORDS

    def values(self) -> list[Any]:
        return [*super().values(), f"reading {self.memory.n}"]


class Listener(Counter):
    """Waits for what it is called by."""

    listens, called = True, False

    @property
    def wake(self) -> float | None:
        return 0.0 if self.called else None


class Repeater(Counter):
    repeats = True


class Adds(Modifier):
    """Adds 100, and drops what is asked for."""

    drops = False

    def apply(self, reading: Measurement) -> None:
        reading.values[0] += 100.0  # type: ignore[operator]
        reading.dropped = self.drops


class Shouts(Modifier):
    """Changes what is no number."""

    def apply(self, reading: Measurement) -> None:
        reading.values[1] = str(reading.values[1]).upper()


def stream(fields: tuple[Field, ...] = FIELDS) -> Stream:
    return Stream(fields, 0.1, 2)


def slot_of(
    *modifiers: Modifier,
    path: str = "rov/x",
    kind: type[Counter] = Counter,
    seed: int = 1,
    divisor: int = 1,
    noisy: bool = False,
    sides: Sequence[SensorStream] = (),
    **more: Any,
) -> SensorSlot:
    sensor = kind()
    sensor.start(seed)
    sensor.noisy = noisy
    port = Port(path, "sensor", "x", sensor.fields, "", float(RATE_HZ / divisor))
    return SensorSlot(sensor, (SensorStream(port, modifiers), *sides), 0, RATE_HZ, divisor, **more)


def side(slot_path: str, name: str, *modifiers: Modifier, ideal: bool = False) -> SensorStream:
    return SensorStream(Port(f"{slot_path}/{name}", "sensor", "x", FIELDS, "", 24.0), modifiers, ideal)


class Rig:
    """Sensors in arrays, on a body that rests at the origin; a tick takes 10 ns."""

    def __init__(self, *slots: SensorSlot, rate_hz: Fraction = RATE_HZ) -> None:
        self.slots = {slot.path: slot for slot in slots}
        hydro = Hydrodynamics([], float(1 / rate_hz))
        hydro.state = np.zeros((1, 13))
        around = Around({}, Earth(), OpenWater(), SEDIMENT)
        water = Water(1000.0, 9.81, 10.0, 101325.0, (0.0, 0.0, 0.0))
        self.sensor_arrays = SensorArrays(hydro, water, lambda: around)
        self.sensing = Sensing(self.slots, self.sensor_arrays)
        given = StepTable(hydro, water, self.sensor_arrays, self.sensing, Pilots(hydro), rate_hz)
        self.stepping = Stepping(given, lambda tick: None, lambda: False)
        self.sensors_changed()

    def sensors_changed(self) -> None:
        self.sensing.sensors_changed()
        self.sensing.set_listeners((), ())
        self.sensing.schedule()

    def make(self, n: int, samples: list[Sample]) -> None:
        """Tick n; `samples` receives those that do not stay rows."""
        self.stepping.go_on(n - 1, 1, None, samples)

    def samples(self, n: int) -> list[Sample]:
        """Delivered in tick n."""
        samples = list[Sample]()
        self.make(n, samples)
        return [*(self.sensing.take_batch() or ()), *samples]

    def tick(self, n: int) -> list[tuple[str, int]]:
        """Ports and times of them."""
        return [(sample.port, sample.t_ns) for sample in self.samples(n)]


def told(rig: Rig, n: int = 1) -> list[tuple[Any, ...]]:
    return [(s.port, s.seq, s.t_ns, s.t_sent_ns, s.value) for s in rig.samples(n)]


def gained(slot: SensorSlot, gain: float) -> None:
    slot.sensor.settings = structs.replace(slot.sensor.settings, gain=gain)
