"""The command `replay`: runs a recording again and compares, or runs it in a changed world."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from uwserver.cli.loading import require_kind
from uwserver.cli.recordings.compare import aligned, unit_of
from uwserver.cli.terminal import FILE, SECONDS, told

if TYPE_CHECKING:
    from uwserver.recording.estimation import Estimated
    from uwserver.recording.replay import Replayed

_SET = (
    "Change this key of the scenario, as in environment.current.velocity_ned_mps=[0.3,0,0]; may be given several times."
)
_CALL = "Call this service of the world at --from, with its arguments in JSON; may be given several times."
_ESTIMATE = "Run no world: give the recorded samples to the estimator of this vehicle's autopilot, and compare it with the truth."
_FROM = "Simulation time at which --set and --call change the world; what cannot change in a running world needs 0."


@click.command(short_help="Run the requests of a recording again, and compare.")
@click.argument("file", type=FILE)
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help=_SET)
@click.option("--call", "calls", multiple=True, metavar="SERVICE={...}", help=_CALL)
@click.option("--estimate", "vehicle", metavar="VEHICLE", help=_ESTIMATE)
@click.option("--from", "from_s", type=SECONDS, default=0.0, show_default=True, metavar="SECONDS", help=_FROM)
@click.option("--to", "to_s", type=SECONDS, metavar="SECONDS", help="End at this simulation time.")
@click.option("--record", type=FILE, help="Record this run to a file, which can be replayed in turn.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
@click.option(
    "--trust-files",
    is_flag=True,
    help="Run the extensions that the recording names: Python files beside it or in the working folder.",
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

    With --set or --call the world changes at --from, and only what was recorded before that is compared:

    uwserver replay dive.mcap --set environment.current.velocity_ned_mps=[0.3,0,0] --from 30 --record drifted.mcap

    With --estimate no world runs. The estimator gets the recorded samples again, with the settings of --set:

    uwserver replay dive.mcap --estimate rov --set vehicles.rov.sensors.dvl.enabled=false --record again.mcap

    The exit status is 0 if all hashes are equal, 1 if one differs or the file cannot be replayed, and 2 if the world cannot be changed as
    asked.
    """
    from uwserver.recording.changes import Changes, asked, setting
    from uwserver.recording.estimation import estimate
    from uwserver.recording.replay import kinds_of_extensions
    from uwserver.recording.replay import replay as replay_file

    require_kind(file, "a recording", "recording", "log")
    with _faults_told(file):
        changes = Changes(tuple(map(setting, settings)), tuple(map(asked, calls)), from_s)
        extensions = _extensions(file) if trust_files else []
        if vehicle is None:
            result = replay_file(file, extensions, changes=changes, to_s=to_s, record=record)
        elif calls or from_s or to_s is not None:
            raise click.UsageError(
                "--estimate hears the whole recording: it takes --set and --record, no --call, --from or --to"
            )
        else:
            found = estimate(file, vehicle, changes.settings, kinds_of_extensions(extensions), record)
    if vehicle is not None:
        click.echo(_estimate_as_json(file, found) if as_json else _estimate_as_text(file, found, record))
        return
    click.echo(_as_json(file, result, record) if as_json else _as_text(file, result, record))
    if result.difference is not None or result.diverged:
        raise SystemExit(1)


@contextmanager
def _faults_told(file: Path) -> Iterator[None]:
    """Report what is wrong with the file, as `told`, or with the options that change the world."""
    from uwserver.recording.changes import BadChange
    from uwserver.recording.replay import NotReplayable

    try:
        with told(file, NotReplayable):
            yield
    except BadChange as error:
        raise click.UsageError(str(error)) from error


def _extensions(file: Path) -> list[Path]:
    """Return the files that the recording names. No name in a recording may lead out of its folder or the working folder."""
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


def _estimate_as_json(file: Path, found: Estimated) -> str:
    fields = {
        name: {
            "unit": unit_of(before), "count": before.count, "rms_before": before.rms, "rms_after": after.rms,
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
            rows.append((name, f"{before.rms:.4g}" if before.count else "-", f"{after.rms:.4g}", unit_of(before)))
    if len(rows) > 1:
        lines += aligned(rows)
    if record is not None:
        lines.append(f"wrote {record}, where {found.port} is the new estimate")
    return "\n".join(lines)


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
