"""The command `log`: what is in a log file of any origin, and the mapping that turns it into tracks and ports."""

from __future__ import annotations

import textwrap
from contextlib import closing
from pathlib import Path
from typing import Any

import click
import msgspec

from uwserver.cli.loading import require_kind
from uwserver.cli.terminal import FILE, printable, printable_error, told
from uwserver.logfiles import Log, LogError, LogField, Topic
from uwserver.logfiles.mapping import mapping_text
from uwserver.logfiles.readers.opening import open_parts
from uwserver.logfiles.rules import mapping_of
from uwserver.logfiles.timebase import seconds, utc_text
from uwserver.units import NANOSECONDS

_KINDS = {
    "uwserver": "recording of uwserver", "mcap": "MCAP", "tlog": "MAVLink telemetry", "bin": "ArduPilot dataflash", "alog": "MOOS",
    "bag": "ROS 1 bag", "rosbag2": "ROS 2 bag", "ulg": "PX4", "csv": "table", "parquet": "Parquet table",
}  # fmt: skip
_FIELDS_SHOWN = 16
_MAPPING_HEAD = """\
# What this log gives. Edit it: names of tracks and ports are yours, as are units, axes and topics.
# Keys, units and axes: docs/how-to/logs.md.
"""


@click.command(name="log", short_help="Tell what is in a log file of any origin.")
@click.argument("file", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
@click.option(
    "--mapping",
    "as_mapping",
    is_flag=True,
    help="Print a mapping (TOML) instead: which topics hold the pose of which vehicle, and the samples of which port.",
)
def log_command(file: Path, as_json: bool, as_mapping: bool) -> None:
    """Tell what is in FILE: the time span, each topic with its number of messages, rate, fields and units, gaps and resets of the clock.

    FILE is a recording of uwserver, any other MCAP file, a MAVLink .tlog, an ArduPilot .bin, a MOOS .alog, a bag of ROS 1 or ROS 2 (.bag,
    .db3 or a folder), a PX4 .ulg, or a table (.csv, .parquet).

    Example: uwserver log dive.tlog --mapping > dive.toml
    """
    require_kind(file, "a log", "recording", "log")
    with told(file, LogError, text=printable_error), closing(open_parts(file)) as log:
        if as_mapping:
            text = _MAPPING_HEAD + mapping_text(mapping_of(log)).rstrip("\n")
        elif as_json:
            text = msgspec.json.format(msgspec.json.encode(_described(log)), indent=2).decode()
        else:
            text = _summary(log)
    click.echo(text)


def _rate_hz(log: Log, topic: Topic) -> float | None:
    """Return the mean rate of a topic, or None where it cannot be known."""
    if topic.count is None or topic.count < 2:
        return None
    first = log.start_ns if topic.first_ns is None else topic.first_ns
    last = log.end_ns if topic.last_ns is None else topic.last_ns
    return (topic.count - 1) * NANOSECONDS / (last - first) if last > first else None


def _described(log: Log) -> dict[str, Any]:
    topics = [{**msgspec.to_builtins(topic), "rate_hz": _rate_hz(log, topic)} for topic in log.topics.values()]
    return {
        "path": str(log.path),
        "kind": log.kind,
        "start_ns": log.start_ns,
        "end_ns": log.end_ns,
        "epoch_ns": log.epoch_ns,
        "start_utc": None if log.epoch_ns is None else utc_text(log.epoch_ns + log.start_ns),
        "remarks": list(log.remarks),
        "topics": topics,
    }


def _summary(log: Log) -> str:
    lines = [f"{log.path}: {_KINDS[log.kind]}, {seconds(log.end_ns - log.start_ns)}, {len(log.topics)} topics"]
    if log.epoch_ns is not None:
        lines.append(f"  from {utc_text(log.epoch_ns + log.start_ns)} to {utc_text(log.epoch_ns + log.end_ns)}")
    lines += [f"  ! {printable(remark)}" for remark in log.remarks]
    width = min(48, max((len(name) for name in log.topics), default=0))
    for topic in log.topics.values():
        rate = _rate_hz(log, topic)
        count = "?" if topic.count is None else str(topic.count)
        hertz = "" if rate is None else f"{rate:.4g} Hz"
        name = printable(topic.name)
        of = "" if topic.schema in ("", topic.name, topic.name.rpartition("/")[2]) else printable(topic.schema)
        lines.append(f"{name:<{width}} {count:>9} {hertz:>10}  {of}".rstrip())
        lines += textwrap.wrap(_fields(topic.fields), 118, initial_indent="    ", subsequent_indent="    ")
    mapping = mapping_of(log)
    if mapping.tracks:
        lines.append(f"tracks (--mapping): {', '.join(mapping.tracks)}")
    return "\n".join(lines)


def _fields(fields: tuple[LogField, ...]) -> str:
    shown = [_field(field) for field in fields[:_FIELDS_SHOWN]]
    more = len(fields) - _FIELDS_SHOWN
    return ", ".join(shown) + (f" and {more} more (--json)" if more > 0 else "")


def _field(field: LogField) -> str:
    """Return a field's name with its unit and frame. The header of a table may already end in the unit."""
    has_unit = field.name.endswith((f"[{field.unit}]", f"({field.unit})"))
    about = " ".join(filter(None, ("" if has_unit else field.unit, field.frame)))
    return printable(f"{field.name} [{about}]" if about else field.name)
