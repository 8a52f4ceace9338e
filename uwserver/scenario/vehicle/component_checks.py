"""Checks the sensors of a vehicle with their modifiers, and the actuators that have a wrench of their own, such as those of extensions.

Components of extensions are built once on trial, because code of a user may fail in any way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import get_args

from msgspec import Struct, msgpack

from uwserver.modifiers import Modifier, ModifierConfig, Stream
from uwserver.physics.bodies import Hydrodynamics
from uwserver.ports import Field
from uwserver.ports.messages import STANDARD
from uwserver.scenario.files.convert import Node, Report, check_known
from uwserver.scenario.files.errors import KeyPath, not_built
from uwserver.scenario.vehicle.body import body_params, own_actuators, own_rows
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.scenario.world.checks import check_rate
from uwserver.scenario.world.earth import WMM_YEARS, instant, year_of
from uwserver.scenario.world.tables import Environment, WorldTable
from uwserver.sensors import Pose, Sensor, SensorConfig, SensorTable, Traits
from uwserver.world.state.services import SENSOR_SERVICES


def enabled(vehicle: Node, table: str) -> tuple[str, ...]:
    """Return the names of the enabled sensors or actuators of a vehicle; one that has errors counts as enabled."""
    parts = vehicle.at(table).parts.items()
    return tuple(name for name, part in parts if part.at("enabled").value is not False)


def check_sensor(vehicle: Node, name: str, sensor: SensorConfig, world: WorldTable | None, report: Report) -> None:
    """Check the rate, mount, members and modifiers of a sensor, and that a sensor of an extension can be built.

    Args:
        vehicle: the merged vehicle file, as a `VehicleFile`.
        name, sensor: those of the vehicle.
        world: world of the scenario; None if it has errors.
        report: called for errors.
    """
    path: KeyPath = ("sensors", name)
    traits = traits_of(sensor, report, path)
    if world is not None:
        check_rate(sensor.rate_hz, world.rate_hz, (*path, "rate_hz"), report)
        if traits.needs_origin:
            _check_origin(world, path, report)
    _check_named(vehicle, traits, path, report)
    if isinstance(sensor.mount, str):
        check_known(sensor.mount, vehicle.names("mounts"), "mount", (*path, "mount"), report)
        for key in ("position_frd_m", "rpy_deg"):
            if key in vehicle.at("sensors", name).parts:
                report(
                    (*path, key),
                    f'the mount "{sensor.mount}" sets the place of this sensor: remove either mount or {key}',
                )
    modifiers: dict[KeyPath, ModifierConfig] = {(*path, "modifiers", key): m for key, m in sensor.modifiers.items()}
    for stream_name, stream in sensor.streams.items():
        place: KeyPath = (*path, "streams", stream_name)
        if stream_name in SENSOR_SERVICES:
            report(place, f'a service of the sensor is named "{stream_name}": choose another name for the stream')
        modifiers |= {(*place, "modifiers", key): m for key, m in stream.modifiers.items()}
    # A shipped kind can always be built, and is built with the world. It is built here only if modifiers need to know its fields.
    if not modifiers and type(sensor) in get_args(SensorConfig):
        return
    ports = _fields(sensor, path, report)
    if ports is not None:
        for place, modifier in modifiers.items():
            _check_modifier(sensor, ports, modifier, place, report)


def _check_origin(world: WorldTable, path: KeyPath, report: Report) -> None:
    if world.origin is None:
        report(path, "needs to know where on the Earth N lies: give origin_lat_deg and origin_lon_deg in [world]")
    try:
        year = year_of(instant(world.epoch_utc))
    except ValueError:
        return  # reported elsewhere
    first, last = WMM_YEARS
    if not first <= year < last:
        report(path, f"the magnetic model holds from {first} to {last - 1}, but epoch_utc in [world] is in {int(year)}")


def traits_of(sensor: SensorTable, report: Report = lambda *_: None, path: KeyPath = ()) -> Traits:
    """Return what a sensor declares; no traits, after a report, if it is of an extension whose code fails."""
    try:
        traits: object = sensor.traits()
        if not isinstance(traits, Traits):
            raise TypeError("traits() must return a uwserver.sensors.Traits")
        if type(sensor) not in get_args(SensorConfig):
            _check_stages(traits.stages)
    except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
        report(path, not_built(sensor, error))
        return Traits()
    return traits


def _check_stages(stages: tuple[str, ...]) -> None:
    """Raise ValueError for a stage of the compiled code that does not exist."""
    if not stages:
        return
    # The import loads numba, which takes half a second. Shipped kinds and most extensions need no check.
    from uwserver.world.builds import STAGES

    unknown = sorted(set(stages) - set(STAGES))
    if unknown:
        raise ValueError(f"there is no stage {', '.join(unknown)}; there are: {', '.join(STAGES)}")


def _check_named(vehicle: Node, traits: Traits, path: KeyPath, report: Report) -> None:
    """Check the thrusters and sensors that a table names. Each sensor may be named once, and none may name sensors itself."""
    present = [name for name in enabled(vehicle, "sensors") if name != path[-1]]
    named: list[str] = []
    for key, table, name in traits.names:
        place: KeyPath = (*path, *key)
        if table == "thrusters":
            check_known(name, vehicle.names(table), "thruster", place, report)
        if table != "sensors":
            continue
        check_known(name, present, "sensor", place, report)
        member = vehicle.at(table, name).value if name in present else None
        if member is not None and any(other.table == table for other in traits_of(member).names):
            report(place, f'"{name}" is a compound sensor too: name its members instead')
        if name in named:
            report(place, f'"{name}" is named twice')
        named.append(name)


def _fields(sensor: SensorConfig, path: KeyPath, report: Report) -> tuple[Field, ...] | None:
    """Return the fields of the sensor's port; None after a report, which only an extension's kind can cause."""
    try:
        built: object = sensor.build(Pose())
        if not isinstance(built, Sensor):
            raise TypeError("it must derive from uwserver.sensors.Sensor or IdealSensor")
        check_fields(built.fields, sensor.message)
    except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
        report(path, not_built(sensor, error))
        return None
    return built.fields


def check_fields(fields: object, message: str) -> None:
    """Raise ValueError unless these can be the fields of a port that fits a standard message."""
    if not isinstance(fields, tuple) or not fields or not all(isinstance(field, Field) for field in fields):
        raise ValueError("its fields must be a tuple of uwserver.ports.Field")
    if len({field.name for field in fields}) < len(fields):
        raise ValueError("two of its fields have the same name")
    missing = [name for name in STANDARD.get(message, ()) if name not in {field.name for field in fields}]
    if missing:
        raise ValueError(f'message = "{message}" needs a field "{missing[0]}"')


def _check_modifier(
    sensor: SensorConfig, fields: tuple[Field, ...], modifier: ModifierConfig, path: KeyPath, report: Report
) -> None:
    stream = Stream(fields, 1.0 / sensor.rate_hz, 0)
    target = getattr(modifier, "field", None)
    try:
        if isinstance(target, str):
            stream.index(target)
    except ValueError as error:
        report((*path, "field"), str(error))
        return
    try:
        if not isinstance(modifier.build(stream), Modifier):
            raise TypeError("it must derive from uwserver.modifiers.Modifier")
    except ValueError as error:
        report(path, str(error))
    except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
        report(path, not_built(modifier, error))


# -- actuators --------------------------------------------------------------------------------------------------------------------------


def check_actuators(
    vehicle: VehicleFile, devices: Mapping[str, ThrusterDevice], environment: Environment, report: Report
) -> None:
    """Check that they can be built, go to neutral, and can be saved.

    Args:
        vehicle, devices, environment: without errors.
        report: called for errors.
    """
    own = own_actuators(vehicle)
    if not own:
        return
    bodies = own_rows(Hydrodynamics([body_params(vehicle, devices, environment)], 1.0), vehicle, 0)
    for name, config in own.items():
        try:
            actuator = config.build(bodies[name])
            check_fields(actuator.fields, config.message)
            check_memory(getattr(actuator, "memory", None))
            actuator.neutral()
        except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
            report(("actuators", name), not_built(config, error))


def check_memory(memory: object) -> None:
    """Raise ValueError unless the memory is None, or a Struct that can be encoded and decoded again."""
    if memory is None:
        return
    if not isinstance(memory, Struct) or msgpack.decode(msgpack.encode(memory), type=type(memory)) != memory:
        raise ValueError(f"its memory must be a msgspec Struct of plain typed values, not {memory!r}")
