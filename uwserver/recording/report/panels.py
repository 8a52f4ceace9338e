"""Computes the plots over time of a report, for pages and pictures alike, and reduces their samples to the points that a screen can show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from uwserver.ports.pictures import png
from uwserver.recording.report.bathymetry import SeaFloor
from uwserver.recording.report.errors import BOUND, SensorError
from uwserver.recording.report.reading import FloatArray, IntArray, Recorded, Series
from uwserver.recording.report.truth import Truth, euler, rotations
from uwserver.units import deg

_WIDE = 12
"""A field with more components than this is drawn as a picture over time."""
_COLUMNS = 1200
"""Largest width of a picture over time."""
_EXACT = 1e-5
"""Smaller errors of a sensor without configured errors, in the unit of the sensor, are rounding errors and are not drawn."""
_TURN_DEG = deg(2.0 * np.pi)

PIXELS = 900
"""Width of a plot; twice as many points are kept."""


@dataclass(frozen=True)
class Line:
    """A line of a plot: y (n) over the times of its table."""

    label: str
    y: FloatArray
    is_stepped: bool = False
    is_faint: bool = False


@dataclass(frozen=True)
class Table:
    """Lines that share their times t (n), s."""

    t: FloatArray
    lines: tuple[Line, ...]


@dataclass(frozen=True)
class Picture:
    """A number over time and another axis, as a picture whose first row is at `high`.

    Attributes:
        begin, end: ends of the time axis, s.
        low, high: ends of the other axis.
        png: bytes of the picture.
        least, most: the numbers that the darkest and the brightest colour show.
        unit: unit of these numbers.
    """

    begin: float
    end: float
    low: float
    high: float
    png: bytes
    least: float
    most: float
    unit: str


@dataclass(frozen=True)
class Panel:
    """One plot.

    Attributes:
        vehicle: name of the vehicle.
        group: heading of the group.
        title, unit: those of the vertical axis.
        tables: the lines.
        is_down: the axis points down, as for depths.
        band: the last table contains an upper and a lower line, and the area between them is filled.
        picture: a picture instead of lines.
        note: a remark for the reader.
    """

    vehicle: str
    group: str
    title: str
    unit: str
    tables: tuple[Table, ...] = ()
    is_down: bool = False
    band: bool = False
    picture: Picture | None = None
    note: str = ""


def panels(
    recorded: Recorded, vehicle: str, truth: Truth | None, errors: Sequence[SensorError], floor: SeaFloor | float | None
) -> Iterator[Panel]:
    """Yield all panels of a vehicle, group by group, without panels for what was not recorded."""
    return iter(sorted(_panels(recorded, vehicle, truth, errors, floor), key=lambda panel: _GROUPS.index(panel.group)))


_GROUPS = ("Motion", "Actuators", "Battery", "DVL", "Sonar", "Errors against the truth", "Other sensors")


def _panels(
    recorded: Recorded, vehicle: str, truth: Truth | None, errors: Sequence[SensorError], floor: SeaFloor | float | None
) -> Iterator[Panel]:
    mine = [series for series in recorded.series.values() if series.vehicle == vehicle]
    sensors = [series for series in mine if series.direction == "sensor"]
    motion = "Motion"
    yield from _panel(vehicle, motion, "Depth", "m", _depths(sensors, truth, floor), is_down=True)
    yield from _panel(vehicle, motion, "Altitude", "m", _altitudes(sensors))
    yield from _panel(vehicle, motion, "Roll and pitch", "deg", _tilts(sensors, truth))
    yield from _panel(vehicle, motion, "Heading", "deg", _headings(sensors, truth))
    if truth is not None and truth.v_NB_B is not None:
        v = truth.v_NB_B.T
        lines = tuple(Line(name, row) for name, row in zip(("surge", "sway", "heave"), v, strict=True))
        yield Panel(vehicle, motion, "Velocity", "m/s", (Table(truth.t, lines),))
    for series in mine:
        if series.direction == "actuator" and series.kind != "autopilot":
            yield from _fields(series, "Actuators", is_stepped=True)
    for series in sensors:
        if series.message in ("ShaftSpeeds", "Estimate"):
            yield from _fields(series, "Actuators", ("outputs", "speeds", "tau"))
        elif series.message == "BatteryState":
            yield from _fields(series, "Battery", ("voltage", "current", "charge"))
        elif series.message == "Dvl" and "beam_locks" in series.columns:
            yield _locks(series)
        elif series.message in _ROWS:
            yield from _waterfall(series)
    for error in errors:
        if error.sigma is not None or error.path.endswith("/state") or np.nanmax(np.abs(error.error)) > _EXACT:
            yield _error(vehicle, error)
    for series in sensors:
        if series.message not in _SHOWN:
            yield from _fields(series, "Other sensors")


_SHOWN = (
    "ShaftSpeeds", "BatteryState", "SonarPing", "SonarImage", "SideScan", "Estimate", "TruePose", "TrueVelocity", "TrueAcceleration",
)  # fmt: skip


def _panel(
    vehicle: str, group: str, title: str, unit: str, tables: Iterator[Table], *, is_down: bool = False
) -> Iterator[Panel]:
    found = tuple(tables)
    if found:
        yield Panel(vehicle, group, title, unit, found, is_down)


def _table(series: Series, label: str, name: str, *, is_stepped: bool = False) -> Iterator[Table]:
    """Yield a table of the first column of a field, where it is valid; nothing if the series has none."""
    if name in series.columns:
        y = np.where(series.valid, series.columns[name][:, 0], np.nan)
        if np.isfinite(y).any():
            yield Table(series.t, (Line(label, y, is_stepped),))


def _short(series: Series) -> str:
    return series.path.partition("/")[2]


def _depths(sensors: Sequence[Series], truth: Truth | None, floor: SeaFloor | float | None) -> Iterator[Table]:
    if truth is not None:
        yield Table(truth.t, (Line("true", truth.p_NB[:, 2]),))
        if floor is not None:
            below = floor.below(*truth.p_NB[:, :2].T) if isinstance(floor, SeaFloor) else np.full(len(truth.t), floor)
            if np.isfinite(below).any():
                yield Table(truth.t, (Line("sea floor", below, is_faint=True),))
    for series in sensors:
        if series.message == "Estimate":
            yield from _table(series, "estimate", "depth")
            yield from _table(series, "set point", "depth_ref", is_stepped=True)
        elif series.message == "FluidPressure":
            yield from _table(series, _short(series), "depth")


def _altitudes(sensors: Sequence[Series]) -> Iterator[Table]:
    for series in sensors:
        if series.message in ("Dvl", "Estimate"):
            yield from _table(series, _short(series), "altitude")
        elif series.message == "Range":
            yield from _table(series, _short(series), "range")


def _tilts(sensors: Sequence[Series], truth: Truth | None) -> Iterator[Table]:
    for label, t, angles in _attitudes(sensors, truth):
        yield Table(t, (Line(f"roll, {label}", angles[:, 0]), Line(f"pitch, {label}", angles[:, 1])))


def _headings(sensors: Sequence[Series], truth: Truth | None) -> Iterator[Table]:
    start: float | None = None
    for label, t, angles in _attitudes(sensors, truth):
        y, start = _unwrapped(angles[:, 2], start)
        yield Table(t, (Line(label, y),))
    for series in sensors:
        if series.message == "Estimate" and "heading_ref" in series.columns:
            y, start = _unwrapped(series.columns["heading_ref"][:, 0] * deg(1.0), start)
            if np.isfinite(y).any():
                yield Table(series.t, (Line("set point", y, is_stepped=True),))


def _attitudes(sensors: Sequence[Series], truth: Truth | None) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield name, times and roll, pitch, yaw (n, 3), degrees, of the truth and of all sensors that measure the attitude of the body."""
    if truth is not None:
        yield "true", truth.t, euler(rotations(truth.q_NB)) * deg(1.0)
    for series in sensors:
        name = {"Attitude": "q_NS", "Estimate": "q_NB"}.get(series.message)
        if name in series.columns:
            q = np.where(series.valid[:, None], series.columns[name], np.nan)
            if np.isfinite(q).any():
                yield _short(series), series.t, euler(rotations(q)) * deg(1.0)


