"""The command `compare`: how far two recordings differ, for people and for tests of controllers."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from uwserver.cli.loading import require_kind
from uwserver.cli.terminal import FILE, SECONDS, told
from uwserver.ports.checks import suggestion
from uwserver.ports.values import matches, matching
from uwserver.units import NANOSECONDS

if TYPE_CHECKING:
    from uwserver.recording.compare import Compared
    from uwserver.recording.differences import Distance

_TAKES = (
    "compare takes what `uwserver run --record FILE` or `uwserver record` has written. A log of another origin becomes such a file: "
    "serve it by `uwserver play LOG --port 0 --paused`, write that down by `uwserver record 127.0.0.1:PORT OUT.mcap`, and call playback/resume"
)


@dataclass(frozen=True)
class Limit:
    """The largest difference that is allowed for a field.

    Attributes:
        measure: "rms" or "max".
        port, field: names of the port, which may be a pattern, and of its field.
        most: the limit in the unit of the field, in rad for an attitude.
    """

    measure: str
    port: str
    field: str
    most: float

    def __str__(self) -> str:
        return f"--{self.measure} {self.port}.{self.field}={self.most:g}"


@click.command(short_help="Compare two recordings, port by port.")
@click.argument("a", type=FILE)
@click.argument("b", type=FILE)
@click.option(
    "--ports",
    default="**",
    show_default=True,
    help="Pattern of the ports to compare: * is one level, ** any number of levels.",
)
@click.option("--from", "from_s", type=SECONDS, default=0.0, help="Compare from this simulation time on, s.")
@click.option("--to", "to_s", type=SECONDS, help="Compare up to this simulation time, s.")
@click.option(
    "--rms", multiple=True, metavar="PORT.FIELD=LIMIT", help="Limit of the RMS difference; may be given several times."
)
@click.option(
    "--max",
    "largest",
    multiple=True,
    metavar="PORT.FIELD=LIMIT",
    help="Limit of the largest difference; may be given several times.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def compare(
    a: Path,
    b: Path,
    ports: str,
    from_s: float,
    to_s: float | None,
    rms: tuple[str, ...],
    largest: tuple[str, ...],
    as_json: bool,
) -> None:
    """Compare the recordings A and B: RMS and largest difference of each field, ports that only one of them has, and the first difference.

    Samples are paired by their times, and interpolated where the times differ. Angles are wrapped; attitudes are compared by the angle
    between them.

    uwserver compare before.mcap after.mcap --rms rov/truth/pose.p_NB=0.05 --max rov/truth/pose.q_NB=0.1

    The exit status is 0 if all limits are kept, or nothing differs where no limit is given. It is 1 if not, and 2 if a file or a limit is
    wrong.
    """
    from uwserver.recording.compare import compare as compare_files
    from uwserver.recording.reading import NoRecording, NotReplayable

    def advised(error: Exception) -> str:
        return f"{error}; {_TAKES}" if isinstance(error, NoRecording) else str(error)

    for file in (a, b):
        require_kind(file, "a recording", "recording", "log", status=2)
    with told(a, NotReplayable, ValueError, text=advised, status=2):
        limits = [*(_limit("rms", text) for text in rms), *(_limit("max", text) for text in largest)]
        end_ns = None if to_s is None else round(to_s * NANOSECONDS)
        found = compare_files(a, b, partial(matches, ports), round(from_s * NANOSECONDS), end_ns)
        verdicts = [verdict for limit in limits for verdict in _verdicts(limit, found)]
    is_fine = all(verdict["kept"] for verdict in verdicts) if limits else found.is_same
    click.echo(_json(a, b, found, verdicts, is_fine) if as_json else "\n".join(_text(a, b, found, verdicts)))
    raise SystemExit(0 if is_fine else 1)


def _limit(measure: str, text: str) -> Limit:
    name, equals, number = text.rpartition("=")
    port, dot, field = name.rpartition(".")
    try:
        most = float(number)
    except ValueError:
        most = math.nan
    if not (equals and dot and port and field and most >= 0.0):
        raise ValueError(f'"{text}" is no PORT.FIELD=LIMIT, as rov/truth/pose.p_NB=0.05')
    return Limit(measure, port, field, most)


def _verdicts(limit: Limit, found: Compared) -> Iterator[dict[str, Any]]:
    """Yield whether each field that a limit names keeps it. Raises ValueError if the limit names no field."""
    alone = matching(limit.port, sorted({*found.only[0], *found.only[1]}))
    for port in alone:
        yield _verdict(limit, port, None, "only one of them has it")
    ports = matching(limit.port, list(found.ports))
    fields = [
        (port, found.ports[port].fields[limit.field]) for port in ports if limit.field in found.ports[port].fields
    ]
    if not fields and not alone:
        if not ports:
            raise ValueError(f'{limit}: no port "{limit.port}"{suggestion(limit.port, list(found.ports))}')
        names = sorted({name for port in ports for name in found.ports[port].fields})
        raise ValueError(
            f'{limit}: no field "{limit.field}"{suggestion(limit.field, names)}; there are: {", ".join(names)}'
        )
    for port, distance in fields:
        if distance.unequal:
            yield _verdict(limit, port, None, f"{distance.unequal} times one has a value and the other not the same")
        elif not distance.count and not distance.column.is_word:
            yield _verdict(limit, port, None, "no two samples can be compared")
        else:
            value = distance.rms if limit.measure == "rms" else distance.largest
            yield _verdict(limit, port, value, "")


def _verdict(limit: Limit, port: str, value: float | None, why: str) -> dict[str, Any]:
    kept = value is not None and value <= limit.most
    return {
        "port": port, "field": limit.field, "measure": limit.measure, "limit": limit.most, "value": value, "kept": kept, "why": why,
    }  # fmt: skip


def unit_of(distance: Distance) -> str:
    """Return the unit in which a field differs; attitudes differ by an angle."""
    return "rad" if distance.column.is_quaternion else distance.column.unit


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a line for each row of a table, with the columns aligned at the left."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def _json(a: Path, b: Path, found: Compared, verdicts: list[dict[str, Any]], is_fine: bool) -> str:
    ports = {
        port: {
            "samples": pair.samples,
            "paired": pair.pairs[0],
            "interpolated": pair.pairs[1],
            "alone": pair.alone,
            "valid_differs": pair.valid.unequal,
            "fields": {
                name: {
                    "unit": unit_of(each), "count": each.count, "rms": each.rms, "max": each.largest, "max_ns": each.largest_ns,
                    "unequal": each.unequal, "first_ns": each.first_ns,
                }
                for name, each in pair.fields.items()
            },
        }
        for port, pair in found.ports.items()
    }  # fmt: skip
    states, first = found.states, found.first
    whole = {
        "a": str(a), "b": str(b), "within": is_fine, "same": found.is_same, "ports": ports,
        "only_in_a": found.only[0], "only_in_b": found.only[1],
        "states": {"equal": states.equal, "last_equal_ns": states.last_equal_ns, "first_difference_ns": states.first_ns},
        "first_difference": None if first is None else {"port": first[0], "field": first[1], "t_ns": first[2]},
        "limits": verdicts, "remarks": found.remarks,
    }  # fmt: skip
    return json.dumps(whole, indent=2)


def _text(a: Path, b: Path, found: Compared, verdicts: list[dict[str, Any]]) -> Iterator[str]:
    count = sum(pair.samples[0] for pair in found.ports.values()), sum(pair.samples[1] for pair in found.ports.values())
    yield f"{a} and {b}: {len(found.ports)} ports of both, with {count[0]} and {count[1]} samples"
    yield _state_line(found)
    if found.first is not None:
        port, field, t_ns = found.first
        yield f"first sample that differs: {port}.{field} at {t_ns / 1e9:.9g} s"
    for path, ports in zip((a, b), found.only, strict=True):
        if ports:
            yield f"only in {path}: {', '.join(ports)}"
    yield from found.remarks
    rows = list(_rows(found))
    if rows:
        yield ""
        yield from aligned([("port", "samples", "field", "RMS", "largest", "unit", "at", ""), *rows])
    for verdict in verdicts:
        value = verdict["why"] if verdict["value"] is None else f"{verdict['value']:.6g}"
        what = f"{verdict['measure']} of {verdict['port']}.{verdict['field']}: {value}"
        yield f"{'within' if verdict['kept'] else 'BEYOND'} {verdict['limit']:g}: {what}"


def _state_line(found: Compared) -> str:
    states = found.states
    if states.first_ns is None:
        return f"states: {states.equal} hashes equal" if states.equal else "states: no hashes to compare"
    last = states.last_equal_ns
    since = "from the first on" if last is None else f"the last equal one at {last / 1e9:g} s"
    return f"states: {states.equal} hashes equal, the first that differs at {states.first_ns / 1e9:g} s, {since}"


def _rows(found: Compared) -> Iterator[tuple[str, ...]]:
    """Yield a row for each field that differs."""
    for port, pair in found.ports.items():
        one, other = pair.samples
        count = f"{one}" if one == other else f"{one}/{other}"
        notes = [f"{pair.pairs[1]} interpolated"] if pair.pairs[1] else []
        notes += [f"{pair.alone} alone"] if pair.alone else []
        notes += ["not as many"] if one != other and not notes else []
        if pair.valid.unequal:
            notes.append(f"{pair.valid.unequal} valid in one only")
        for name, each in pair.fields.items():
            if each.is_same and not notes:
                continue
            more = [f"{each.unequal} unequal"] if each.unequal else []
            at = "" if each.largest_ns is None else f"{each.largest_ns / 1e9:.9g} s"
            numbers = (f"{each.rms:.4g}", f"{each.largest:.4g}") if each.count else ("", "")
            yield port, count, name, *numbers, unit_of(each), at, ", ".join([*notes, *more])
            notes = []
