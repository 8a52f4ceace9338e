"""`uwserver replay`: a recording once more, and whether it gives the same."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

if TYPE_CHECKING:
    from uwserver.recording.replay import Replayed

_FILE = click.Path(path_type=Path)


@click.command(short_help="Run the requests of a recording again, and compare.")
@click.argument("file", type=_FILE)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
@click.option(
    "--extension", "extensions", multiple=True, type=_FILE, help="Python file that its scenario used; it is run."
)
def replay(file: Path, as_json: bool, extensions: tuple[Path, ...]) -> None:
    """Run the commands and calls of a recording (`uwserver run --record FILE`) again, as fast as possible, and compare all state hashes.

    Exits with 0 if all are equal, with 1 at the first difference or if the file cannot be replayed.
    """
    from uwserver.recording.replay import NotReplayable
    from uwserver.recording.replay import replay as replay_file

    try:
        result = replay_file(file, extensions)
    except NotReplayable as error:
        raise click.ClickException(str(error)) from error
    except OSError as error:
        raise click.ClickException(f"{file}: {error.strerror or error}") from error
    click.echo(_as_json(file, result) if as_json else _as_text(file, result))
    if result.difference is not None:
        raise SystemExit(1)


def _as_json(file: Path, result: Replayed) -> str:
    whole = {
        "file": str(file),
        "equal": result.difference is None,
        "ticks": result.ticks,
        "requests": result.requests,
        "hashes": result.hashes,
        "truncated": result.truncated,
        "difference": asdict(result.difference) if result.difference else None,
        "recorded": msgspec.structs.asdict(result.recorded),
        "here": msgspec.structs.asdict(result.here),
    }
    return json.dumps(whole, indent=2)


def _as_text(file: Path, result: Replayed) -> str:
    lines = [f"{file}: {result.ticks} ticks, {result.requests} requests, {result.hashes} hashes equal"]
    found = result.difference
    if found is not None:
        lines[0] += f"; differs in tick {found.tick} (t = {found.t_ns / 1e9:g} s, entry {found.index})"
        lines += [f"  expected {found.expected}", f"  found    {found.found}", *_reasons(result)]
    if result.truncated:
        cut = "its server was killed, or the disk was full"
        lines.append(f"The recording has no end ({cut}): replayed to its last whole chunk.")
    return "\n".join(lines)


def _reasons(result: Replayed) -> list[str]:
    changed = result.changed_versions
    if not changed:
        why = "the file was changed, or the simulation depends on something else"
        return [f"All versions are those of the recording: {why}."]
    return [f"Recorded with {name} {then}, here is {now}: that may be why." for name, (then, now) in changed.items()]


COMMANDS = (replay,)
