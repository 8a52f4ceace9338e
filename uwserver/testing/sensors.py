"""The conformance suite for sensors.

A sensor is a function of the world, of a memory that can be saved, and of a random stream, and its values fit its fields.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import msgspec

from uwserver.environment.water import Water
from uwserver.frames import Vec3, quat_from_rpy
from uwserver.modifiers import (
    Bias,
    Drift,
    GaussMarkov,
    Measurement,
    Memory,
    Modifier,
    ModifierConfig,
    Outlier,
    Quantise,
    Scale,
    Stream,
    WhiteNoise,
)
from uwserver.ports import Buffer, Field, Value
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable
from uwserver.sensors.job import finished
from uwserver.testing.fake_geometry import FakeGeometry, Plane

MOUNT = Pose((0.3, -0.2, 0.1), quat_from_rpy(0.4, -0.3, 2.0))
"""A mount with a lever arm and an attitude, so that a sensor that forgets one of them fails."""
WATER = Water(density=1025.0, gravity=9.81, temperature=12.0, atmospheric_pressure=101325.0, current=(0.3, -0.1, 0.05))
BOTTOM = FakeGeometry([Plane((0.0, 0.0, 30.0), (0.0, 0.0, -1.0))])
"""A flat bottom at a depth of 30 m."""
_PLAIN = (bool, int, float, str, bytes, type(None))
_RUN, _STEP_NS = 20, 100_000_000
_TYPES: dict[str, type | tuple[type, ...]] = {
    "float": (float, int),
    "int": int,
    "bool": bool,
    "str": str,
    "bytes": Buffer,
    "buffer": Buffer,
}


def scopes() -> list[Scope]:
    """Return ordinary and extreme instants: singular attitudes, above the surface, in the deepest sea, far away, very fast."""
    positions: tuple[Vec3, ...] = ((0.0, 0.0, 5.0), (0.0, 0.0, -3.0), (0.0, 0.0, 0.0), (1e6, -1e6, 11000.0))
    angles = (
        (0.0, 0.0, 0.0),
        (0.1, 0.2, 0.3),
        (math.pi, 0.0, 0.0),
        (0.0, math.pi / 2, 0.0),
        (0.0, -math.pi / 2, math.pi),
    )
    rates: tuple[Vec3, ...] = ((0.0, 0.0, 0.0), (1.0, -2.0, 0.5), (300.0, 300.0, -300.0))
    made = []
    for number, (p, rpy, v) in enumerate(itertools.product(positions, angles, rates)):
        q, w = quat_from_rpy(*rpy), (v[2] / 10, v[0] / 10, v[1] / 10)
        made.append(
            Scope(number * 4_000_000, p, q, v, w, WATER, (0.1, 0.2, -0.3, 0.01, -0.02, 0.03), (1.0,) * 6, BOTTOM)
        )
    return made


def check_sensor(config: SensorTable, *, mount: Pose = MOUNT, instants: Sequence[Scope] | None = None) -> None:
    """Build a sensor from its configuration, and check its contract.

    Args:
        config: a configuration with `build(mount)`.
        mount: where the sensor sits.
        instants: instants at which it measures; default `scopes()`.

    Raises:
        AssertionError: the text names the sensor and the field, and says what the contract requires.
    """
    kind = str(config.__struct_config__.tag)
    build = getattr(config, "build", None)
    assert build is not None, f'sensor "{kind}": the config needs build(mount), which makes the sensor'
    sensor: Sensor = build(mount)
    check_fields(kind, sensor.fields)
    assert sensor.doc, f'sensor "{kind}": doc is empty'
    asked = scopes() if instants is None else instants
    for scope in asked:
        _check_instant(kind, sensor, build(mount), scope)
    for scope in asked[:: max(1, len(asked) // 4)]:
        _check_memory(f'sensor "{kind}"', config, mount, scope)
    for field in sensor.fields:
        if field.type == "float" and not field.is_rotation:
            _check_modifiers(kind, sensor, field, asked)


def check_fields(kind: str, fields: Sequence[Field]) -> None:
    """Check that names are unique, and that every field has a unit and a sentence, and every vector a frame.

    A list of things, which has a plural name, needs no frame.
    """
    names = [field.name for field in fields]
    assert names, f'sensor "{kind}" has no fields'
    assert len(set(names)) == len(names), f'sensor "{kind}": two fields have one name: {names}'
    for field in fields:
        assert field.unit, f'sensor "{kind}", field "{field.name}": no unit ("1" where there is none)'
        assert field.doc, f'sensor "{kind}", field "{field.name}": no doc'
        if field.type == "float" and field.shape in ((3,), (4,)) and not field.name.endswith("s"):
            assert field.frame, (
                f'sensor "{kind}", field "{field.name}": a vector needs a frame (N, B, S, or "NS" of a rotation)'
            )


def check_values(where: str, fields: Sequence[Field], values: Sequence[Value], valid: bool) -> None:
    """Check that number, shape and type of the values fit the fields, and that the numbers of a valid reading are finite."""
    assert len(values) == len(fields), f"{where}: {len(values)} values for {len(fields)} fields"
    for field, value in zip(fields, values, strict=True):
        at = f'{where}, field "{field.name}"'
        if field.shape and value is not None:
            assert isinstance(value, tuple), f"{at}: {type(value).__name__}, an array is a tuple"
            assert len(value) == field.size, f"{at}: {len(value)} components, the shape has {field.size}"
        else:
            assert not isinstance(value, tuple), f"{at}: a tuple, the shape says scalar"
        for component in value if isinstance(value, tuple) else (value,):
            if component is None:
                continue
            fits = isinstance(component, _TYPES[field.type]) and (
                field.type == "bool" or not isinstance(component, bool)
            )
            assert fits, f"{at}: {component!r} is a {type(component).__name__}, declared {field.type}"
            if isinstance(component, Buffer):
                assert field.holds(component), f"{at}: {component!r}, declared {field.form}"
            if valid and isinstance(component, float):
                assert math.isfinite(component), f"{at}: {component!r} in a valid reading"


def _check_instant(kind: str, sensor: Sensor, twin: Sensor, scope: Scope) -> None:
    where = f'sensor "{kind}" at p_NB = {scope.p_NB}, q_NB = {scope.q_NB}, v = {scope.v_NB_B}'
    before = replace(scope, water=replace(scope.water))
    valid, values = measured(sensor, scope)
    check_values(where, sensor.fields, values, valid)
    assert scope == before, f"{where}: measure changed its scope"
    assert isinstance(valid, bool), f"{where}: the first result tells whether it could measure"
    assert measured(sensor, scope) == (valid, values), (
        f"{where}: asked again it gives other values, it must be stateless"
    )
    assert measured(twin, scope) == (valid, values), f"{where}: a second sensor of the same config gives other values"
    assert measured(sensor, scope)[1] is not values, (
        f"{where}: it hands out one list twice, the modifiers would change it"
    )


def measured(sensor: Sensor, scope: Scope) -> tuple[bool, list[Value]]:
    """Return what a sensor measures that was just switched on, with the same random numbers each time."""
    sensor.start(0)
    return sensor.measure(scope)


def kept(kind: str, component: Sensor | Modifier) -> Memory:
    """Return the memory of a component as it comes back from a file.

    Raises:
        AssertionError: it is no record of plain values, or is outside its own limits.
    """
    memory = component.memory
    assert isinstance(memory, Memory), f"{kind}: memory is a uwserver.modifiers.Memory, not {memory!r}"
    assert _is_plain(memory), f"{kind}: its memory holds more than plain values and tuples of them: {memory!r}"
    try:
        record = msgspec.msgpack.decode(msgspec.msgpack.encode(memory), type=type(memory))
        component.valid(record)
    except ValueError as error:
        raise AssertionError(f"{kind}: its memory leaves its own limits: {memory!r}: {error}") from None
    assert repr(record) == repr(memory), f"{kind}: its memory comes back from a file as another: {memory!r}, {record!r}"
    return record


def _is_plain(value: object) -> bool:
    if isinstance(value, msgspec.Struct):
        return all(map(_is_plain, msgspec.structs.astuple(value)))
    return all(map(_is_plain, value)) if type(value) is tuple else type(value) in _PLAIN


def _check_memory(kind: str, config: SensorTable, mount: Pose, scope: Scope) -> None:
    """Check that a sensor with the memory and settings of another run of the same scenario continues that run."""
    build = config.build  # type: ignore[attr-defined]  # `check_sensor` has found it
    sensor: Sensor = build(mount)
    sensor.start(1)
    _run(sensor, scope, range(_RUN))
    record = kept(kind, sensor)
    later = _run(sensor, scope, range(_RUN, 2 * _RUN))
    other: Sensor = build(mount)
    other.start(1)
    other.memory, other.settings = record, sensor.settings
    assert _run(other, scope, range(_RUN, 2 * _RUN)) == later, (
        f"{kind}: with memory and settings of another run it does not go on as that: all that it remembers belongs in memory"
    )


def _run(sensor: Sensor, scope: Scope, steps: range) -> list[Measurement | None]:
    readings = []
    for k in steps:
        sensor.begin(k)
        reading = sensor.sense(replace(scope, t_ns=scope.t_ns + k * _STEP_NS))
        readings.append(None if reading is None else finished(reading, sensor.fields))
    return readings


def _modifiers(field: Field) -> tuple[ModifierConfig, ...]:
    name = field.name
    return (
        WhiteNoise(field=name, sigma=0.5),
        GaussMarkov(field=name, sigma=0.5, tau_s=10.0),
        Drift(field=name, density=0.5),
        Outlier(field=name, probability=1.0, sigma=5.0),
        Bias(field=name, value=0.25),
        Scale(field=name, factor=1.5),
        Quantise(field=name, step=1e-3),
    )


def _present(value: Value) -> bool:
    return any(v is not None for v in value) if isinstance(value, tuple) else value is not None


def _check_modifiers(kind: str, sensor: Sensor, field: Field, instants: Sequence[Scope]) -> None:
    index = sensor.fields.index(field)
    fine = [s for s in instants if measured(sensor, s)[0]]
    assert fine, f'sensor "{kind}" is valid at none of the instants: give some at which it can measure'
    scope = next((s for s in fine if _present(measured(sensor, s)[1][index])), None)
    # A valid reading may leave a field empty, because nothing is touched or gives an echo.
    if scope is None:
        return
    for modifier in _modifiers(field):
        where = f'sensor "{kind}", {type(modifier).__name__} of "{field.name}"'
        valid, values = measured(sensor, scope)
        before = list(values)
        reading = Measurement(values, valid)
        modifier.build(Stream(sensor.fields, 0.01, 1)).apply(reading)
        after = list(reading.values)
        check_values(where, sensor.fields, after, reading.valid)
        # A step and a factor leave a zero as it is.
        if not isinstance(modifier, (Quantise, Scale)):
            assert after[index] != before[index], f"{where}: the value did not change"
        del before[index], after[index]
        assert after == before, f"{where}: another field changed too"