def _unwrapped(angle: FloatArray, start: float | None) -> tuple[FloatArray, float | None]:
    """Remove jumps of a full turn from angles (n), degrees.

    Returns:
        The angles, and the angle at which they begin. It is within half a turn of `start`, or in the first turn if `start` is None.
    """
    good = np.flatnonzero(np.isfinite(angle))
    if not len(good):
        return angle, start
    whole = np.array(angle)
    whole[good] = np.unwrap(angle[good], period=_TURN_DEG)
    first = float(whole[good[0]])
    turns = np.floor(first / _TURN_DEG) if start is None else np.rint((first - start) / _TURN_DEG)
    whole -= turns * _TURN_DEG
    return whole, first - turns * _TURN_DEG if start is None else start


def _fields(
    series: Series, group: str, names: Sequence[str] | None = None, *, is_stepped: bool = False
) -> Iterator[Panel]:
    """Yield a panel for each field that has numbers."""
    for name, column in series.columns.items():
        if names is not None and name not in names:
            continue
        field = series.fields[name]
        valid = np.where(series.valid[:, None], column, np.nan)
        if not np.isfinite(valid).any():
            continue
        title = f"{_short(series)} {name}"
        if column.shape[1] > _WIDE:
            picture = _picture(series.t, valid, 0.0, float(column.shape[1]), field.unit)
            yield Panel(series.vehicle, group, title, "", picture=picture)
            continue
        stepped = is_stepped or field.type in ("bool", "int")
        lines = tuple(Line(field.part(k), row, stepped) for k, row in enumerate(valid.T))
        yield Panel(series.vehicle, group, title, field.unit, (Table(series.t, lines),))


