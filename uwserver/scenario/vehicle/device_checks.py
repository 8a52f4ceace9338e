"""Checks the device file of a thruster across its keys."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from msgspec import UNSET

from uwserver.physics.kernel.layout import TABLE_SIZE, TABLE_VOLTAGES
from uwserver.scenario.files.convert import Node, Report
from uwserver.scenario.vehicle.body import lag
from uwserver.scenario.vehicle.tables import ForceCurve, LagTable, MeasuredCurve, Shape


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
