"""The command `doctor`: what is missing on this machine, and what to do about it."""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Literal

import click

from uwserver.adapter import AdapterNotFound, adapter_entries, installed_adapters, load_adapter
from uwserver.cli.port_holder import holder_of
from uwserver.cli.terminal import Colour, styled
from uwserver.packages import install_command
from uwserver.physics.collision.engine import ENGINES, chosen_engine, missing_engine
from uwserver.physics.kernel.choice import VARIABLE, is_plain
from uwserver.simulation.clock import Pace, SystemTime
from uwserver.units import NANOSECONDS

Level = Literal["ok", "warning", "fault"]

DEFAULT_PORT = 7600
_NEWEST_TRIED = (3, 13)
_REQUIRED = {"numpy": "numpy", "numba": "numba", "msgspec": "msgspec", "mcap": "mcap"}
_OPTIONAL = {
    "scipy": ("scipy", "scenarios with something solid", "solid"),
    "h5netcdf": ("h5netcdf", "seabeds in NetCDF", "netcdf"),
    "pymavlink": ("pymavlink", "scenarios with MAVLink", ""),
    "eclipse-zenoh": ("zenoh", "scenarios with zenoh", ""),
    "matplotlib": ("matplotlib", "plots", "plot"),
    "simplejpeg": ("simplejpeg", "pictures of cameras as JPEG", "pictures"),
    "av": ("av", "H.264 of cameras and MP4", "video"),
    "rosbags": ("rosbags", "ROS 2 and rosbridge", "ros"),
    "xxhash": ("xxhash", "ROS 2 over zenoh", "ros"),
    "cyclonedds": ("cyclonedds", "ROS 2 over DDS", "dds"),
    "pyarrow": ("pyarrow", "logs in Parquet", "logs"),
    "pyulog": ("pyulog", "logs of PX4", "logs"),
    "protobuf": ("google.protobuf", "logs of others with protobuf", "logs"),
}
"""By distribution: its module, what needs it, and the extra that installs it ("" where every installation has it). Engines of contacts have
findings of their own."""

_REPAIR = install_command("uwserver").replace(" install ", " install --force-reinstall ")
_WAITS, _PERIOD_NS, _LATE_NS = 200, NANOSECONDS // 500, NANOSECONDS // 1000
_NEEDED_MB = 400
_COLOURS: Mapping[Level, Colour] = {"ok": "green", "warning": "yellow", "fault": "red"}
_SIGNS = {"ok": "ok     ", "warning": "warning", "fault": "FAULT  "}


@dataclass(frozen=True)
class Finding:
    """One thing that was examined.

    Attributes:
        name: the thing that was examined.
        level: a fault prevents `uwserver run`; a warning means that something works less well, or not at all.
        text: what was found.
        remedy: what to do; "" if nothing is wrong.
    """

    name: str
    level: Level
    text: str
    remedy: str = ""


def _judged(name: str, is_fine: bool, text: str, remedy: str) -> Finding:
    """Return a finding that is a warning with a remedy unless it is fine."""
    return Finding(name, "ok", text) if is_fine else Finding(name, "warning", text, remedy)


def python() -> Finding:
    """Check the version of the interpreter."""
    found, newest = (".".join(map(str, version)) for version in (sys.version_info[:3], _NEWEST_TRIED))
    is_tried = sys.version_info[:2] <= _NEWEST_TRIED
    remedy = f"should anything fail, use Python {newest} or older"
    return _judged("python", is_tried, found if is_tried else f"{found}: not tried", remedy)


def wheels() -> Iterator[Finding]:
    """Check that the packages that every server needs can be imported, and that those of the extras are installed."""
    for distribution, module in _REQUIRED.items():
        yield _wheel(distribution, module, "fault", _REPAIR)
    for distribution, (module, purpose, extra) in _OPTIONAL.items():
        command = install_command(f"uwserver[{extra}]" if extra else "uwserver")
        yield _wheel(distribution, module, "warning", f"only {purpose} need it: {command}")


def _wheel(distribution: str, module: str, level: Level, remedy: str) -> Finding:
    try:
        # Packages of extras are only looked for, as an import takes time and nothing here needs them.
        if level == "fault":
            importlib.import_module(module)
        elif find_spec(module) is None:
            return Finding(distribution, level, "is not installed", remedy)
        return Finding(distribution, "ok", importlib.metadata.version(distribution))
    except (ImportError, OSError) as error:  # OSError: a shared library of the system is missing
        return Finding(distribution, level, f"cannot be imported: {error}", remedy)


