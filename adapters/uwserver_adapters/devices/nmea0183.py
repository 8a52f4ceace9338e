"""NMEA 0183 sentences of a satellite receiver, compass, echosounder, speed log and thermometer (IEC 61162-1)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from datetime import datetime
from typing import Annotated, Any, Literal, cast

from msgspec import Meta

from uwserver.adapter import AdapterContext, CannotServe
from uwserver.frames import Vec3
from uwserver.ports import Sample
from uwserver.table import Name, Positive
from uwserver_adapters.devices.codec import NANOSECONDS, checksum, deg, instant, sentence
from uwserver_adapters.devices.device import DeviceInput, DeviceTable, LineReader, Reply

LINE_LIMIT = 1024
"""Longest line of a peer, bytes. A sentence has 82."""
KNOT = 1852.0 / 3600.0
"""A knot, m/s."""
MILE = 1852.0
FOOT, FATHOM = 0.3048, 1.8288
"""Units of length, m."""
GAP_S = 10.0
"""Longest simulation time between two readings of a log for which the distance is counted."""
Sentence = Literal["GGA", "RMC", "VTG", "GLL", "ZDA", "HDT", "DBT", "DPT", "VBW", "VLW", "MTW"]
_SENTENCE = re.compile(rb"[$!]([ -)+-~]{1,1000})\*([0-9A-Fa-f]{2})")

# Key of the table -> talker, fields that the sensor must have, fields that it may have, sentences.
_ROLES: dict[str, tuple[str, tuple[str, ...], tuple[str, ...], tuple[Sentence, ...]]] = {
    "gps": (
        "GP",
        ("latitude", "longitude", "height", "v_NS", "satellites", "fix"),
        (),
        ("GGA", "RMC", "VTG", "GLL", "ZDA"),
    ),
    "heading": ("HE", ("heading",), (), ("HDT",)),
    "altimeter": ("SD", ("range",), (), ("DBT", "DPT")),
    "speed_log": ("VD", ("v_S",), ("v_water_S",), ("VBW", "VLW")),
    "temperature": ("YX", ("temperature",), (), ("MTW",)),
}


class Nmea0183Table(DeviceTable, tag="nmea0183", kw_only=True, frozen=True):
    """Attributes:
    gps: sensor for GGA, RMC, VTG, GLL, ZDA.
    heading: sensor for HDT (an attitude sensor or gyrocompass).
    altimeter: sensor for DBT and DPT.
    speed_log: sensor for VBW and VLW (a DVL).
    temperature: sensor for MTW.
    sentences: sentences to send; default: all that the sensors allow.
    rate_hz: highest rate of each sentence, in simulation time.
    transducer_offset_m: offset in DPT: distance from the transducer up to the waterline, or, negative, down to the keel.
    """

    gps: Name | None = None
    heading: Name | None = None
    altimeter: Name | None = None
    speed_log: Name | None = None
    temperature: Name | None = None
    sentences: tuple[Sentence, ...] = ()
    rate_hz: Annotated[Positive, Meta(le=100)] = 1.0
    transducer_offset_m: float = 0.0

    def build(self, context: AdapterContext) -> Nmea0183:
        """Return the device."""
        return Nmea0183(self, context)


def is_sentence(line: bytes) -> bool:
    """Return whether a line, without its end, is a sentence with the right checksum."""
    found = _SENTENCE.fullmatch(line)
    return found is not None and checksum(found[1]) == int(found[2], 16)


def degrees_minutes(angle: float, degrees: int) -> str:
    """Return degrees and minutes without a sign, to 1e-5 minutes, which are 2 cm.

    Args:
        angle: rad.
        degrees: digits of the whole degrees: 2 for a latitude, 3 for a longitude.
    """
    # Rounded first, in parts of a minute: otherwise rounding could give sixty minutes.
    parts = round(abs(deg(angle)) * 60 * 100_000)
    whole, rest = divmod(parts, 60 * 100_000)
    return f"{whole:0{degrees}d}{rest // 100_000:02d}.{rest % 100_000:05d}"


def _place(said: Mapping[str, Any]) -> tuple[str, str, str, str]:
    if not said["fix"]:
        return "", "", "", ""
    latitude, longitude = said["latitude"], said["longitude"]
    return (
        degrees_minutes(latitude, 2), "N" if latitude >= 0.0 else "S",
        degrees_minutes(longitude, 3), "E" if longitude >= 0.0 else "W",
    )  # fmt: skip


def _course(said: Mapping[str, Any]) -> tuple[float, str]:
    """Return speed over ground (m/s), and course over ground in degrees from true north, "" at rest."""
    north, east = said["v_NS"][0], said["v_NS"][1]
    speed = math.hypot(north, east)
    return speed, _turn(math.atan2(east, north)) if speed > 0.01 else ""


def _turn(angle: float) -> str:
    """Return an angle (rad) in degrees from 0.00 to 359.99."""
    return f"{round(deg(angle) * 100) % 36000 / 100:.2f}"


class _Log:
    """Counts the distance of a speed log, m.

    Attributes:
        total: since this server began.
        trip: since the time of the world began.
    """

    def __init__(self) -> None:
        self.total = self.trip = 0.0
        self._t_ns: int | None = None

    def see(self, t_ns: int, velocity: object) -> None:
        """Take a velocity (m/s) at a time; None, or one with a missing component, where it was not measured."""
        before, self._t_ns = self._t_ns, t_ns
        v = _whole(velocity)
        if before is None or v is None or not 0 < t_ns - before <= GAP_S * NANOSECONDS:
            return
        step = math.hypot(v[0], v[1]) * (t_ns - before) / NANOSECONDS
        self.total += step
        self.trip += step

    def begin(self) -> None:
        """Begin a trip: the time of the world was set back."""
        self._t_ns, self.trip = None, 0.0

    def fields(self) -> tuple[str, str, str, str]:
        """Return total and trip in nautical miles, as VLW has them."""
        return f"{self.total / MILE:.3f}", "N", f"{self.trip / MILE:.3f}", "N"


class Nmea0183:
    """The device: all sentences of a table.

    Attributes:
        subscriptions: ports of its sensors.
    """

    def __init__(self, table: Nmea0183Table, context: AdapterContext) -> None:
        self._table, self._context = table, context
        self._period_ns = round(NANOSECONDS / table.rate_hz)
        self._water, self._ground = _Log(), _Log()
        self._sources: dict[str, list[tuple[str, DeviceInput, list[Sentence]]]] = {}
        self._due: dict[str, int] = {}
        self._write: dict[Sentence, Callable[[Mapping[str, Any], datetime], Iterable[str]]] = {
            "GGA": _gga, "RMC": _rmc, "VTG": _vtg, "GLL": _gll, "ZDA": _zda, "HDT": _hdt, "DBT": _dbt, "DPT": self._dpt,
            "VBW": _vbw, "VLW": self._vlw, "MTW": _mtw,
        }  # fmt: skip
        for role, (_, needed, optional, sentences) in _ROLES.items():
            path = getattr(table, role)
            if path is not None:
                source = DeviceInput(role, path, context.ports, needed, optional)
                chosen = [kind for kind in sentences if not table.sentences or kind in table.sentences]
                self._sources.setdefault(source.path, []).append((role, source, chosen))
            elif missing := [kind for kind in table.sentences if kind in sentences]:
                raise CannotServe(f"sentences: {missing[0]} needs a sensor: give {role}")
        if not self._sources:
            raise CannotServe(f"gps: no sensor is named: give one of {', '.join(_ROLES)}")
        self.subscriptions: Collection[str] = self._sources.keys()

    def reader(self) -> LineReader[bytes]:
        """Return a reader of lines."""
        return LineReader(LINE_LIMIT, bytes)

    def take(self, message: bytes, reply: Reply) -> str:
        """Check a line. Nobody asks anything of these devices, but what is no sentence is counted."""
        return "" if is_sentence(message) else "a line is no sentence of NMEA 0183, or its checksum is wrong"

    def reset(self) -> None:
        """Start again at another time."""
        self._due.clear()
        self._water.begin()
        self._ground.begin()

    def see(self, sample: Sample) -> list[bytes]:
        """Take a reading. Returns its sentences, if they are due.

        Sentences of a receiver or log say that a reading is invalid; other sensors send nothing then.
        """
        messages: list[bytes] = []
        for role, source, sentences in self._sources[sample.port]:
            said = {**source.values(sample), "valid": sample.valid}
            if role == "gps" and not sample.valid:
                said["fix"] = 0
            if role == "speed_log":
                self._ground.see(sample.t_ns, said["v_S"])
                self._water.see(sample.t_ns, said.get("v_water_S"))
            if (not sample.valid and role not in ("gps", "speed_log")) or not self._is_due(role, sample.t_ns):
                continue
            utc = instant(self._context.world.epoch_ns + sample.t_ns)
            talker = _ROLES[role][0]
            messages += [sentence(talker + kind, self._write[kind](said, utc)) for kind in sentences]
        return messages

    def _is_due(self, role: str, t_ns: int) -> bool:
        due = self._due.get(role, t_ns)
        if t_ns < due:
            return False
        self._due[role] = max(due + self._period_ns, t_ns - self._period_ns + 1)
        return True

    def _dpt(self, said: Mapping[str, Any], _: datetime) -> Iterable[str]:
        return f"{said['range']:.2f}", f"{self._table.transducer_offset_m:.2f}", ""

    def _vlw(self, said: Mapping[str, Any], _: datetime) -> Iterable[str]:
        water = self._water.fields() if "v_water_S" in said else ("", "N", "", "N")
        return *water, *self._ground.fields()


def _whole(v: object) -> Vec3 | None:
    """Return a velocity; None where it was not measured."""
    return cast(Vec3, v) if isinstance(v, tuple) and None not in v else None


def _time(utc: datetime) -> str:
    return f"{utc:%H%M%S}.{utc.microsecond // 10_000:02d}"


def _gga(said: Mapping[str, Any], utc: datetime) -> Iterable[str]:
    has_fix = bool(said["fix"])
    satellites = f"{said['satellites'] or 0:02d}"
    # Dilution of precision is not simulated: the standard leaves the field of an unknown value empty.
    height = (f"{said['height']:.2f}", "M", "0.0", "M") if has_fix else ("", "M", "", "M")
    return _time(utc), *_place(said), "1" if has_fix else "0", satellites, "", *height, "", ""


def _rmc(said: Mapping[str, Any], utc: datetime) -> Iterable[str]:
    if not said["fix"]:
        return _time(utc), "V", *_place(said), "", "", f"{utc:%d%m%y}", "", "", "N"
    speed, course = _course(said)
    return _time(utc), "A", *_place(said), f"{speed / KNOT:.3f}", course, f"{utc:%d%m%y}", "", "", "A"


def _vtg(said: Mapping[str, Any], _: datetime) -> Iterable[str]:
    if not said["fix"]:
        return "", "T", "", "M", "", "N", "", "K", "N"
    speed, course = _course(said)
    return course, "T", "", "M", f"{speed / KNOT:.3f}", "N", f"{speed * 3.6:.3f}", "K", "A"


def _gll(said: Mapping[str, Any], utc: datetime) -> Iterable[str]:
    return *_place(said), _time(utc), "A" if said["fix"] else "V", "A" if said["fix"] else "N"


def _zda(_: Mapping[str, Any], utc: datetime) -> Iterable[str]:
    return _time(utc), f"{utc:%d}", f"{utc:%m}", f"{utc:%Y}", "00", "00"


def _hdt(said: Mapping[str, Any], _: datetime) -> Iterable[str]:
    return _turn(said["heading"]), "T"


def _dbt(said: Mapping[str, Any], _: datetime) -> Iterable[str]:
    depth = said["range"]
    return f"{depth / FOOT:.2f}", "f", f"{depth:.2f}", "M", f"{depth / FATHOM:.2f}", "F"


def _vbw(said: Mapping[str, Any], _: datetime) -> Iterable[str]:
    fields: list[str] = []
    for v in (_whole(said.get("v_water_S")), _whole(said["v_S"])):
        fields += ["", "", "V"] if v is None else [f"{v[0] / KNOT:.3f}", f"{v[1] / KNOT:.3f}", "A"]
    return fields


def _mtw(said: Mapping[str, Any], _: datetime) -> Iterable[str]:
    return f"{said['temperature']:.2f}", "C"
