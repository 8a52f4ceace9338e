"""The figure of `uwclient plot`: a line for each component over simulation time. Needs matplotlib."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

from uwclient.errors import UwError, install_command
from uwclient.ports import Port, Sample


def require_matplotlib() -> None:
    """Raise UwError if matplotlib is missing. Call this before samples are collected in vain."""
    _module("matplotlib")


def draw(samples: Sequence[Sample], ports: dict[str, Port], name: str, out: str | None) -> None:
    """Draw the field `name` of the samples, with a panel for each port. Write the file `out`, or open a window if it is None.

    Raises:
        UwError: matplotlib is missing, or no sample has numbers in that field.
        OSError: the file cannot be written.
    """
    by_port: dict[str, list[Sample]] = {}
    for sample in samples:
        if name in sample.value:
            by_port.setdefault(sample.port, []).append(sample)
    if not by_port:
        raise UwError(f'no sample came with a field "{name}"', code="no_samples", where=name)
    pyplot = _module("matplotlib.pyplot") if out is None else None
    size = (9.0, 2.0 + 2.5 * len(by_port))
    figure = pyplot.figure(figsize=size) if pyplot else _module("matplotlib.figure").Figure(figsize=size)
    panels = figure.subplots(len(by_port), 1, sharex=True, squeeze=False)[:, 0]
    for panel, (path, series) in zip(panels, sorted(by_port.items())):
        _draw_panel(panel, path, series, name, _unit(ports.get(path), name))
    panels[-1].set_xlabel("simulation time, s")
    figure.tight_layout()
    if pyplot is None:
        figure.savefig(out, dpi=120)
    else:
        pyplot.show()


def _draw_panel(panel: Any, path: str, series: Sequence[Sample], name: str, unit: str) -> None:
    vectors = [sample.vector(name) for sample in series]
    width = max(len(vector) for vector in vectors)
    times_s = [sample.time_s for sample in series]
    for component in range(width):
        # A field that is null as a whole is one NaN, whatever its shape.
        values = [vector[component] if component < len(vector) else float("nan") for vector in vectors]
        panel.plot(times_s, values, linewidth=1.0, label=f"{name}[{component}]" if width > 1 else name)
    panel.set_title(path, loc="left", fontsize=10)
    panel.set_ylabel(f"{name}, {unit}" if unit else name)
    panel.grid(True, alpha=0.3)
    panel.legend(loc="upper right", fontsize=8)


def _unit(port: Port | None, name: str) -> str:
    units = [field.unit for field in port.fields if field.name == name] if port else []
    return units[0] if units else ""


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise UwError(
            f"plotting needs matplotlib: {install_command('uwclient[plot]')}",
            code="missing_package",
            where="matplotlib",
        ) from None