def contacts() -> Finding:
    """Check for an engine of contacts, without importing it: Bullet prints when it is imported."""
    missing = missing_engine()
    if missing is not None:
        return Finding("contacts", "warning", missing, "only scenarios with something solid need one")
    engine = chosen_engine()
    others = [name for name in ENGINES if name != engine and missing_engine(name) is None]
    return Finding("contacts", "ok", f"{engine} ({', '.join(others)} too)" if others else engine)


def rays() -> Finding:
    """Check for the library that finds the triangles that rays meet."""
    if find_spec("embreex") is not None:
        return Finding("rays", "ok", f"embreex {importlib.metadata.version('embreex')}")
    text = "embreex is not installed: sonars and other ranging sensors see the same, through a slower tree of uwserver's own"
    return Finding("rays", "warning", text, f"{install_command('embreex')}, where it has wheels")


def choice_of_kernels() -> Finding | None:
    """Return a fault if the environment chooses kernels that there are not: then nothing that needs a kernel can be imported."""
    try:
        is_plain(os.environ.get(VARIABLE))
    except ValueError as error:
        return Finding("kernels", "fault", str(error), f"unset {VARIABLE}")
    return None


def kernels() -> Finding:
    """Check the cache of compiled kernels: its folder, whether that can be written, and what is compiled."""
    from uwserver.physics.kernel.compiled import cache_state
    from uwserver.world.builds import STAGES, kernels_of, missing

    rest, package = missing(STAGES), cache_state._replace(folder=None)
    if package.packaged and not any(package.missing(kernels_of(stage)) for stage in STAGES):
        return Finding("kernels", "ok", f"came with the wheel, for {package.packaged[0].name.partition('-')[2]}")
    if cache_state.folder is None:
        remedy = "set NUMBA_CACHE_DIR to a folder that you own and nobody else can write"
        return Finding("kernels", "warning", cache_state.reason, remedy)
    where = f"{cache_state.folder} ({cache_state.reason or 'writable'})"
    text = f"not compiled yet: {', '.join(rest)}; in {where}" if rest else f"compiled, in {where}"
    seconds = sum(STAGES[stage] for stage in rest)
    remedy = (
        f"a run compiles what it needs first, {seconds:.0f} s of processor time for all; now: uwserver doctor --warm"
    )
    return _judged("kernels", not rest, text, remedy)


def threads() -> Finding:
    """Check whether two threads can step a world of many bodies."""
    from uwserver.physics.kernel.team import cores, why_alone

    reason = why_alone()
    return Finding(
        "threads", "ok", f"one steps a world: {reason}" if reason else f"two for large worlds, of {cores()} cores"
    )


def port(number: int = DEFAULT_PORT) -> Finding:
    """Check that the default port is free on loopback, and find out which program has it if not."""
    holder = holder_of("127.0.0.1", number)
    if holder is None:
        return Finding(f"port {number}", "ok", "free")
    return Finding(
        f"port {number}", "fault", f"{holder} has it", "end it, or: uwserver run --port 0, which takes a free port"
    )