def _locks(series: Series) -> Panel:
    locks = np.nan_to_num(series.columns["beam_locks"])
    share = float(np.mean(series.valid)) if len(series.valid) else 0.0
    lines = (
        Line("beams in lock", locks.sum(axis=1), is_stepped=True),
        Line("valid", series.valid.astype(float), is_stepped=True),
    )
    note = f"valid in {share:.1%} of {len(series.t)} samples"
    return Panel(series.vehicle, "DVL", f"{_short(series)} lock", "beams", (Table(series.t, lines),), note=note)


def _waterfall(series: Series) -> Iterator[Panel]:
    """Yield a panel with the echoes over range and time, one column per ping."""
    rows, reach = _echoes(series), series.columns.get("range")
    if rows is None or reach is None or not np.isfinite(rows).any() or not np.isfinite(reach).any():
        return
    far = float(np.nanmax(reach))
    note = _OF_A_PING[series.message] if np.nanmin(reach) == far else "pings of shorter range are stretched"
    unit = series.fields[_ROWS[series.message][0]].unit
    if unit == "Pa":  # pressures change by many powers of ten over the range
        rows, unit = _decibels(rows), "dB re 1 uPa"
    both_sides = series.message == "SideScan"
    picture = _picture(series.t, rows, -far if both_sides else 0.0, far, unit)
    title = f"{_short(series)} range"
    yield Panel(series.vehicle, "Sonar", title, "m", is_down=not both_sides, picture=picture, note=note)


_ROWS = {"SonarImage": ("image",), "SonarPing": ("bins",), "SideScan": ("port", "starboard")}
_OF_A_PING = {
    "SonarImage": "the strongest beam of each ping at each range",
    "SonarPing": "all pings in their order, whatever the bearing of the head",
    "SideScan": "slant range, to starboard above 0 and to port below",
}
_RANGE_DB = 80.0


def _echoes(series: Series) -> FloatArray | None:
    """Return echoes (n, k) from the near end to the far end, or from the far end of port to that of starboard; None if fields are missing."""
    found = [series.columns[name] for name in _ROWS[series.message] if name in series.columns]
    if len(found) < len(_ROWS[series.message]):
        return None
    return found[0] if len(found) == 1 else np.hstack([found[0][:, ::-1], found[1]])


def _decibels(pressure: FloatArray) -> FloatArray:
    """Return levels re 1 uPa of amplitudes (Pa), limited to a range of `_RANGE_DB` below the largest."""
    largest = max(float(np.nanmax(pressure)), 1e-30)
    levels: FloatArray = 20.0 * np.log10(np.maximum(pressure, largest * 10.0 ** (-0.05 * _RANGE_DB)) * 1e6)
    return levels


