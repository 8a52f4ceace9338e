"""Checks of one sensor of a vehicle, and of its errors."""

from __future__ import annotations

from typing import get_args

from uwserver.modifiers import Modifier, ModifierConfig, Stream
from uwserver.ports import Field
from uwserver.scenario.files.convert import Report
from uwserver.scenario.files.errors import KeyPath, suggestion
from uwserver.scenario.files.wording import not_built
from uwserver.scenario.vehicle.appendage_checks import check_member
from uwserver.scenario.vehicle.assembly import Draft
from uwserver.scenario.world.checks import check_rate
from uwserver.scenario.world.epoch import instant, year_of
from uwserver.scenario.world.magnetic import WMM_YEARS
from uwserver.scenario.world.tables import WorldTable
from uwserver.sensors import CompoundConfig, Pose, RpmConfig, Sensor, SensorConfig
from uwserver.world.services import SENSOR_SERVICES


def check_mount(draft: Draft, mount: str, path: KeyPath, report: Report) -> None:
    """Whether the vehicle has a mount that something at this key sits on."""
    mounts = draft.names("mounts")
    if mount not in mounts:
        report(path, f'no mount "{mount}"{suggestion(mount, mounts, "; there are: ")}')


def check_sensor(draft: Draft, name: str, sensor: SensorConfig, world: WorldTable | None, report: Report) -> None:
    """Rate, mount, parts and errors of a sensor; whether it can be built, where it is of an extension.

    Args:
        draft: the merged vehicle.
        name, sensor: of the vehicle.
        world: of the scenario; None where it has faults.
        report: takes in faults.
    """
    path: KeyPath = ("sensors", name)
    if world is not None:
        check_rate(sensor.rate_hz, world.rate_hz, (*path, "rate_hz"), report)
        if getattr(sensor, "needs_origin", False):
            _check_origin(world, path, report)
    _check_parts(draft, sensor, path, report)
    if isinstance(sensor.mount, str):
        check_mount(draft, sensor.mount, (*path, "mount"), report)
        for key in ("position_frd_m", "rpy_deg"):
            if key in draft.tree.at("sensors", name).parts:
                text = f'a sensor on the mount "{sensor.mount}" has no {key} of its own: remove one of the two'
                report((*path, key), text)
    modifiers: dict[KeyPath, ModifierConfig] = {(*path, "modifiers", key): m for key, m in sensor.modifiers.items()}
    for stream_name, stream in sensor.streams.items():
        place: KeyPath = (*path, "streams", stream_name)
        if stream_name in SENSOR_SERVICES:
            report(place, f'"{stream_name}" is the name of a service of the sensor: choose another name')
        modifiers |= {(*place, "modifiers", key): m for key, m in stream.modifiers.items()}
    # A shipped kind can always be built, and is where the world is: only what its errors need to know of it is asked for now.
    if not modifiers and type(sensor) in get_args(SensorConfig):
        return
    ports = _fields(sensor, path, report)
    if ports is not None:
        for place, modifier in modifiers.items():
            _check_modifier(sensor, ports, modifier, place, report)


def _check_origin(world: WorldTable, path: KeyPath, report: Report) -> None:
    if world.origin is None:
        report(path, "needs to know where N lies: give [world] origin_lat_deg and origin_lon_deg")
    try:
        year = year_of(instant(world.epoch_utc))
    except ValueError:
        return  # told elsewhere
    first, last = WMM_YEARS
    if not first <= year < last:
        text = f"the magnetic model holds from {first} to {last - 1}, [world] epoch_utc is in {int(year)}"
        report(path, text)


def _check_parts(draft: Draft, sensor: SensorConfig, path: KeyPath, report: Report) -> None:
    if isinstance(sensor, RpmConfig):
        for k, member in enumerate(sensor.members):
            check_member(member, draft.names("thrusters"), "thruster", (*path, "members", k), report)
    if not isinstance(sensor, CompoundConfig):
        return
    present = [name for name in draft.enabled("sensors") if name != path[-1]]
    for k, member in enumerate(sensor.members):
        place: KeyPath = (*path, "members", k)
        if member not in present:
            report(place, f'no sensor "{member}"{suggestion(member, present, "; there are: ")}')
        elif isinstance(draft.sensors.get(member), CompoundConfig):
            report(place, f'"{member}" is a compound sensor itself')
        if member in sensor.members[:k]:
            report(place, f'"{member}" is named twice')


def _fields(sensor: SensorConfig, path: KeyPath, report: Report) -> tuple[Field, ...] | None:
    """Of the sensor's port; None after a report, which only a kind of an extension needs."""
    try:
        built: object = sensor.build(Pose())
        if not isinstance(built, Sensor):
            raise TypeError("it must derive from uwserver.sensors.Sensor or IdealSensor")
        check_fields(built.fields)
    except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
        report(path, not_built(sensor, error))
        return None
    return built.fields


def check_fields(fields: object) -> None:
    """ValueError unless these can be the fields of a port."""
    if not isinstance(fields, tuple) or not fields or not all(isinstance(field, Field) for field in fields):
        raise ValueError("its fields must be a tuple of uwserver.ports.Field")
    if len({field.name for field in fields}) < len(fields):
        raise ValueError("two of its fields have one name")


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
