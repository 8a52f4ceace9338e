"""Makes the tables at the top of a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uwserver.recording.report.columns import FloatArray
from uwserver.recording.report.errors import SensorError
from uwserver.recording.report.reading import IntArray, Recorded, Series
from uwserver.recording.report.truth import Truth

Row = tuple[str, str]
"""A label, and a value with its unit."""

_JITTER_M = 0.005
"""A step counts as motion only if it leads this far from the end of the last step, so that jitter adds no distance."""
_JOULES_PER_WH = 3600.0


@dataclass(frozen=True)
class VehicleSummary:
    """The table of a vehicle.

    Attributes:
        name: name of the vehicle.
        model: name of its file.
        rows: the table.
    """

    name: str
    model: str
    rows: tuple[Row, ...]


def summary_of(recorded: Recorded) -> tuple[Row, ...]:
    """Return the table of the whole run."""
    head, scenario = recorded.head, recorded.scenario["scenario"]
    faults = sum(event.event == "fault" for event in recorded.events)
    rate = scenario.get("world", {}).get("rate_hz")
    rate_hz = f"{rate:g}" if isinstance(rate, int | float) else "?"
    sensors = [series for series in recorded.series.values() if series.direction == "sensor"]
    rows = [
        ("scenario", str(recorded.scenario.get("name", ""))),
        ("title", str(scenario.get("title", ""))),
        ("recorded", head.get("started_utc", "") or "?"),
        (
            "duration",
            f"{recorded.end_s:.1f} s simulated, {rate_hz} ticks a second",
        ),
        (
            "uwserver",
            f"{head.get('uwserver', '?')}, physics {head.get('physics', '?')}, format {head.get('format', '?')}",
        ),
        (
            "made with",
            f"Python {head.get('python', '?')}, numpy {head.get('numpy', '?')}, numba {head.get('numba', '?')}",
        ),
        ("machine", head.get("platform", "?")),
        ("seed", head.get("seed", "?")),
        ("samples", f"{sum(len(series.t) for series in sensors)} on {len(sensors)} ports"),
        ("faults", str(faults)),
    ]
    return tuple(row for row in rows if row[1])


def vehicle_summary(
    recorded: Recorded, vehicle: str, truth: Truth | None, errors: Sequence[SensorError]
) -> VehicleSummary:
    """Return the table of one vehicle, without rows for what was not recorded."""
    file = recorded.scenario.get("vehicles", {}).get(vehicle, {}).get("vehicle", {})
    mine = [series for series in recorded.series.values() if series.vehicle == vehicle]
    rows: list[Row] = []
    if truth is not None:
        rows.append(("distance run", f"{distance_run(truth.p_NB):.1f} m"))
        rows.append(("largest depth", f"{float(truth.p_NB[:, 2].max()):.2f} m"))
        if truth.v_NB_B is not None and np.isfinite(truth.v_NB_B).any():
            rows.append(("largest speed", f"{float(np.nanmax(np.linalg.norm(truth.v_NB_B, axis=1))):.2f} m/s"))
    rows += [row for series in mine if series.message == "BatteryState" for row in _battery(series)]
    faults = [event for event in recorded.events if event.event == "fault" and f'"{vehicle}/' in f"{event.text}"]
    began = len([event for event in faults if "began" in event.text])
    rows.append(("faults", f"{began} began" if faults else "none"))
    sensors = [series for series in mine if series.direction == "sensor"]
    missing = sum(missing_samples(series.seq) for series in sensors)
    rows.append(("samples", f"{sum(len(s.t) for s in sensors)}; missing by their numbers: {missing}"))
    counted = [(error.inside, error.error.size) for error in errors if error.inside is not None]
    if counted:
        share = sum(inside * size for inside, size in counted) / sum(size for _, size in counted)
        rows.append(("errors within 3 sigma", f"{share:.1%}"))
    return VehicleSummary(vehicle, str(file.get("name", "")), tuple(rows))


def distance_run(p: FloatArray) -> float:
    """Return the length of a path (n, 3), m, without jitter."""
    total, last = 0.0, p[0]
    for place in p[1:]:
        step = float(np.linalg.norm(place - last))
        if step >= _JITTER_M:
            total, last = total + step, place
    return total


def missing_samples(seq: IntArray) -> int:
    """Return how many sequence numbers (n) are missing. After a reset the numbers begin again."""
    if len(seq) < 2:
        return 0
    steps = np.diff(np.sort(seq))
    return int(np.sum(steps[steps > 1] - 1))


def _battery(series: Series) -> list[Row]:
    rows: list[Row] = []
    columns = (series.columns.get(name, np.zeros((0, 1)))[:, 0] for name in ("energy", "charge"))
    energy, charge = (column[np.isfinite(column)] for column in columns)
    if len(energy):
        rows.append(("energy used", f"{float(energy[-1] - energy[0]) / _JOULES_PER_WH:.2f} Wh"))
    if len(charge):
        rows.append(("charge left", f"{float(charge[-1]):.1%}"))
    return rows
