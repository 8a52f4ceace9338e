"""The command `export`: writes a log of any origin in another format."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path

import click

from uwserver.cli.loading import require_kind
from uwserver.cli.terminal import FILE, printable, printable_error, told
from uwserver.logfiles import Log, LogError
from uwserver.logfiles.export.middleware import write_alog, write_rosbag2, write_tlog
from uwserver.logfiles.export.tables import TopicTable, topic_tables, write_csv, write_mat, write_netcdf, write_parquet
from uwserver.logfiles.export.video import write_mp4
from uwserver.logfiles.mapping import Mapping, read_mapping
from uwserver.logfiles.poses import FoundTrack, pose_tracks
from uwserver.logfiles.readers.opening import open_parts
from uwserver.logfiles.rules import mapping_of
from uwserver.packages import install_command
from uwserver.ports import matching
from uwserver.recording.format import EVENTS

_ENDS = {
    "parquet": "_parquet",
    "csv": "_csv",
    "netcdf": ".nc",
    "mat": ".mat",
    "rosbag2": "_rosbag2",
    "alog": ".alog",
    "tlog": ".tlog",
    "mp4": ".mp4",
}
_FOLDERS = ("parquet", "csv", "rosbag2")
_TABLES: dict[str, Callable[[Log, Iterable[TopicTable], Path], None]] = {
    "parquet": write_parquet,
    "csv": write_csv,
    "netcdf": write_netcdf,
    "mat": write_mat,
}
_EXTRAS = {"av": "video", "pyarrow": "logs", "rosbags": "logs", "h5netcdf": "netcdf", "h5py": "netcdf"}


@click.command(short_help="Write a log in another format.")
@click.argument("file", type=FILE)
@click.option("--to", "kind", type=click.Choice(list(_ENDS)), required=True, help="Format to write.")
@click.option(
    "-o",
    "--output",
    type=FILE,
    help="File or folder to write; default: the name of FILE with the suffix of the format.",
)
@click.option(
    "--topics",
    multiple=True,
    help='Topics or ports to write, "*" for one level and "**" for any number; may be given several times. Default: all ports and events.',
)
@click.option(
    "--mapping",
    "mapping_file",
    type=FILE,
    help="Mapping file for rosbag2, alog and tlog; default: what `uwserver log --mapping` finds.",
)
def export(file: Path, kind: str, output: Path | None, topics: tuple[str, ...], mapping_file: Path | None) -> None:
    """Write FILE in another format: Parquet, CSV, NetCDF, MATLAB, ROS 2 bag, MOOS log, MAVLink log or video.

    FILE is a recording of uwserver or any other log that `uwserver log` reads.

    Parquet, CSV, NetCDF and MATLAB hold every topic as it is, with units and frames. ROS 2 bags, MOOS and MAVLink logs hold poses and
    sensors, converted as the mapping says. A video (mp4) holds the pictures of one topic.

    Example: uwserver export run.mcap --to csv --topics "rov/**"
    """
    require_kind(file, "a log", "recording", "log")
    target = output or file.with_name(f"{file.stem}{_ENDS[kind]}")
    try:
        with told(target, LogError, text=printable_error):
            if target.exists():
                raise LogError(f"{target} is there already: give another name by --output")
            mapping = read_mapping(mapping_file) if mapping_file else None
            with closing(open_parts(file)) as log:
                remarks = _write_whole(log, kind, target, topics, mapping)
    except ImportError as error:
        package = (error.name or str(error)).split(".")[0]
        command = install_command(f"uwserver[{_EXTRAS.get(package, 'logs')}]")
        raise click.ClickException(f"writing it needs {package}: {command}") from error
    for line in remarks:
        click.echo(printable(line), err=True)
    click.echo(f"wrote {target}")


def _write_whole(log: Log, kind: str, target: Path, patterns: tuple[str, ...], mapping: Mapping | None) -> list[str]:
    """Write as `_write` does, to a temporary place beside the target first, so that a failure leaves nothing behind."""
    if kind in _FOLDERS:
        target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".uwserver-export-", dir=target.parent) as place:
        made = Path(place) / target.name  # with its final name, after which the files in a bag are called
        remarks = _write(log, kind, made, patterns, mapping)
        made.rename(target)
    return remarks


def _write(log: Log, kind: str, target: Path, patterns: tuple[str, ...], mapping: Mapping | None) -> list[str]:
    """Write the log, and return sentences about what was left out."""
    remarks = list(log.remarks)
    if kind in _TABLES:
        chosen = _chosen(log, patterns, list(log.topics))
        if not patterns and (internal := [name for name in chosen if _is_internal(log, name)]):
            chosen.difference_update(internal)
            count = sum(log.topics[name].count != 0 for name in internal)
            remarks.append(f"{count} topics for replay, playback and viewers are left out: --topics '**' has them")
        _TABLES[kind](log, topic_tables(log, chosen), target)
        return remarks
    if kind == "mp4":
        return [*remarks, *write_mp4(log, _chosen(log, patterns, list(log.topics)), target)]
    mapping = mapping or mapping_of(log)
    if patterns:
        names = _chosen(log, patterns, [*mapping.tracks, *mapping.ports])
        mapping = Mapping(
            mapping.format,
            mapping.origin,
            {name: track for name, track in mapping.tracks.items() if name in names},
            {name: port for name, port in mapping.ports.items() if name in names},
        )
    if not mapping.tracks and not mapping.ports:
        raise LogError(
            f"{log.path}: no poses and no sensors are found in it: give a mapping (uwserver log FILE --mapping prints one)"
        )
    tracks: dict[str, FoundTrack] = {}
    for name in mapping.tracks:
        try:
            tracks |= pose_tracks(log, mapping, [name])
            remarks += [f"track {name}: {remark}" for remark in tracks[name].remarks]
        except LogError as error:
            remarks.append(f"left out: {error}")
    if kind == "alog":
        write_alog(log, mapping, tracks, target)
        return remarks
    return remarks + (write_tlog if kind == "tlog" else write_rosbag2)(log, mapping, tracks, target)


def _is_internal(log: Log, topic: str) -> bool:
    """Tell whether a topic of a recording of uwserver serves replay, playback or viewers, and is neither a port nor the events."""
    return log.kind == "uwserver" and (topic.startswith("/") or (topic.startswith("uwserver/") and topic != EVENTS))


def _chosen(log: Log, patterns: tuple[str, ...], names: list[str]) -> set[str]:
    found: set[str] = set() if patterns else set(names)
    for pattern in patterns:
        fitting = [pattern] if pattern in names else matching(pattern, names)
        if not fitting:
            raise LogError(f'{log.path}: no topic "{pattern}"; there are: {", ".join(names[:40])}')
        found.update(fitting)
    return found