def timer() -> Finding:
    """Measure how late the machine wakes a thread at absolute deadlines that are 2 ms apart."""
    pace, wake = Pace(SystemTime()), threading.Event()
    pace.anchor(0)
    late = sorted(pace.wait(k * _PERIOD_NS, wake) or 0 for k in range(1, _WAITS + 1))
    p50, p99 = late[_WAITS // 2], late[_WAITS * 99 // 100]
    text = f"wakes {p50 / 1e6:.2f} ms late (p50), {p99 / 1e6:.2f} ms (p99) at 500 Hz"
    remedy = "more than 1 ms: ticks will be late; end other work, or use a machine without shared CPUs"
    return _judged("timer", p99 <= _LATE_NS, text, remedy)


def processors() -> Finding:
    """Count the CPUs that this process may use."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return _judged("cpus", count >= 2, str(count), "clients and simulation share it: expect late ticks under load")


def memory(meminfo: Path = Path("/proc/meminfo")) -> Finding:
    """Check the memory that is available to new programs."""
    try:
        lines = meminfo.read_text().splitlines()
        kilobytes = next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration, ValueError):
        return Finding("memory", "ok", "this system does not tell")
    megabytes = kilobytes // 1024
    remedy = f"a server takes up to {_NEEDED_MB} MB: end something"
    return _judged("memory", megabytes >= _NEEDED_MB, f"{megabytes} MB available", remedy)


def adapters() -> Iterator[Finding]:
    """Check that every installed adapter can be loaded."""
    entries = adapter_entries()
    if not entries:
        yield Finding("adapters", "fault", "none is installed", _REPAIR)
    for kind in entries:
        try:
            load_adapter(kind)
        except AdapterNotFound as error:
            yield Finding(f"adapter {kind}", "fault", str(error), "repair or uninstall the distribution that it names")
        else:
            yield Finding(f"adapter {kind}", "ok", "loads")


def folder(where: Path | None = None) -> Finding:
    """Check that recordings and new scenarios can be written into a folder, by default the working folder."""
    here = where or Path.cwd()
    try:
        with tempfile.TemporaryFile(dir=here):
            return Finding("folder", "ok", f"{here} can be written")
    except OSError as error:
        text = f"{here} cannot be written ({error.strerror})"
        return Finding("folder", "warning", text, "give --record and `uwserver new` a path elsewhere")


def scenario(reference: str) -> Finding:
    """Check that a scenario, shipped or a file, has no fault, and that all that it needs is installed."""
    from uwserver.scenario.files.errors import ScenarioError
    from uwserver.scenario.load.scenario import load

    name = f"scenario {reference}"
    try:
        resolved = load(reference, adapters=installed_adapters())
    except ScenarioError as error:
        return Finding(name, "fault", str(error), f"mend it until this says ok: uwserver check {reference}")
    if resolved.missing:
        return Finding(name, "fault", resolved.missing.what, resolved.missing.command)
    return Finding(name, "ok", "all that it needs is installed")


def examine(reference: str = "") -> Iterator[Finding]:
    """Examine everything, in the order in which a server needs it; with a reference, also what that scenario needs."""
    yield python()
    yield from wheels()
    yield contacts()
    yield rays()
    wrong = choice_of_kernels()
    if wrong is not None:
        yield wrong
    else:
        if reference:
            yield scenario(reference)
        yield kernels()
        yield threads()
        yield from adapters()
    yield port()
    yield timer()
    yield processors()
    yield memory()
    yield folder()


# -- the command ------------------------------------------------------------------------------------------------------------------------


@click.command(short_help="Test this machine, and whether it has what a scenario needs.")
@click.argument("scenario", default="")
@click.option("--warm", is_flag=True, help="Compile the physics now, and remove caches of older versions.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def doctor(scenario: str, warm: bool, as_json: bool) -> None:
    """Test this machine: packages, cache of compiled kernels, port, timer and more.

    With SCENARIO, a shipped scenario or a file, also test whether everything that it needs is installed.

    The exit status is 1 if something prevents a server from running.
    """
    broken = _warm() if warm and choice_of_kernels() is None else []
    findings: list[Finding] = []
    for finding in chain(broken, examine(scenario)):
        findings.append(finding)
        if not as_json:
            click.echo(_line(finding))
    faults = sum(finding.level == "fault" for finding in findings)
    if as_json:
        click.echo(json.dumps({"ok": not faults, "findings": [asdict(finding) for finding in findings]}, indent=2))
    else:
        command = f"uwserver run {scenario}".rstrip()
        click.echo(f"{faults} to repair before `{command}` works" if faults else f"ready: {command}")
    sys.exit(1 if faults else 0)


def _line(finding: Finding) -> str:
    line = f"{styled(_SIGNS[finding.level], fg=_COLOURS[finding.level])}  {finding.name:24}  {finding.text}"
    return f"{line}\n{'':35}-> {finding.remedy}" if finding.remedy else line


def _warm() -> list[Finding]:
    """Compile what the cache lacks, with progress on standard error. Return a finding only if that fails."""
    try:
        from uwserver.physics.kernel.compiled import cache_state
        from uwserver.world.warm import prune, warm

        warm(lambda line: click.echo(line, err=True))
    except (ImportError, OSError, RuntimeError) as error:
        return [Finding("warming", "fault", str(error), _REPAIR)]
    if cache_state.folder is not None and not cache_state.reason:
        for old in prune(cache_state.folder):
            click.echo(f"kernels: removed {old}", err=True)
    return []
