"""`uwserver replay`: a recording once more, and whether it gives the same; or what it would have given in another world."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click
import msgspec

if TYPE_CHECKING:
    from uwserver.recording.changes import Changes
    from uwserver.recording.differences import Distance
    from uwserver.recording.estimation import Estimated
    from uwserver.recording.replay import Replayed

T = TypeVar("T")
_FILE = click.Path(path_type=Path)
_SECONDS = click.FloatRange(0.0, 1e9)
_SET = "Change this key of the scenario, as environment.current.velocity_ned_mps=[0.3,0,0]; may be given several times."
_CALL = "Call this service of the world at --from, its arguments in JSON; may be given several times."
_ESTIMATE = "Give the recorded samples to the estimator of this vehicle's autopilot alone, and measure it by the truth."
_FROM = "Change the world at this simulation time, s; what is fixed in a world that runs needs 0."


@click.command(short_help="Run the requests of a recording again, and compare.")
@click.argument("file", type=_FILE)
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help=_SET)
@click.option("--call", "calls", multiple=True, metavar="SERVICE={...}", help=_CALL)
@click.option("--estimate", "vehicle", metavar="VEHICLE", help=_ESTIMATE)
@click.option("--from", "from_s", type=_SECONDS, default=0.0, show_default=True, metavar="SECONDS", help=_FROM)
@click.option("--to", "to_s", type=_SECONDS, metavar="SECONDS", help="End at this simulation time.")
@click.option("--record", type=_FILE, help="Write the run as it goes now to this file, which can be replayed again.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
@click.option(
    "--trust-files",
    is_flag=True,
    help="Run the extensions that the recording names: Python files beside it, or in the working folder.",
)
def replay(
    file: Path,
    settings: tuple[str, ...],
    calls: tuple[str, ...],
    vehicle: str | None,
    from_s: float,
    to_s: float | None,
    record: Path | None,
    as_json: bool,
    trust_files: bool,
) -> None:
    """Run the commands and calls of a recording (`uwserver run --record FILE`) again, as fast as possible, and compare all state hashes.

    With --set or --call the world is another one from --from on, and what was recorded until then is compared:

    uwserver replay dive.mcap --set environment.current.velocity_ned_mps=[0.3,0,0] --from 30 --record drifted.mcap

    With --estimate no world is run: the recorded samples go to the estimator once more, as --set has it:

    uwserver replay dive.mcap --estimate rov --set vehicles.rov.sensors.dvl.enabled=false --record again.mcap

    Exits with 0 if all are equal, with 1 at the first difference or if the file cannot be replayed, with 2 if the world cannot be changed so.
    """
    from uwserver.recording.replay import replay as replay_file

    changes = _told(lambda: _changes(settings, calls, from_s), file)
    extensions = _told(lambda: _extensions(file, trust_files), file)
    if vehicle is not None:
        if calls or from_s or to_s is not None:
            raise click.UsageError(
                "--estimate hears the whole recording: it takes --set and --record, no --call, --from or --to"
            )
        found = _told(lambda: _estimated(file, vehicle, changes, extensions, record), file)
        click.echo(_estimate_as_json(file, found) if as_json else _estimate_as_text(file, found, record))
        return
    result = _told(lambda: replay_file(file, extensions, changes=changes, to_s=to_s, record=record), file)
    click.echo(_as_json(file, result, record) if as_json else _as_text(file, result, record))
    if result.difference is not None or result.diverged:
        raise SystemExit(1)


def _changes(settings: tuple[str, ...], calls: tuple[str, ...], from_s: float) -> Changes:
    from uwserver.recording.changes import Changes, asked, setting

    return Changes(tuple(map(setting, settings)), tuple(map(asked, calls)), from_s)


def _told(work: Callable[[], T], file: Path) -> T:
    """The result; what went wrong, as the command line tells it."""
    from uwserver.recording.changes import BadChange
    from uwserver.recording.replay import NotReplayable

    try:
        return work()
    except BadChange as error:
        raise click.UsageError(str(error)) from error
    except NotReplayable as error:
        raise click.ClickException(str(error)) from error
    except OSError as error:
        text = str(error) if error.strerror is None else f"{error.filename or file}: {error.strerror}"
        raise click.ClickException(text) from error


def _extensions(file: Path, trusted: bool) -> list[Path]:
    """The files that the recording names, where they are trusted: no name in a log leads out of its folder or the working folder."""
    if not trusted:
        return []
    from uwserver.recording.reading import NotReplayable, Reading

    with Reading(file) as reading:
        try:
            names = msgspec.json.decode(reading.record["scenario"])["scenario"].get("extensions", [])
        except (KeyError, TypeError, AttributeError, msgspec.MsgspecError) as error:
            raise NotReplayable(f"{file}: its scenario cannot be read: {error}") from error
    return [_found(str(name), (file.parent, Path.cwd())) for name in names]


def _found(name: str, folders: tuple[Path, ...]) -> Path:
    from uwserver.recording.reading import NotReplayable

    for folder in folders:
        path = (folder / name).resolve()
        if path.is_relative_to(folder.resolve()) and path.is_file():
            return path
    where = " or ".join(f'"{folder}"' for folder in folders)
    raise NotReplayable(
        f'its components come from "{name}", which is not in {where}: put it there, or go to its folder'
    )


def _estimated(file: Path, vehicle: str, changes: Changes, extensions: list[Path], record: Path | None) -> Estimated:
    from uwserver.recording.estimation import estimate
    from uwserver.recording.replay import kinds_of_extensions

    return estimate(file, vehicle, changes.settings, kinds_of_extensions(extensions), record)


def _estimate_as_json(file: Path, found: Estimated) -> str:
    fields = {
        name: {
            "unit": _unit_of(before), "count": before.count, "rms_before": before.rms, "rms_after": after.rms,
            "max_before": before.largest, "max_after": after.largest,
        }
        for (name, before), after in zip(found.before.items(), found.after.values(), strict=True)
    }  # fmt: skip
    whole = {
        "file": str(file), "port": found.port, "samples": found.samples, "end_ns": found.end_ns, "fields": fields,
        "remarks": found.remarks,
    }  # fmt: skip
    return json.dumps(whole, indent=2)


def _estimate_as_text(file: Path, found: Estimated, record: Path | None) -> str:
    lines = [f"{file}: {found.samples} samples heard, to {found.end_ns / 1e9:g} s", *found.remarks]
    rows = [("RMS against the truth", "recorded", "now", "")]
    for (name, before), after in zip(found.before.items(), found.after.values(), strict=True):
        if after.count:
            rows.append((name, f"{before.rms:.4g}" if before.count else "-", f"{after.rms:.4g}", _unit_of(before)))
    if len(rows) > 1:
        widths = [max(len(row[k]) for row in rows) for k in range(4)]
        lines += [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
        ]
    if record is not None:
        lines.append(f"wrote {record}, where {found.port} is the new estimate")
    return "\n".join(lines)


def _unit_of(distance: Distance) -> str:
    return "rad" if distance.column.is_quaternion else distance.column.unit


def _as_json(file: Path, result: Replayed, record: Path | None) -> str:
    whole = {
        "file": str(file),
        "equal": result.difference is None,
        "ticks": result.ticks,
        "requests": result.requests,
        "hashes": result.hashes,
        "truncated": result.truncated,
        "difference": asdict(result.difference) if result.difference else None,
        "changed_ns": result.changed_ns,
        "end_ns": result.end_ns,
        "refused": result.refused[0],
        "diverged": result.diverged,
        "record": None if record is None or result.difference else str(record),
        "recorded": msgspec.structs.asdict(result.recorded),
        "here": msgspec.structs.asdict(result.here),
    }
    return json.dumps(whole, indent=2)


def _as_text(file: Path, result: Replayed, record: Path | None) -> str:
    lines = [f"{file}: {result.ticks} ticks, {result.requests} requests, {result.hashes} hashes equal"]
    found = result.difference
    if found is not None:
        lines[0] += f"; differs in tick {found.tick} (t = {found.t_ns / 1e9:g} s, entry {found.index})"
        lines += [f"  expected {found.expected}", f"  found    {found.found}", *_reasons(result)]
    elif result.changed_ns is not None:
        lines[0] += f"; another world from {result.changed_ns / 1e9:g} s to {result.end_ns / 1e9:g} s"
    count, first = result.refused
    if count:
        lines.append(f"It refused {count} request{'s' * (count > 1)}, first at {first}")
    if result.diverged:
        lines.append(f"It could not go on: {result.diverged}")
    if result.truncated:
        cut = "its server was killed, or the disk was full"
        lines.append(f"The recording has no end ({cut}): replayed to its last whole chunk.")
    if record is not None:
        lines.append(f"wrote {record}" if found is None else f"{record} was not written")
    return "\n".join(lines)


def _reasons(result: Replayed) -> list[str]:
    changed = result.changed_versions
    if not changed:
        why = "the file was changed, or the simulation depends on something else"
        return [f"All versions are those of the recording: {why}."]
    return [f"Recorded with {name} {then}, here is {now}: that may be why." for name, (then, now) in changed.items()]


COMMANDS = (replay,)
