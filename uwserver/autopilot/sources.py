"""What an autopilot hears: the sensors that it listens to, and what its operator knows of the place."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from uwserver.autopilot.rows import SOURCE
from uwserver.autopilot.state import STILL
from uwserver.frames import IDENTITY, Quat, Vec3
from uwserver.modifiers.columns import columns_of
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Field, Value
from uwserver.ports.checks import bind

FIELDS: Mapping[str, tuple[str, ...]] = {
    "Imu": ("f_S", "w_S"),
    "Attitude": ("q_NS",),
    "FluidPressure": ("pressure",),
    "Dvl": ("v_S", "altitude", "figure_of_merit"),
    "Range": ("range",),
    "NavSatFix": ("latitude", "longitude", "horizontal_accuracy"),
    "Pose": ("p_NS", "q_NS"),
    "BeaconFix": ("beacon", "range", "p_beacon_S"),
    "BeaconRange": ("beacon", "range"),
    "Leak": ("leak",),
    "BatteryState": ("charge",),
}
"""The fields that it takes of each standard message that it can listen to; of a pressure sensor `depth` where it tells that."""
MESSAGES = tuple(FIELDS)
IMU, ATTITUDE, PRESSURE, DVL, ALTIMETER, GPS, MOTION_CAPTURE, USBL, LBL, LEAK, BATTERY = range(len(MESSAGES))
"""Their codes."""


def wanted(message: str, fields: Collection[Field]) -> tuple[str, ...]:
    """Names of the fields that it takes of a sensor whose fields fit a message; none of a message that it does not listen to."""
    if message == "FluidPressure" and any(field.name == "depth" for field in fields):
        return ("depth",)
    return FIELDS.get(message, ())


class Source(NamedTuple):
    """One sensor that the autopilot listens to.

    Attributes:
        message: that its fields fit.
        fields: of its port.
        p, q: its mount, p_BS (m) and q_BS.
        sigma: standard deviation that the operator expects of its position, m.
        north: by how much its north is east of true north, rad.
        density, atmosphere: of a pressure sensor: rho g (Pa/m) and the pressure at the surface (Pa); 0 where it tells depth.
    """

    message: str
    fields: tuple[Field, ...]
    p: Vec3 = STILL
    q: Quat = IDENTITY
    sigma: float = 0.05
    north: float = 0.0
    density: float = 0.0
    atmosphere: float = 0.0


@dataclass(frozen=True)
class Surroundings:
    """What the operator knows of the place.

    Attributes:
        gravity: m/s2.
        latitude, longitude: of the origin of N, rad.
        beacons: p_N (m) where beacons are thought to be, by name.
        start: p_N where the dead reckoning begins; None: at the origin of N, without being sure of it.
    """

    gravity: float = 9.81
    latitude: float = 0.0
    longitude: float = 0.0
    beacons: Mapping[str, Vec3] = field(default_factory=dict)
    start: Vec3 | None = None


class Hearing:
    """The sensors of one vehicle, as rows.

    Attributes:
        ports: paths, in the order of the rows.
        rows: SOURCE.
        beacons: (n, 3) p_N of beacons whose place is known, m.
        in_words: paths of those whose samples hold texts.
        messages: of the sensors.
        place: what the operator knows.
    """

    def __init__(self, sources: Mapping[str, Source], place: Surroundings) -> None:
        """Listen to these sensors, by port path; ValueError where a port lacks a field."""
        self.ports, self.place = tuple(sources), place
        self.messages = frozenset(source.message for source in sources.values())
        self.rows: Any = np.zeros(len(sources), SOURCE)
        self.beacons: FloatArray = np.array(list(place.beacons.values()), float).reshape(-1, 3)
        self._names = list(place.beacons)
        self._columns = {path: columns_of(source.fields) for path, source in sources.items()}
        self._place_of = {path: k for k, path in enumerate(sources)}
        self.in_words = tuple(path for path, source in sources.items() if FIELDS[source.message][0] == "beacon")
        for row, (path, source) in zip(self.rows, sources.items(), strict=True):
            row["kind"] = MESSAGES.index(source.message)
            row["place"][:] = self._places(path, source)
            row["p"], row["q"], row["sigma"], row["north"] = source.p, source.q, source.sigma, source.north
            row["density"], row["atmosphere"] = source.density, source.atmosphere

    def _places(self, path: str, source: Source) -> list[int]:
        """Where its fields stand among the numbers of its stream; a text is one more number at the end."""
        columns = self._columns[path]
        places = [columns.first[k] for k in bind(path, source.fields, *wanted(source.message, source.fields))]
        places = [columns.width if place < 0 else place for place in places]
        return places + [0] * (3 - len(places))

    def numbers(self, port: str, values: Sequence[Value]) -> tuple[int, FloatArray]:
        """The row of a port, and a sample's values as numbers, that of a beacon at the end: -1 for one whose place nobody knows."""
        columns = self._columns[port]
        numbers = np.full(columns.width + 1, -1.0)
        columns.pack(values, numbers[:-1])
        for k in columns.loose:
            if values[k] in self._names:
                numbers[-1] = self._names.index(str(values[k]))
        return self._place_of[port], numbers
