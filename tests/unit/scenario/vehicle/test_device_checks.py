"""Checks of a thruster's device file: force curves, their shape, and the lag."""

# ruff: noqa: E501 - one case a line
from __future__ import annotations

import copy
from typing import Any

import pytest

from uwserver.scenario.vehicle.device_checks import check_device
from uwserver.scenario.vehicle.tables import ThrusterDevice

SOURCE = {"source": "x", "status": "guess"}
THIRD_ORDER = {**SOURCE, "numerator": [1.0], "denominator": [1.0, 6.0, 11.0, 6.0]}


@pytest.fixture
def told(raw_device, tree_of, report):
    """What is told of the good device with tables in the place of its own; None takes one out."""

    def check(**tables: Any) -> list[str]:
        raw = copy.deepcopy(raw_device)
        for name, table in tables.items():
            raw[name] = table
            if table is None:
                del raw[name]
        tree = tree_of(raw, ThrusterDevice)
        report.lines.clear()  # what conversion tells has tests of its own
        check_device(tree, report)
        lines: list[str] = report.lines
        return lines

    return check


def curve(**keys: Any) -> dict[str, Any]:
    return {**SOURCE, "voltage_V": 16, "max_forward_N": 50, "max_reverse_N": 40, "dead_band": [-0.1, 0.1], **keys}


def test_a_good_device_passes(told) -> None:
    assert told() == []
    assert told(lag=THIRD_ORDER) == []
    assert told(curves={"a": curve(), "b": curve(voltage_V=12)}) == []


@pytest.mark.parametrize("coefficients", [[0.0], [1.0, -1.0], [-2.0, 1.0], []])
def test_full_command_must_push(coefficients: list[float], told) -> None:
    text = "shape.coefficients: their sum, which is the force at full command, must be greater than 0"
    assert told(shape={**SOURCE, "coefficients": coefficients}) == [text]


def test_a_device_needs_a_curve_and_has_room_for_some(told) -> None:
    assert told(curves={}) == ["curves: a device needs 1 to 8 force curves (under [curves] or [tables]), found 0"]
    many = {f"c{k}": curve(voltage_V=10 + k) for k in range(9)}
    assert told(curves=many) == ["curves: a device needs 1 to 8 force curves (under [curves] or [tables]), found 9"]
    del many["c8"]
    assert told(curves=many) == []
    assert told(curves=None) == ["curves: a device needs 1 to 8 force curves (under [curves] or [tables]), found 0"]
    assert told(curves=3) == ["curves: a device needs 1 to 8 force curves (under [curves] or [tables]), found 0"]


@pytest.mark.parametrize(
    ("band", "fits"),
    [([-0.1, 0.1], True), ([0, 0], True), ([-0.1, 0], True), ([0.05, 0.1], False), ([-0.1, -0.05], False), ([-1, 0.1], False), ([-0.1, 1], False), ([0.1, -0.1], False)],
)  # fmt: skip
def test_the_dead_band_holds_zero(band: list[float], fits: bool, told) -> None:
    lines = told(curves={"a": curve(dead_band=band)})
    low, high = band
    text = f"curves.a.dead_band: ({low:g}, {high:g}) must lie inside (-1, 1) and hold 0"
    assert lines == ([] if fits else [text])


def points(commands: list[float], forces: list[float], voltage: float = 12.0) -> dict[str, Any]:
    return {**SOURCE, "voltage_V": voltage, "commands": commands, "forces_N": forces}


def test_measured_points_need_no_shape_and_limits_do(told) -> None:
    assert told(tables={"a": points([-1, 0, 1], [-5, 0, 5])}, shape=None, curves=None) == []
    text = "curves: curves need the table [shape], the force between dead band and limits; or give measured points under [tables]"
    assert told(tables={"a": points([-1, 0, 1], [-5, 0, 5])}, shape=None) == [text]


