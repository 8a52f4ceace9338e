"""Checks of a thruster's device file across its keys."""

from __future__ import annotations

import numpy as np
from msgspec import UNSET

from uwserver.physics.kernel.layout import TABLE_VOLTAGES
from uwserver.scenario.files.convert import Node, Report
from uwserver.scenario.vehicle.body import lag
from uwserver.scenario.vehicle.tables import ForceCurve, LagTable, Shape


def check_device(device: Node, report: Report) -> None:
    """Force curves, their common shape, and the lag; holes are left out."""
    shape: Shape | None = device.at("shape").value
    if shape is not None and not sum(shape.coefficients) > 0.0:
        report(("shape", "coefficients"), "their sum, the force at full command, must be greater than 0")
    _check_curves(device.at("curves"), report)
    table: LagTable | None = device.at("lag").value
    if table is not None:
        _check_lag(table, report)


def _check_curves(curves: Node, report: Report) -> None:
    if not 1 <= len(curves.parts) <= TABLE_VOLTAGES:
        report(("curves",), f"needs 1 to {TABLE_VOLTAGES} force curves, found {len(curves.parts)}")
    voltages: dict[float, str] = {}
    good: dict[str, ForceCurve] = curves.values()
    for name, curve in good.items():
        low, high = curve.dead_band
        if not -1.0 < low <= 0.0 <= high < 1.0:
            report(("curves", name, "dead_band"), f"({low:g}, {high:g}) must lie inside (-1, 1), with 0 in it")
        if curve.voltage_V in voltages:
            text = f'the curve "{voltages[curve.voltage_V]}" is for {curve.voltage_V:g} V too'
            report(("curves", name, "voltage_V"), text)
        voltages.setdefault(curve.voltage_V, name)


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
        report(("lag", "denominator"), "the lag is unstable: all roots need a negative real part")
