"""The command `uwserver bench`: it measures how fast this machine steps, serves and starts, and compares with the bars and with other programs."""

from __future__ import annotations

import json
import pkgutil
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from uwserver_bench.processes import BenchFailed

if TYPE_CHECKING:
    from uwserver_bench.report import Row

_BENCHES: Mapping[str, tuple[str, ...]] = {
    "physics": ("engine.physics:bench_physics", "engine.remus:bench_remus"),
    "solids": ("engine.contact:bench_solids",),
    "contact": ("engine.contact:bench_contact",),
    "sensors": (
        "engine.sensors:bench_sensors",
        "engine.acoustics:bench_sound",
        "engine.acoustics:bench_modems",
        "engine.sensors:bench_cameras",
    ),
    "swarm": ("swarm.swarm:bench_swarm",),
    "server": ("server:bench_server",),
    "start": ("server:bench_start",),
    "net": ("net.net:bench_net",),
    "moos": ("moos.moos:bench_moos",),
    "mavlink": ("autopilots.mavlink:bench_mavlink",),
    "ros": ("ros.ros:bench_ros",),
    "sil": ("autopilots.sil:bench_sil",),
    "web": ("web.web:bench_web",),
    "video": ("web.video:bench_video", "web.beside:bench_beside"),
    "logs": ("logs:bench_logs", "logs:bench_recordings"),
    "hostile": ("hostile.bench:bench_hostile",),
}
"""Module and function of each part, in the order in which they are measured."""
PARTS = tuple(_BENCHES)
Part = Callable[[bool, Callable[[str], None]], "list[Row]"]


@click.command(short_help="Measure this machine, part by part.")
@click.argument("part", required=False, type=click.Choice(PARTS))
@click.option("--json", "file", type=click.Path(path_type=Path, dir_okay=False), help="Write the report there too.")
@click.option("--quick", is_flag=True, help="Very short repeats: shows that all runs, not how fast.")
@click.option(
    "--against",
    "venv",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Compare with the version of uwserver that is installed in this virtual environment.",
)
@click.option("--pairs", type=click.IntRange(1, 1000), help="With --against: how many pairs.  [default: 15]")
@click.option(
    "--minutes", type=click.FloatRange(0.0, min_open=True), help="With --against: no pair begins later.  [default: 60]"
)
@click.option("--only", default="", help="With --against: figures whose group or name has this text.")
def bench(
    part: str | None,
    file: Path | None,
    quick: bool,
    venv: Path | None,
    pairs: int | None,
    minutes: float | None,
    only: str,
) -> None:
    """Measure physics, solids, contact, sensors, swarm, server, start, net, moos, mavlink, ros, sil, web, video, logs, hostile, or one PART.

    On an idle machine; all of it takes half an hour.

    Prints the median, the bar, and the verdict of each figure; docs/reference/benchmarks.md tells what they mean. Peers (pybullet, MuJoCo)
    take part when they are installed: pip install uwserver-bench; the Python Vehicle Simulator when UWSERVER_PVS names its src folder,
    the MOOSDB of MOOS-IvP when UWSERVER_MOOS_BIN names its folder.

    With --against, measures this version beside another one in pairs, and exits with 1 when any figure is worse.
    """
    try:
        if venv is not None:
            if part is not None:
                raise click.UsageError(f"--against measures parts of its own: leave {part} out, or choose with --only")
            sys.exit(_against(venv, pairs, minutes, quick, only, file))
        if pairs is not None or minutes is not None or only:
            raise click.UsageError("--pairs, --minutes and --only belong to --against")
        _parts((part,) if part else PARTS, quick, file)
    except BenchFailed as error:
        click.echo(f"uwserver bench: {error}", err=True)
        sys.exit(1)


def _parts(names: Sequence[str], quick: bool, file: Path | None) -> None:
    """Measure parts, and print the report."""
    from uwserver_bench.report import Report, machine_facts

    machine = machine_facts()
    rows: list[Row] = []
    for name in names:
        for place in _BENCHES[name]:
            # Imported here, because a listing of all commands does not need them.
            part: Part = pkgutil.resolve_name(f"uwserver_bench.{place}")
            rows += part(quick, _say)
    report = Report(quick, machine, tuple(rows))
    _write(file, report.as_json())
    click.echo(report.table())


def _against(venv: Path, pairs: int | None, minutes: float | None, quick: bool, only: str, file: Path | None) -> int:
    """Compare with another version, and print the report. Returns the exit status."""
    from uwserver_bench.against.compare import MINUTES, PAIRS, QUICK_PAIRS, compare

    found = compare(venv, pairs or (QUICK_PAIRS if quick else PAIRS), minutes or MINUTES, quick, only, _say)
    _write(file, found.as_json())
    click.echo(found.table())
    return 1 if found.worse else 0


def _write(file: Path | None, report: dict[str, object]) -> None:
    if file is not None:
        file.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


def _say(line: str) -> None:
    click.echo(line, err=True)
