"""Computes everything that a report shows, for pages and pictures alike: the tables at the top, the map, and what is plotted."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from uwserver.physics.geometry.shapes import Solid
from uwserver.ports import Event
from uwserver.recording.report.bathymetry import Area, SeaFloor, outlines, sea_floor
from uwserver.recording.report.errors import SensorError, sensor_errors
from uwserver.recording.report.panels import Panel, panels
from uwserver.recording.report.reading import FloatArray, IntArray, Recorded, Series
from uwserver.recording.report.truth import Truth, truth_of
from uwserver.scenario.solids.archive import unpack

Row = tuple[str, str]
"""A label, and a value with its unit."""

_JITTER_M = 0.005
"""A step counts as motion only if it leads this far from the end of the last step, so that jitter adds no distance."""
_JOULES_PER_WH = 3600.0

_MARGIN = 0.25
"""Margin around the tracks, as a part of their extent."""
_LEAST_M = 10.0
"""Half the side of the smallest map."""
_NARROWEST = 0.6
"""Smallest ratio of the shorter to the longer side of the map."""
_TRACK_POINTS = 2500


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


@dataclass(frozen=True)
class Track:
    """The track of a vehicle, true or estimated: times t (n), s, and places p (n, 3), m in N."""

    vehicle: str
    t: FloatArray
    p: FloatArray
    is_estimate: bool = False


@dataclass(frozen=True)
class Contents:
    """The contents of a report.

    Attributes:
        title: title of the report.
        summary, vehicles: tables.
        remarks: what is missing or doubtful.
        events: in the order of time.
        errors: errors of sensors against the truth.
        panels: plots over time.
        tracks, area, floor, outlines: the map.
        end_s: end of the run, s.
    """

    title: str
    summary: tuple[Row, ...]
    vehicles: tuple[VehicleSummary, ...]
    remarks: tuple[str, ...]
    events: tuple[Event, ...]
    errors: tuple[SensorError, ...]
    panels: tuple[Panel, ...]
    tracks: tuple[Track, ...]
    area: Area
    floor: SeaFloor | float | None
    outlines: tuple[tuple[str, FloatArray], ...]
    end_s: float


def contents_of(recorded: Recorded, only: Collection[str] = ()) -> Contents:
    """Return the contents of the report of a recording.

    Args:
        recorded: the recording.
        only: the vehicles in the report; all if empty.

    Raises:
        ValueError: a vehicle of `only` is not in the recording.
    """
    known = list(
        dict.fromkeys((*recorded.scenario.get("vehicles", {}), *(s.vehicle for s in recorded.series.values())))
    )
    for name in only:
        if name not in known:
            raise ValueError(f'no vehicle "{name}" in {recorded.path}; there are: {", ".join(known) or "none"}')
    vehicles = [name for name in known if not only or name in only]
    truths = {name: truth_of(recorded, name) for name in vehicles}
    tracks = tuple(track for name in vehicles for track in _tracks(recorded, name, truths[name]))
    area = _area(tracks)
    remarks = list(recorded.remarks)
    solids: dict[str, Solid] = {}
    try:
        solids = unpack(recorded.head.get("solids", ""))
    except ValueError as error:
        remarks.append(f"Sea floor and structures are not shown: {error}.")
    floor = sea_floor(solids, area)
    errors = {n: tuple(sensor_errors(recorded, n, truth)) if (truth := truths[n]) else () for n in vehicles}
    if missing := [name for name in vehicles if truths[name] is None]:
        names = ", ".join(missing)
        remarks.append(
            f"The true motion of {names} was not recorded: there is no track, and there are no errors of its sensors."
        )
    title = str(recorded.scenario["scenario"].get("title") or recorded.scenario.get("name") or recorded.path.stem)
    return Contents(
        title=f"{title} ({recorded.path.name})",
        summary=summary_of(recorded),
        vehicles=tuple(vehicle_summary(recorded, name, truths[name], errors[name]) for name in vehicles),
        remarks=tuple(remarks),
        events=tuple(sorted(recorded.events, key=lambda event: event.t_ns)),
        errors=tuple(error for name in vehicles for error in errors[name]),
        panels=tuple(p for name in vehicles for p in panels(recorded, name, truths[name], errors[name], floor)),
        tracks=tracks,
        area=area,
        floor=floor,
        outlines=tuple(outlines(solids)),
        end_s=recorded.end_s,
    )


def _tracks(recorded: Recorded, vehicle: str, truth: Truth | None) -> list[Track]:
    found = []
    if truth is not None:
        found.append(_track(vehicle, truth.t, truth.p_NB, is_estimate=False))
    for series in recorded.series.values():
        is_estimator = series.message == "Estimate"  # its commands have a p_N too, but no message
        if series.vehicle == vehicle and is_estimator and "p_N" in series.columns:
            known = series.columns.get("position_valid", np.ones((len(series.t), 1)))
            p = np.where(known > 0.5, series.columns["p_N"], np.nan)
            if np.isfinite(p[:, :2]).all(axis=1).any():
                found.append(_track(vehicle, series.t, p, is_estimate=True))
    return found


def _track(vehicle: str, t: FloatArray, p: FloatArray, is_estimate: bool) -> Track:
    step = max(1, len(t) // _TRACK_POINTS)
    chosen = np.unique(np.append(np.arange(0, len(t), step), len(t) - 1))
    return Track(vehicle, t[chosen], p[chosen], is_estimate)


def _area(tracks: tuple[Track, ...]) -> Area:
    places = [track.p[:, :2] for track in tracks if not track.is_estimate] or [np.zeros((1, 2))]
    points = np.concatenate(places)
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.maximum(0.5 * (high - low) * (1.0 + 2.0 * _MARGIN), _LEAST_M)
    middle, half = 0.5 * (low + high), np.maximum(half, _NARROWEST * half.max())
    (south, west), (north, east) = (middle - half).tolist(), (middle + half).tolist()
    return south, north, west, east
