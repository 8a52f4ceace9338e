"""The plots of docs/validation.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from uwserver_bench.proofs.closed_forms import tilt

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.units import deg

# Before pyplot is imported: no display.
matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

Series = tuple[FloatArray, FloatArray]
TINY = 1e-16
"""Drawn instead of zero on logarithmic axes."""


def _figure(columns: int) -> tuple[Figure, list[Axes]]:
    figure, axes = plt.subplots(1, columns, figsize=(5.2 * columns, 3.8), layout="constrained")
    return figure, list(np.atleast_1d(axes))


def _save(figure: Figure, path: Path) -> None:
    for axes in figure.axes:
        axes.grid(visible=True, alpha=0.3)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Without the version of matplotlib in it, the same plot is the same file.
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)


def oracles(path: Path, errors: Mapping[str, Series], track: tuple[FloatArray, FloatArray]) -> None:
    """Track of the BlueROV2 Heavy over its oracle, and the position error of the long runs over time."""
    figure, (left, right) = _figure(2)
    states, expected = track
    left.plot(states[:, 1], states[:, 0], label="kernel, 240 Hz")
    left.plot(expected[:, 1], expected[:, 0], "k.", markersize=3, label="oracle, each second")
    left.set(xlabel="east, m", ylabel="north, m", title="BlueROV2 Heavy, six-axis wrench, current", aspect="equal")
    left.set_adjustable("datalim")
    for name, (times, error) in errors.items():
        right.semilogy(times[1:], np.maximum(error[1:], TINY), label=name)
    right.axhline(1e-6, color="k", linestyle=":", label="bar, 1e-6 m")
    right.set(xlabel="time, s", ylabel="position error, m", title="Distance from the oracle")
    _save(figure, path)


def order(path: Path, rates: Sequence[int], curves: Mapping[str, Sequence[float]]) -> None:
    """Error against rate with the slope of fourth order."""
    figure, (axes,) = _figure(1)
    for name, errors in curves.items():
        axes.loglog(rates, errors, "o-", label=name)
    first = next(iter(curves.values()))[0]
    axes.loglog(rates, [first * (rates[0] / rate) ** 4 for rate in rates], "k:", label="fourth order")
    axes.set_xticks(rates, [str(rate) for rate in rates])
    axes.minorticks_off()
    axes.set(xlabel="rate, Hz", ylabel="largest position error in 60 s, m", title="Order of convergence")
    _save(figure, path)


def energy(path: Path, curves: Mapping[int, Series]) -> None:
    """Relative drift of the kinetic energy of a free body."""
    figure, (axes,) = _figure(1)
    for rate, (times, drift) in curves.items():
        axes.semilogy(times[1:], np.maximum(drift[1:], TINY), label=f"{rate} Hz")
    axes.axhline(1e-9, color="k", linestyle=":", label="bar at 240 Hz")
    axes.set(xlabel="time, s", ylabel="relative drift", title="Energy of a free body without damping")
    _save(figure, path)


def surface(path: Path, times: FloatArray, states: FloatArray, names: Sequence[str]) -> None:
    """Depth and tilt of vehicles that rise and settle."""
    figure, (left, right) = _figure(2)
    step = 10
    for k, name in enumerate(names):
        left.plot(times[::step], states[::step, k, 2], label=name)
        right.semilogy(times[::step], [max(deg(tilt(row)), 1e-3) for row in states[::step, k]], label=name)
    left.invert_yaxis()
    left.axhline(0.0, color="k", linewidth=0.8)
    left.set(xlabel="time, s", ylabel="depth of the origin, m", title="Rising to the surface", xlim=(0.0, 120.0))
    right.set(xlabel="time, s", ylabel="tilt, degrees", title="Righting", xlim=(0.0, 120.0))
    _save(figure, path)