def _picture(t: FloatArray, rows: FloatArray, low: float, high: float, unit: str) -> Picture:
    """Return a picture of rows (n, k) over time; each pixel shows the largest of its numbers."""
    count = min(_COLUMNS, len(t))
    begin, end = float(t[0]), float(t[-1])
    place = np.clip(((t - begin) / max(end - begin, 1e-9) * count).astype(int), 0, count - 1)
    columns: FloatArray = np.full((count, rows.shape[1]), np.nan)
    np.fmax.at(columns, place, rows)
    # A column without a sample repeats the one before, so that a slow sensor gives no stripes.
    filled = np.isfinite(columns).any(axis=1)
    last = np.maximum.accumulate(np.where(filled, np.arange(count), 0))
    columns = columns[last]
    least, most = float(np.nanmin(columns)), float(np.nanmax(columns))
    grey = np.nan_to_num((columns - least) / max(most - least, 1e-12)) * 255.0
    # The first row of the picture is at the far end.
    return Picture(begin, end, low, high, png(np.rint(grey.T[::-1]).astype(np.uint8), _SONAR), least, most, unit)


def _ramp(stops: Mapping[int, tuple[int, int, int]]) -> bytes:
    places = list(stops)
    colours = np.array(list(stops.values()), dtype=float)
    ramp = np.stack([np.interp(np.arange(256), places, c) for c in colours.T], axis=1)
    return bytes(np.rint(ramp).astype(np.uint8).tobytes())


_SONAR = _ramp({0: (8, 8, 20), 70: (72, 30, 92), 140: (190, 70, 60), 200: (246, 160, 50), 255: (255, 248, 210)})
"""From dark blue over red and orange to white; the brightness grows with the number."""


def _error(vehicle: str, error: SensorError) -> Panel:
    tables = [Table(error.t, tuple(Line(label, y) for label, y in zip(error.labels, error.error.T, strict=True)))]
    note = f"rms {error.rms:.3g} {error.unit} in {len(error.t)} samples"
    if error.sigma is not None:
        most = ", the largest" if len(error.labels) > 1 else ""
        edges = [
            Line(f"{sign}3 sigma{most}", side * BOUND * error.sigma.max(axis=1), is_faint=True)
            for sign, side in (("+", 1), ("-", -1))
        ]
        tables.append(Table(error.t, tuple(edges)))
        note += f"; {error.inside:.1%} of the numbers within 3 sigma" if error.inside is not None else ""
    title = f"{error.path.partition('/')[2]} {error.title}"
    return Panel(
        vehicle, "Errors against the truth", title, error.unit, tuple(tables), band=error.sigma is not None, note=note
    )


def decimated(t: FloatArray, y: FloatArray, pixels: int = PIXELS) -> tuple[FloatArray, FloatArray]:
    """Reduce samples y (n, k) at t (n, ascending) to at most two rows per pixel: the extremes of each column, in the order in which they came.

    No peak is lost. A column without a number in a pixel has none there afterwards.

    Returns:
        Their times (m), s, never decreasing, and the samples (m, k).
    """
    if len(t) <= 2 * pixels:
        return t, y
    edges = np.linspace(t[0], t[-1], pixels + 1)[1:-1]
    starts = np.concatenate([[0], np.searchsorted(t, edges)])
    ends = np.append(starts[1:], len(t))
    filled = ends > starts
    starts, ends = starts[filled], ends[filled]
    low = np.fmin.reduceat(y, starts, axis=0)
    high = np.fmax.reduceat(y, starts, axis=0)
    rising = _first_of(y, starts, ends, high) >= _first_of(y, starts, ends, low)
    pair = np.stack([np.where(rising, low, high), np.where(rising, high, low)], axis=1)
    middle = 0.5 * (t[starts] + t[ends - 1])
    times = np.stack([t[starts], np.maximum(middle, t[starts])], axis=1)
    return times.reshape(-1), pair.reshape(-1, y.shape[1])


def _first_of(y: FloatArray, starts: IntArray, ends: IntArray, value: FloatArray) -> FloatArray:
    """Return the index (pixels, k) at which each column first has this value in each pixel."""
    pixel = np.repeat(np.arange(len(starts)), ends - starts)
    number = np.arange(len(y), dtype=float)[:, None]
    places = np.where(y == value[pixel], number, np.inf)
    return np.minimum.reduceat(places, starts, axis=0)