@pytest.mark.parametrize(
    ("commands", "forces", "fault"),
    [
        ([-1, -0.1, 0.1, 1], [-5, 0, 0, 5], ""),
        ([-1, 1], [0, 5], ""),  # one that cannot reverse
        ([-1, 0, 1], [-5, 5], ": needs 2 to 48 commands and a force for each, found 3 commands and 2 forces"),
        ([1], [5], ": needs 2 to 48 commands and a force for each, found 1 commands and 1 forces"),
        (
            [-1, *(k / 60 for k in range(48))],
            [0.0] * 49,
            ": needs 2 to 48 commands and a force for each, found 49 commands and 49 forces",
        ),
        ([-0.9, 0, 1], [-5, 0, 5], ".commands: commands must rise from -1 to 1"),
        ([-1, 0, 0, 1], [-5, 0, 0, 5], ".commands: commands must rise from -1 to 1"),
        (
            [-1, 0, 1],
            [-5, 1, 0],
            ".forces_N: forces must not fall from value to value; the first must be at most 0, the last at least 0",
        ),
        (
            [-1, 0, 1],
            [1, 2, 3],
            ".forces_N: forces must not fall from value to value; the first must be at most 0, the last at least 0",
        ),
    ],
)
def test_measured_points_rise_over_the_whole_command(
    commands: list[float], forces: list[float], fault: str, told
) -> None:
    lines = told(tables={"a": points(commands, forces)}, curves=None)
    assert lines == ([f"tables.a{fault}"] if fault else [])


def test_tables_and_curves_share_their_voltages_and_their_room(told) -> None:
    table = points([-1, 0, 1], [-5, 0, 5], 16.0)
    assert told(tables={"t": table}, curves={"a": curve()}) == [
        'curves.a.voltage_V: the curve "t" is for 16 V too: remove one of the two'
    ]
    many = {f"c{k}": curve(voltage_V=20 + k) for k in range(8)}
    assert told(tables={"t": table}, curves=many) == [
        "curves: a device needs 1 to 8 force curves (under [curves] or [tables]), found 9"
    ]


def test_two_curves_of_one_voltage_are_told_with_the_first(told) -> None:
    lines = told(curves={"a": curve(), "b": curve(voltage_V=12), "c": curve(), "d": curve()})
    assert lines == [f'curves.{name}.voltage_V: the curve "a" is for 16 V too: remove one of the two' for name in "cd"]


def test_a_faulty_curve_counts_but_is_left_out(told) -> None:
    assert told(curves={"a": curve(voltage_V="high", dead_band=[1, 1]), "b": curve()}) == []


@pytest.mark.parametrize(
    "lag",
    [
        {},
        {"time_constant_s": 0.1, "numerator": [1.0]},
        {"time_constant_s": 0.1, "numerator": [1.0], "denominator": [1.0, 1.0, 1.0, 1.0]},
        {"numerator": [1.0]},
        {"denominator": [1.0, 6.0, 11.0, 6.0]},
    ],
)
def test_the_lag_has_one_form(lag: dict[str, Any], told) -> None:
    assert told(lag={**SOURCE, **lag}) == ["lag: give exactly one form: time_constant_s, or numerator and denominator"]


@pytest.mark.parametrize(
    ("numerator", "denominator"),
    [([1.0], [1.0, 1.0]), ([1.0], [0.0, 1.0, 1.0, 1.0]), ([1.0] * 4, [1.0, 6.0, 11.0, 6.0]), ([1.0], [1.0] * 5)],
)
def test_the_order_of_a_transfer_function(numerator: list[float], denominator: list[float], told) -> None:
    lag = {**SOURCE, "numerator": numerator, "denominator": denominator}
    text = "lag: a transfer function needs 4 denominator and at most 3 numerator coefficients"
    assert told(lag=lag) == [text]


@pytest.mark.parametrize(
    ("denominator", "stable"),
    [([1.0, 6.0, 11.0, 6.0], True), ([1.0, 4.0, 1.0, -6.0], False), ([1.0, 0.0, 1.0, 0.0], False), ([1.0, 3.0, 3.0, 1.0], True)],
)  # fmt: skip
def test_a_lag_is_stable(denominator: list[float], stable: bool, told) -> None:
    """Roots (-1, -2, -3), (1, -2, -3), on the imaginary axis, and three times -1."""
    lines = told(lag={**SOURCE, "numerator": [1.0], "denominator": denominator})
    text = "lag.denominator: the lag is unstable: all roots of the denominator need a negative real part"
    assert lines == ([] if stable else [text])


def test_all_faults_of_a_device_are_told(told) -> None:
    lines = told(shape={**SOURCE, "coefficients": [-1.0]}, curves={"a": curve(dead_band=[0.1, 0.2])}, lag=SOURCE)
    assert [line.split(":")[0] for line in lines] == ["shape.coefficients", "curves.a.dead_band", "lag"]


def test_holes_are_left_out(told) -> None:
    assert told(shape={**SOURCE, "coefficients": "x"}, lag={**SOURCE, "time_constant_s": -1}) == []
    assert told(lag=None) == []
    assert told(tables={"a": {**SOURCE, "voltage_V": 12, "commands": "x"}}) == []
