"""NMEA 0183: sentences of satellite receiver, compass, echosounder, speed log and thermometer (IEC 61162-1)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from datetime import datetime
from typing import Annotated, Any, Literal, cast

from msgspec import Meta

from uwserver.adapter import AdapterContext, CannotServe
from uwserver.ports import Sample
from uwserver.table import Name, Positive
from uwserver_adapters.devices.codec import NANOSECONDS, deg, instant
from uwserver_adapters.devices.device import DeviceTable, LineReader, Reply, Source

LINE_LIMIT = 1024
"""Longest line that is read of a peer, bytes; a sentence has 82."""
KNOT = 1852.0 / 3600.0
"""m/s."""
MILE = 1852.0
FOOT, FATHOM = 0.3048, 1.8288
GAP_S = 10.0
"""Simulation time above which the distance between two readings of a log is not counted."""
Sentence = Literal["GGA", "RMC", "VTG", "GLL", "ZDA", "HDT", "DBT", "DPT", "VBW", "VLW", "MTW"]
_SENTENCE = re.compile(rb"[$!]([ -)+-~]{1,1000})\*([0-9A-Fa-f]{2})")

# By key of the table: talker, fields that are needed, fields that may be there, sentences.
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
    gps: sensor of GGA, RMC, VTG, GLL, ZDA.
    heading: sensor of HDT (an attitude sensor or gyrocompass).
    altimeter: sensor of DBT and DPT.
    speed_log: sensor of VBW and VLW (a DVL).
    temperature: sensor of MTW.
    sentences: those that are sent, of those that the sensors allow; default: all.
    rate_hz: of each sentence at most, simulation time.
    transducer_offset_m: what DPT tells: the waterline above the transducer, or, negative, the keel below it.
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
        """The device."""
        return Nmea0183(self, context)


def checksum(body: bytes) -> int:
    """Exclusive or of all characters between the first and the asterisk."""
    total = 0
    for byte in body:
        total ^= byte
    return total


def sentence(address: str, fields: Iterable[str]) -> bytes:
    """A whole line: ``sentence("GPHDT", ("12.3", "T"))`` is ``$GPHDT,12.3,T*2B``, CR and LF."""
    body = ",".join((address, *fields)).encode("ascii")
    return b"$%b*%02X\r\n" % (body, checksum(body))


def is_sentence(line: bytes) -> bool:
    """Whether a line without its end is one, with the right checksum."""
    found = _SENTENCE.fullmatch(line)
    return found is not None and checksum(found[1]) == int(found[2], 16)


def degrees_minutes(angle: float, degrees: int) -> str:
    """Degrees and minutes without a sign; 1e-5 minutes are 2 cm.

    Args:
        angle: rad.
        degrees: digits of the whole degrees: 2 of a latitude, 3 of a longitude.
    """
    # In whole parts of a minute, so that rounding never gives sixty minutes.
    parts = round(abs(deg(angle)) * 60 * 100_000)
    whole, rest = divmod(parts, 60 * 100_000)
    return f"{whole:0{degrees}d}{rest // 100_000:02d}.{rest % 100_000:05d}"


def _place(said: Mapping[str, Any]) -> tuple[str, str, str, str]:
    if not said["fix"]:
        return "", "", "", ""
    north, east = said["latitude"] >= 0.0, said["longitude"] >= 0.0
    return (
        degrees_minutes(said["latitude"], 2), "N" if north else "S",
        degrees_minutes(said["longitude"], 3), "E" if east else "W",
    )  # fmt: skip


def _course(said: Mapping[str, Any]) -> tuple[float, str]:
    """Speed over ground (m/s), and course over ground in degrees from true north; none at rest."""
    north, east = said["v_NS"][0], said["v_NS"][1]
    speed = math.hypot(north, east)
    return speed, f"{_turn(math.atan2(east, north))}" if speed > 0.01 else ""


def _turn(angle: float) -> str:
    """Degrees from 0.00 to 359.99 of an angle in rad."""
    return f"{round(deg(angle) * 100) % 36000 / 100:.2f}"


class _Log:
    """Distance that a log has counted, m; from when this server began."""

    def __init__(self) -> None:
        self.total = 0.0
        self.trip = 0.0
        self._t_ns: int | None = None

    def see(self, t_ns: int, velocity: tuple[float, float, float] | None) -> None:
        """A velocity (m/s) of a time; None where it was not measured."""
        before, self._t_ns = self._t_ns, t_ns
        if before is None or velocity is None or not 0 < t_ns - before <= GAP_S * NANOSECONDS:
            return
        step = math.hypot(velocity[0], velocity[1]) * (t_ns - before) / NANOSECONDS
        self.total += step
        self.trip += step

    def begin(self) -> None:
        """Time begins again, and so does the trip."""
        self._t_ns, self.trip = None, 0.0


class Nmea0183:
    """The sentences.

    Attributes:
        wanted: ports of its sensors.
    """

    def __init__(self, table: Nmea0183Table, context: AdapterContext) -> None:
        self._table, self._context = table, context
        self._period_ns = round(NANOSECONDS / table.rate_hz)
        self._water, self._ground = _Log(), _Log()
        self._sources: dict[str, list[tuple[str, Source, list[Sentence]]]] = {}
        self._due: dict[str, int] = {}
        self._write: dict[Sentence, Callable[[Mapping[str, Any], datetime], Iterable[str]]] = {
            "GGA": _gga, "RMC": _rmc, "VTG": _vtg, "GLL": _gll, "ZDA": _zda, "HDT": _hdt, "DBT": _dbt, "DPT": self._dpt,
            "VBW": _vbw, "VLW": self._vlw, "MTW": _mtw,
        }  # fmt: skip
        allowed: list[str] = []
        for role, (_, needed, optional, sentences) in _ROLES.items():
            path = getattr(table, role)
            if path is None:
                continue
            source = Source(role, path, context.ports, needed, optional)
            allowed += sentences
            chosen = [kind for kind in sentences if not table.sentences or kind in table.sentences]
            self._sources.setdefault(source.path, []).append((role, source, chosen))
        for kind in table.sentences:
            if kind not in allowed:
                roles = [role for role, (_, _, _, sentences) in _ROLES.items() if kind in sentences]
                raise CannotServe(f"sentences: {kind} needs a sensor: give {roles[0]}")
        if not self._sources:
            raise CannotServe(f"gps: no sensor is named: give one of {', '.join(_ROLES)}")
        self.wanted: Collection[str] = self._sources.keys()

    def reader(self) -> LineReader:
        """Lines."""
        return LineReader(LINE_LIMIT)

    def take(self, message: bytes, reply: Reply) -> str:
        """Nothing is asked of these devices; what is no sentence is counted."""
        return "" if is_sentence(message) else "a line is no sentence of NMEA 0183, or its checksum is wrong"

    def reset(self) -> None:
        """The time of the world begins again."""
        self._due.clear()
        self._water.begin()
        self._ground.begin()

    def see(self, sample: Sample) -> list[bytes]:
        """A reading; all its sentences that are due. An invalid one of a receiver or log is told as such, of others nothing is said."""
        messages: list[bytes] = []
        for role, source, sentences in self._sources[sample.port]:
            said = {**source.values(sample), "valid": sample.valid}
            if role == "gps" and not sample.valid:
                said["fix"] = 0
            if role == "speed_log":
                self._ground.see(sample.t_ns, _whole(said["v_S"]))
                self._water.see(sample.t_ns, _whole(said.get("v_water_S")))
            if (not sample.valid and role not in ("gps", "speed_log")) or not self._is_due(role, sample.t_ns):
                continue
            utc = self._utc(sample.t_ns)
            talker = _ROLES[role][0]
            messages += [sentence(talker + kind, self._write[kind](said, utc)) for kind in sentences]
        return messages

    def _is_due(self, role: str, t_ns: int) -> bool:
        due = self._due.get(role, t_ns)
        if t_ns < due:
            return False
        self._due[role] = max(due + self._period_ns, t_ns - self._period_ns + 1)
        return True

    def _utc(self, t_ns: int) -> datetime:
        return instant(self._context.world.epoch_ns + t_ns)

    def _dpt(self, said: Mapping[str, Any], _: datetime) -> Iterable[str]:
        return f"{said['range']:.2f}", f"{self._table.transducer_offset_m:.2f}", ""

    def _vlw(self, said: Mapping[str, Any], _: datetime) -> Iterable[str]:
        has_water = "v_water_S" in said
        water = [f"{d / MILE:.3f}" if has_water else "" for d in (self._water.total, self._water.trip)]
        ground = [f"{d / MILE:.3f}" for d in (self._ground.total, self._ground.trip)]
        return water[0], "N", water[1], "N", ground[0], "N", ground[1], "N"


def _whole(v: object) -> tuple[float, float, float] | None:
    """A velocity; None where it was not measured."""
    return cast(tuple[float, float, float], v) if isinstance(v, tuple) and None not in v else None


def _time(utc: datetime) -> str:
    return f"{utc:%H%M%S}.{utc.microsecond // 10_000:02d}"


def _gga(said: Mapping[str, Any], utc: datetime) -> Iterable[str]:
    has_fix = bool(said["fix"])
    satellites = f"{said['satellites'] or 0:02d}"
    # Dilution of precision is not simulated: its field is empty, as the standard has it for what is not known.
    height = (f"{said['height']:.2f}", "M", "0.0", "M") if has_fix else ("", "M", "", "M")
    return _time(utc), *_place(said), "1" if has_fix else "0", satellites, "", *height, "", ""


def _rmc(said: Mapping[str, Any], utc: datetime) -> Iterable[str]:
    has_fix = bool(said["fix"])
    speed, course = _course(said) if has_fix else (0.0, "")
    knots = f"{speed / KNOT:.3f}" if has_fix else ""
    return (
        _time(utc),
        "A" if has_fix else "V",
        *_place(said),
        knots,
        course,
        f"{utc:%d%m%y}",
        "",
        "",
        "A" if has_fix else "N",
    )


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
