"""Checks the device files of thrusters and sensors.

A device file of a sensor (a profile) holds the values of a named device, with sources, for keys that the user does not give.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from msgspec import UNSET, field

from uwserver.physics.kernel.layout import TABLE_SIZE, TABLE_VOLTAGES
from uwserver.scenario.files.convert import NO_MORE, Converter, More, Node, Report, convert, kinds_of
from uwserver.scenario.files.documents import merged, named
from uwserver.scenario.files.errors import KeyPath, dotted
from uwserver.scenario.vehicle.appendage_tables import Sourced
from uwserver.scenario.vehicle.body import lag
from uwserver.scenario.vehicle.tables import ForceCurve, LagTable, MeasuredCurve, Shape
from uwserver.sensors import SensorConfig
from uwserver.table import Name, Table

_PROVENANCE = Sourced.__struct_fields__


class SensorDevice(Table, kw_only=True, frozen=True):
    """A device file of a sensor.

    Attributes:
        kind: kind of the sensor.
        title: maker and product.
        properties: groups of keys of the sensor's table; each group has `source` and `status` for its values.
    """

    schema: Literal[1]
    kind: Name
    name: Name
    title: Name
    properties: dict[str, Any] = field(default_factory=dict)


def check_profile(raw: Mapping[str, Any], report: Report, more: More = NO_MORE) -> dict[str, Any] | None:
    """Return the keys of the sensor's table that a device file gives, with its `kind`; None after at least one report."""
    device: SensorDevice | None = convert(raw, SensorDevice, (), report)
    if device is None:
        return None
    keys: dict[str, Any] = {"kind": device.kind}
    places: dict[str, KeyPath] = {"kind": ("kind",)}
    fine = True
    for name, group in device.properties.items():
        path: KeyPath = ("properties", name)
        given = group if isinstance(group, dict) else {}
        provenance = {key: given[key] for key in _PROVENANCE if key in given}
        fine &= convert(provenance, Sourced, path, report) is not None
        for key, value in given.items():
            if key in _PROVENANCE:
                continue
            if isinstance(value, dict) and isinstance(keys.get(key), dict):
                keys[key] = merged(keys[key], value)  # one table may be given in parts, each with its own source
                continue
            if key in keys:
                report((*path, key), f'"{key}" is given twice, also at {dotted(places[key])}: remove one of them')
                fine = False
            keys.setdefault(key, value)
            places.setdefault(key, (*path, key))

    def placed(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
        place = path if at is None else at
        report((*places[str(place[0])], *place[1:]) if place and place[0] in places else (), text)

    # No device file has the keys that depend on the use of the sensor. Those of the example make it possible to check the file alone.
    kinds = kinds_of(SensorConfig, more)
    example = kinds[device.kind].example if device.kind in kinds else {}
    sensor = Converter(placed, more).kind({"rate_hz": 1.0, **example, **keys}, kinds, ()).value
    return keys if fine and sensor is not None else None


def fill_in_profiles(
    raw: Mapping[str, Any], keys_of: Callable[[str, KeyPath], Mapping[str, Any] | None], report: Report
) -> None:
    """Give each sensor with a `profile` in a scenario or vehicle file the keys of that device too. Its own keys win.

    Args:
        raw: the tables of the file, which are changed.
        keys_of: returns the keys of a device (see `check_profile`) by its name and the place that names it; None after a report.
        report: called for errors of the file.
    """
    for table, path in _sensor_tables(raw):
        for name, sensor in table.items():
            reference = sensor.get("profile") if isinstance(sensor, dict) else None
            if not isinstance(reference, str) or not reference:
                continue
            here: KeyPath = (*path, name, "profile")
            keys = keys_of(reference, here)
            if keys is not None and sensor.get("kind", keys["kind"]) != keys["kind"]:  # an override may leave it out
                report(
                    here,
                    f'"{reference}" is a device of kind "{keys["kind"]}", but this sensor is of kind "{sensor["kind"]}"',
                )
            elif keys is not None:
                table[name] = merged(keys, sensor)


def _sensor_tables(raw: Mapping[str, Any]) -> Iterator[tuple[dict[str, Any], KeyPath]]:
    yield named(raw, "sensors"), ("sensors",)
    for name, entry in named(raw, "vehicles").items():
        if isinstance(entry, dict):
            yield named(entry, "sensors"), ("vehicles", name, "sensors")
            yield named(named(entry, "override"), "sensors"), ("vehicles", name, "override", "sensors")


# -- thrusters --------------------------------------------------------------------------------------------------------------------------


def check_device(device: Node, report: Report) -> None:
    """Check the force curves, their shape, and the lag; values that have errors already are skipped."""
    shape: Shape | None = device.at("shape").value
    if shape is not None and not sum(shape.coefficients) > 0.0:
        report(("shape", "coefficients"), "their sum, which is the force at full command, must be greater than 0")
    if "shape" not in device.parts and device.at("curves").parts:
        report(
            ("curves",),
            "curves need the table [shape], the force between dead band and limits; or give measured points under [tables]",
        )
    _check_voltages(device, report)
    tables: dict[str, MeasuredCurve] = device.at("tables").values()
    for name, measured in tables.items():
        _check_points(("tables", name), measured, report)
    curves: dict[str, ForceCurve] = device.at("curves").values()
    for name, curve in curves.items():
        low, high = curve.dead_band
        if not -1.0 < low <= 0.0 <= high < 1.0:
            report(("curves", name, "dead_band"), f"({low:g}, {high:g}) must lie inside (-1, 1) and hold 0")
    table: LagTable | None = device.at("lag").value
    if table is not None:
        _check_lag(table, report)


def _check_voltages(device: Node, report: Report) -> None:
    """Check that there are as many curves as the kernel has room for, each for another voltage."""
    count = sum(len(device.at(part).parts) for part in ("tables", "curves"))
    if not 1 <= count <= TABLE_VOLTAGES:
        report(
            ("curves",),
            f"a device needs 1 to {TABLE_VOLTAGES} force curves (under [curves] or [tables]), found {count}",
        )
    voltages: dict[float, tuple[str, str]] = {}
    for part in ("tables", "curves"):
        good: dict[str, MeasuredCurve | ForceCurve] = device.at(part).values()
        for name, curve in good.items():
            other = voltages.setdefault(curve.voltage_V, (part, name))
            if other != (part, name):
                report(
                    (part, name, "voltage_V"),
                    f'the curve "{other[1]}" is for {curve.voltage_V:g} V too: remove one of the two',
                )


def _check_points(where: tuple[str, ...], table: MeasuredCurve, report: Report) -> None:
    u, force = table.commands, table.forces_N
    if not 2 <= len(u) <= TABLE_SIZE or len(u) != len(force):
        report(
            where,
            f"needs 2 to {TABLE_SIZE} commands and a force for each, found {len(u)} commands and {len(force)} forces",
        )
        return
    if (u[0], u[-1]) != (-1.0, 1.0) or any(b <= a for a, b in pairwise(u)):
        report((*where, "commands"), "commands must rise from -1 to 1")
    if any(b < a for a, b in pairwise(force)) or not force[0] <= 0.0 <= force[-1]:
        report(
            (*where, "forces_N"),
            "forces must not fall from value to value; the first must be at most 0, the last at least 0",
        )


def _check_lag(table: LagTable, report: Report) -> None:
    by_time = table.time_constant_s is not UNSET
    polynomials = (table.numerator is not UNSET) + (table.denominator is not UNSET)
    if by_time == bool(polynomials) or polynomials == 1:
        report(("lag",), "give exactly one form: time_constant_s, or numerator and denominator")
        return
    try:
        lag(table)
    except ValueError as error:
        report(("lag",), str(error))
        return
    if isinstance(table.denominator, tuple) and (np.roots(table.denominator).real >= 0.0).any():
        report(("lag", "denominator"), "the lag is unstable: all roots of the denominator need a negative real part")
