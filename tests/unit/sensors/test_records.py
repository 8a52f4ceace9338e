"""Memory and settings of every sensor and modifier as records of a file: whatever their types and `valid` let pass does no harm later."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, get_args

import msgspec
import numpy as np
import pytest
from msgspec import inspect

from uwserver.adapter import installed_adapters
from uwserver.modifiers import GaussMarkov, Measurement, Memory, Misalignment, Modifier, ModifierConfig, Stream
from uwserver.modifiers.base import NOTHING
from uwserver.modifiers.misalignment import Turn
from uwserver.modifiers.noise import Correlated
from uwserver.ports import Field, Value
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.sensors import BatteryConfig, DvlConfig, LblConfig, Pose, Scope, Sensor, Settings
from uwserver.sensors.acoustic.doppler.dvl import DvlMemory, DvlSettings
from uwserver.sensors.acoustic.positioning.interrogation import Beacon, Exchange
from uwserver.sensors.job import PendingMeasurement
from uwserver.sensors.onboard.battery import BatteryMemory
from uwserver.world import World
from uwserver.world.sensing.sensor_slot import SensorSlot

FIELDS = (Field("s", "m", "a scalar"), Field("x", "m", "a vector", "S", (3,)), Field("ok", "1", "a flag", type="bool"))
KEYS: dict[str, dict[str, Any]] = {
    "gauss_markov": {"sigma": 1.0, "tau_s": 0.1},
    "random_walk": {"density": 1.0},
    "drift": {"density": 1.0},
    "outlier": {"probability": 0.5, "sigma": 1.0},
    "quantise": {"step": 0.25},
    "saturate": {"maximum": 0.2},
    "delay": {"latency_s": 0.01, "jitter_s": 0.02},
    "dropout": {"probability": 0.5},
    "reorder": {"probability": 0.5},
    "misalignment": {"fields": ("x",), "sigma_deg": 1.0},
    "clock_drift": {"walk_sqrts": 1e-3},
}


@pytest.fixture(scope="module")
def everything() -> World:
    world = build(load("one_of_everything", adapters=installed_adapters()))
    world.step(50)
    return world


def modifier(config: Any) -> Modifier:
    built: Modifier = config.build(Stream(FIELDS, 0.01, 1))
    return built


def one_of(rng: np.random.Generator, options: Sequence[Any]) -> Any:
    return options[int(rng.integers(len(options)))]


def drawn(kind: inspect.Type, rng: np.random.Generator) -> Any:
    """A value of a type within its limits, often at one of them; in the form of a decoded file."""
    match kind:
        case inspect.FloatType():
            low = -1e300 if kind.ge is None and kind.gt is None else max(x for x in (kind.ge, kind.gt) if x is not None)
            high = 1e300 if kind.le is None else kind.le
            size = 10.0 ** float(rng.uniform(-12, 12))
            value = one_of(rng, (low, high, 0.0, 1.0, float(rng.random()), size, -size, float(rng.uniform(-1e3, 1e3))))
            value = min(max(value, low), high)
            return math.nextafter(value, math.inf) if kind.gt is not None and value <= kind.gt else value
        case inspect.IntType():
            low, high = -(2**63) if kind.ge is None else kind.ge, 2**63 - 1 if kind.le is None else kind.le
            return min(max(one_of(rng, (low, high, 0, 1, 2, int(rng.integers(-4, 9)))), low), high)
        case inspect.BoolType():
            return bool(rng.random() < 0.5)
        case inspect.StrType():
            return one_of(rng, ("", "low", "x" * (kind.max_length or 0)))
        case inspect.LiteralType():
            return one_of(rng, kind.values)
        case inspect.BytesType():
            return bytes(rng.integers(0, 256, one_of(rng, (0, 1, 40)), np.uint8))
        case inspect.NoneType():
            return None
        case inspect.UnionType():
            return drawn(one_of(rng, kind.types), rng)
        case inspect.TupleType():
            return [drawn(item, rng) for item in kind.item_types]
        case inspect.VarTupleType():
            return [drawn(kind.item_type, rng) for _ in range(one_of(rng, (0, 1, 3, 3, 3)))]
        case inspect.StructType():
            return {field.encode_name: drawn(field.type, rng) for field in kind.fields}
    raise NotImplementedError(kind)


def records(present: Memory | Settings, component: Any, rng: np.random.Generator, wanted: int) -> list[Any]:
    """Records of a kind that a file could hold and `valid` lets pass: some wild, some the present one with one field changed."""
    found: list[Any] = []
    kind = type(present)
    about = inspect.type_info(kind)
    for _ in range(60 * wanted):
        raw = drawn(about, rng)
        if rng.random() < 0.8 and raw:
            raw = msgspec.to_builtins(present) | dict([one_of(rng, sorted(raw.items()))])
        record = msgspec.msgpack.decode(msgspec.msgpack.encode(raw), type=kind)
        try:
            component.valid(record)
        except ValueError:
            continue
        found.append(record)
        if len(found) == wanted:
            break
    assert found
    return found


def harmless(reading: Measurement | None) -> None:
    if reading is None:
        return
    if isinstance(reading, PendingMeasurement):
        reading.job.run()
    for number in (reading.delay_ns, reading.stamp_ns, reading.since_ns):
        assert abs(number) < 2**63, reading
    for value in reading.values:
        for component in value if isinstance(value, tuple) else (value,):
            assert not isinstance(component, float) or math.isfinite(component), reading
            assert not isinstance(component, int) or abs(component) < 2**63, reading


def scope_of(world: World, slot: SensorSlot) -> Scope:
    x = world.hydro.state[slot.row].tolist()
    return Scope(
        world.t_ns, tuple(x[0:3]), tuple(x[3:7]), tuple(x[7:10]), tuple(x[10:13]), world.water,  # type: ignore[arg-type]
        geometry=world.geometry, vehicles=world.vehicles, earth=world.earth,
        wiring=slot.wiring, lambert=world.lambert,
        sight=world.sight, row=slot.row,
    )  # fmt: skip


@pytest.mark.parametrize(("most", "pictures"), [(5, 1), pytest.param(20, 6, marks=pytest.mark.slow)])
def test_a_sensor_goes_on_from_any_record_that_passes(everything, most, pictures):
    """So many records of each, and of those that tell pictures."""
    world, rng = everything, np.random.default_rng(6)
    remember = 0
    for path, slot in world.sensors.items():
        if slot.port.kind == "autopilot":
            continue  # its memory is the autopilot's, and nan says what it does not know
        sensor = slot.sensor
        memory, settings = sensor.memory, sensor.settings
        remember += sensor.memory is not NOTHING
        scope = scope_of(world, slot)
        several = pictures if any(field.size > 100 for field in sensor.fields) else most
        for record in records(memory, sensor, rng, several):
            for kept in records(settings, sensor, rng, 2):
                sensor.memory, sensor.settings = msgspec.structs.replace(record), kept
                for k in (1, 2, 40, 4000, 4001):
                    try:
                        harmless(sensor.sense(replace(scope, t_ns=scope.t_ns + k * 10_000_000)))
                        assert sensor.wake is None or math.isfinite(sensor.wake)
                    except Exception as error:
                        raise AssertionError(f"{path}: {record}, {kept}: {error!r}") from error
        sensor.memory, sensor.settings = memory, settings
    assert remember > 10


@pytest.mark.parametrize("kind", get_args(ModifierConfig), ids=lambda kind: str(kind.__struct_config__.tag))
def test_a_modifier_goes_on_from_any_record_that_passes(kind):
    target = {"field": "x"} if "field" in kind.__struct_fields__ else {}
    config = kind(**target, **KEYS.get(kind.__struct_config__.tag, {}))
    rng = np.random.default_rng(6)
    built = modifier(config)
    for record in records(built.memory, built, rng, 60):
        built.memory = msgspec.structs.replace(record)
        for k in (1, 2, 3000):
            values: list[Value] = [7.0, (0.1, -0.2, 0.3), True]
            reading = Measurement(values, True, t_ns=k * 10_000_000)
            built.apply(reading)
            harmless(reading)


DVL = DvlConfig(rate_hz=5, range_modes=((0.1, 5.0, 8.0), (4.0, 50.0, 4.0))).build(Pose())


@pytest.mark.parametrize(
    ("component", "record", "told"),
    [
        (BatteryConfig(rate_hz=1, capacity_Ah=1.0).build(Pose()), BatteryMemory(charge=3601.0), "the battery holds 3600"),
        (DVL, DvlMemory(mode=2), "the device has 2 range modes"),
        (DVL, DvlSettings(50.0, 2, "both", 0.0), "the device has 2 range modes"),
        (LblConfig(rate_hz=1, beacons={"b": Beacon(vehicle="b")}).build(Pose()), Exchange(beacon=1), "there are 1 beacons"),
        (modifier(Misalignment(fields=("x",))), Turn((0.0, 0.0, 0.0, 0.0)), '"q" is no rotation'),
        (modifier(GaussMarkov(field="x", sigma=1.0, tau_s=1.0)), Correlated(error=(1.0,)), '"error" has 1 numbers, here it needs 3'),
    ],
)  # fmt: skip
def test_what_types_cannot_show_is_refused(component: Sensor | Modifier, record: Memory | Settings, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        component.valid(record)


def test_types_refuse_what_is_no_number():
    for spoiled in ({"ready": math.nan}, {"ready": 1e300}, {"mode": -1}, {"mode": 0.5}, {"scale": -math.inf}):
        with pytest.raises(msgspec.ValidationError):
            msgspec.msgpack.decode(msgspec.msgpack.encode(spoiled), type=DvlMemory)
