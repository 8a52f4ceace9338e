"""Kernels beside their tables: numba is imported when one is called, and what it makes is what was written."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import uwserver
from uwserver.physics.kernel import linear
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import Deferred, Elsewhere, compiled, entry, inlined, separate

PACKAGE = Path(uwserver.__file__).parent
FACTOR = 3.0

solve = Elsewhere("uwserver.physics.kernel.linear", "solve")


@compiled
def scaled(x: float) -> float:
    """Names a constant of the module."""
    return FACTOR * x


@inlined
def first_of(values: Array) -> float:
    return float(values[0])


@separate
def raised(x: float, n: int) -> float:
    power = 1.0
    for _ in range(n):
        power *= scaled(x)
    return power


@entry
def both(values: Array) -> float:
    """Calls kernels of all forms."""
    return raised(first_of(values), 2) + scaled(values[1])


@entry
def solved(a: Array, b: Array) -> None:
    solve(a, b)


def test_a_kernel_calls_those_that_it_names():
    assert both(np.array([2.0, 5.0])) == 6.0 * 6.0 + 15.0


def test_a_kernel_is_made_once():
    assert both.made() is both.made()
    assert scaled.made() is scaled.made()


def test_it_is_told_as_it_was_written():
    assert scaled.py_func(2.0) == 6.0
    assert scaled.__name__ == "scaled"
    assert scaled.__doc__ == "Names a constant of the module."


def test_a_kernel_elsewhere_is_called_by_its_name():
    a, b = np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([[4.0], [7.0]])
    expected = np.linalg.solve(a, b)
    solved(a, b)
    assert b == pytest.approx(expected)
    assert solve.made() is linear.solve


def test_a_kernel_of_a_closure_keeps_what_it_closes_over():
    def adding(kernel: Deferred, more: float) -> Deferred:
        @entry
        def run(x: float) -> float:
            return float(kernel(x) + more)

        return run

    one, two = adding(scaled, 1.0), adding(scaled, 2.0)
    assert (one(1.0), two(1.0)) == (4.0, 5.0)


def test_a_name_that_is_missing_is_told_when_it_is_called():
    @entry
    def lost(x: float) -> float:
        return nowhere(x)  # type: ignore[name-defined, no-any-return]  # noqa: F821

    with pytest.raises(Exception, match="nowhere"):
        lost(1.0)


def _kinds(folder: str) -> list[str]:
    """Modules of a folder but those that are there for compiled code alone, and say so."""
    found = [
        path for path in sorted((PACKAGE / folder).rglob("*.py")) if "Imports numba." not in path.read_text("utf-8")
    ]
    files = [path for path in found if path.parent.name != "camera" or path.name == "camera.py"]
    return [
        ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__") for path in files
    ]


def test_sensors_modifiers_and_scenarios_are_read_without_numba_which_is_there_once_a_kernel_is_made():
    """It costs half a second, which a command line that only reads tables must not pay."""
    sensors, modifiers = _kinds("sensors"), _kinds("modifiers")
    assert "uwserver.sensors.acoustic.doppler.dvl" in sensors
    assert "uwserver.modifiers.chain" in modifiers
    modules = [*sensors, *modifiers, "uwserver.testing", "uwserver.scenario.load.scenario"]
    code = (
        f"import sys\nfor name in {modules!r}: __import__(name)\nprint('numba' in sys.modules, 'llvmlite' in sys.modules)\n"
        "from uwserver.physics.kernel.random import philox; philox.made(); print('numba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.split() == ["False", "False", "True"]
