"""`uwserver bench`: how fast this machine steps, serves and starts, against the bars and beside the peers."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import click

from uwserver_bench.contact import bench_contact
from uwserver_bench.mavlink import bench_mavlink
from uwserver_bench.moos import bench_moos
from uwserver_bench.net import bench_net
from uwserver_bench.physics import bench_physics
from uwserver_bench.processes import BenchFailed
from uwserver_bench.remus import bench_remus
from uwserver_bench.report import Report, machine_facts
from uwserver_bench.rows import Row
from uwserver_bench.sensors import bench_sensors
from uwserver_bench.server import bench_server
from uwserver_bench.sil import bench_sil
from uwserver_bench.solids import bench_solids
from uwserver_bench.start import bench_start

PARTS = ("physics", "solids", "contact", "sensors", "server", "start", "net", "moos", "mavlink", "sil")


@click.command()
@click.argument("part", required=False, type=click.Choice(PARTS))
@click.option("--json", "file", type=click.Path(path_type=Path, dir_okay=False), help="Write the report there too.")
@click.option("--quick", is_flag=True, help="Very short repeats: shows that all runs, not how fast.")
def bench(part: str | None, file: Path | None, quick: bool) -> None:
    """Measure physics, solids, contact, sensors, server, start, net, moos, mavlink and sil (or one PART) on an idle machine; a quarter of an hour.

    Prints the median, the bar, and the verdict of each figure; docs/reference/benchmarks.md tells what they mean. Peers (pybullet, MuJoCo)
    take part when they are installed: pip install uwserver-bench; the Python Vehicle Simulator when UWSERVER_PVS names its src folder,
    the MOOSDB of MOOS-IvP when UWSERVER_MOOS_BIN names its folder.
    """
    parts: dict[str, Callable[[bool, Callable[[str], None]], list[Row]]] = {
        "physics": lambda quick, say: [*bench_physics(quick, say), *bench_remus(quick, say)],
        "solids": bench_solids,
        "contact": bench_contact,
        "sensors": bench_sensors,
        "server": bench_server,
        "start": bench_start,
        "net": bench_net,
        "moos": bench_moos,
        "mavlink": bench_mavlink,
        "sil": bench_sil,
    }
    machine, rows = machine_facts(), list[Row]()
    try:
        for name in (part,) if part else PARTS:
            rows += parts[name](quick, lambda line: click.echo(line, err=True))
    except BenchFailed as error:
        click.echo(f"uwserver bench: {error}", err=True)
        sys.exit(1)
    report = Report(quick, machine, tuple(rows))
    if file is not None:
        file.write_text(json.dumps(report.as_json(), indent=2) + "\n", encoding="utf-8")
    click.echo(report.table())
