"""What `uwserver doctor` looks at: each function examines one thing and returns what it found."""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import os
import socket
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from uwserver.adapter import AdapterNotFound, adapter_entries, installed_adapters, load_adapter
from uwserver.physics.collision.engine import ENGINES, chosen_engine, missing_engine
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
    "matplotlib": ("matplotlib", "pictures", "plot"),
    "simplejpeg": ("simplejpeg", "JPEG of cameras", "pictures"),
    "av": ("av", "H.264 of cameras, MP4", "video"),
}
"""Module, who needs it, and the extra that brings it ("": none, every installation has it), by distribution; engines have findings of their own."""

_WAITS, _PERIOD_NS, _LATE_NS = 200, NANOSECONDS // 500, NANOSECONDS // 1000
_NEEDED_MB = 400


@dataclass(frozen=True)
class Finding:
    """One thing that was examined.

    Attributes:
        name: what it is.
        level: a fault prevents `uwserver run`, a warning lessens it.
        text: what was found.
        remedy: what to do; empty when all is well.
    """

    name: str
    level: Level
    text: str
    remedy: str = ""


def python() -> Finding:
    """The version of the interpreter."""
    found = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info[:2] > _NEWEST_TRIED:
        newest = ".".join(map(str, _NEWEST_TRIED))
        return Finding(
            "python", "warning", f"{found}: not tried", f"should anything fail, use Python {newest} or older"
        )
    return Finding("python", "ok", found)


def wheels() -> Iterator[Finding]:
    """The packages that every server needs can be imported; those of extras are there."""
    for distribution, module in _REQUIRED.items():
        yield _wheel(distribution, module, "fault", "pip install --force-reinstall uwserver")
    for distribution, (module, purpose, extra) in _OPTIONAL.items():
        package = f"'uwserver[{extra}]'" if extra else "uwserver"
        yield _wheel(distribution, module, "warning", f"only {purpose} need it: pip install {package}")


def _wheel(distribution: str, module: str, level: Level, remedy: str) -> Finding:
    try:
        # Those of extras are only looked for: nothing here needs them.
        if level == "fault":
            importlib.import_module(module)
        elif find_spec(module) is None:
            return Finding(distribution, level, "is not installed", remedy)
        return Finding(distribution, "ok", importlib.metadata.version(distribution))
    except (ImportError, OSError) as error:  # OSError: a library of the system is missing
        return Finding(distribution, level, f"cannot be imported: {error}", remedy)


def contacts() -> Finding:
    """The engine that contacts use. It is only looked for: the import of Bullet prints, and nothing here needs it."""
    missing = missing_engine()
    if missing is not None:
        return Finding("contacts", "warning", missing, "only scenarios with something solid need one")
    engine = chosen_engine()
    others = [name for name in ENGINES if name != engine and missing_engine(name) is None]
    return Finding("contacts", "ok", f"{engine} ({', '.join(others)} too)" if others else engine)


def rays() -> Finding:
    """What ranging sensors look for triangles with."""
    if find_spec("embreex") is not None:
        return Finding("rays", "ok", f"embreex {importlib.metadata.version('embreex')}")
    text = "embreex is not installed: sonars and other ranging sensors see the same, through a slower tree of uwserver's own"
    return Finding("rays", "warning", text, "pip install embreex, where it has wheels")


def kernels() -> Finding:
    """The cache of compiled kernels: where, writable, warm."""
    from uwserver.physics.kernel.compiled import cache_state
    from uwserver.world.builds import STAGES, kernels_of, missing

    rest, package = missing(STAGES), cache_state._replace(folder=None)
    if package.packaged and not any(package.missing(kernels_of(stage)) for stage in STAGES):
        return Finding("kernels", "ok", f"came with the wheel, for {package.packaged[0].name.partition('-')[2]}")
    if cache_state.folder is None:
        remedy = "set NUMBA_CACHE_DIR to a folder that you own and nobody else can write"
        return Finding("kernels", "warning", cache_state.reason, remedy)
    where = f"{cache_state.folder} ({cache_state.reason or 'writable'})"
    if not rest:
        return Finding("kernels", "ok", f"compiled, in {where}")
    text = f"not compiled yet: {', '.join(rest)}; in {where}"
    seconds = sum(STAGES[stage] for stage in rest)
    remedy = (
        f"a run compiles what it needs first, {seconds:.0f} s of processor time for all; now: uwserver doctor --warm"
    )
    return Finding("kernels", "warning", text, remedy)


def threads() -> Finding:
    """Whether two threads can step a world of many bodies."""
    from uwserver.physics.kernel.team import cores, why_alone

    reason = why_alone()
    return Finding(
        "threads", "ok", f"one steps a world: {reason}" if reason else f"two for large worlds, of {cores()} cores"
    )


def port(number: int = DEFAULT_PORT) -> Finding:
    """The default port is free on loopback, or who has it."""
    name = f"port {number}"
    with socket.socket() as probe:
        # As servers do: a port whose last connection has just closed counts as free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", number))
        except OSError as error:
            owner = _speaker(number)
            remedy = "end it, or: uwserver run --port 7601 (0 takes a free port)"
            return Finding(name, "fault", f"{owner or 'another program'} has it ({error.strerror})", remedy)
    return Finding(name, "ok", "free")


def _speaker(number: int) -> str | None:
    """What a uwserver at the port says of itself; None when nobody there speaks its protocol."""
    hello = b'{"jsonrpc":"2.0","id":1,"method":"hello","params":{"version":1}}\n'
    try:
        with socket.create_connection(("127.0.0.1", number), 1.0) as peer:
            peer.settimeout(1.0)
            peer.sendall(hello)
            with peer.makefile("rb") as lines:
                answer = json.loads(lines.readline(65536))
    except (OSError, ValueError):
        return None
    if not isinstance(answer, dict) or answer.get("jsonrpc") != "2.0":
        return None
    result = answer.get("result")
    if isinstance(result, dict) and "scenario" in result:
        return f"a running {result.get('server')} with scenario {result['scenario']}"
    return "a running uwserver that wants a token"


def timer() -> Finding:
    """How late the machine wakes a thread from absolute deadlines 2 ms apart."""
    pace, wake = Pace(SystemTime()), threading.Event()
    pace.anchor(0)
    late = sorted(pace.wait(k * _PERIOD_NS, wake) or 0 for k in range(1, _WAITS + 1))
    p50, p99 = late[_WAITS // 2], late[_WAITS * 99 // 100]
    text = f"wakes {p50 / 1e6:.2f} ms late (p50), {p99 / 1e6:.2f} ms (p99) at 500 Hz"
    if p99 <= _LATE_NS:
        return Finding("timer", "ok", text)
    remedy = "more than 1 ms: ticks will be late; end other work, or use a machine without shared CPUs"
    return Finding("timer", "warning", text, remedy)


def processors() -> Finding:
    """CPUs that this process may use."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if count >= 2:
        return Finding("cpus", "ok", str(count))
    return Finding("cpus", "warning", "1", "clients and simulation share it: expect late ticks under load")


def memory(meminfo: Path = Path("/proc/meminfo")) -> Finding:
    """Memory that is available to new programs."""
    try:
        lines = meminfo.read_text().splitlines()
        kilobytes = next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration, ValueError):
        return Finding("memory", "ok", "this system does not tell")
    megabytes = kilobytes // 1024
    if megabytes >= _NEEDED_MB:
        return Finding("memory", "ok", f"{megabytes} MB available")
    remedy = f"a server takes up to {_NEEDED_MB} MB: end something"
    return Finding("memory", "warning", f"{megabytes} MB available", remedy)


def adapters() -> Iterator[Finding]:
    """Every installed adapter can be loaded."""
    entries = adapter_entries()
    if not entries:
        yield Finding("adapters", "fault", "none is installed", "pip install --force-reinstall uwserver")
    for kind in entries:
        try:
            load_adapter(kind)
        except AdapterNotFound as error:
            yield Finding(f"adapter {kind}", "fault", str(error), "repair or uninstall the distribution that it names")
        else:
            yield Finding(f"adapter {kind}", "ok", "loads")


def folder(where: Path | None = None) -> Finding:
    """Recordings and new scenarios can be written here."""
    here = where or Path.cwd()
    try:
        with tempfile.TemporaryFile(dir=here):
            return Finding("folder", "ok", f"{here} can be written")
    except OSError as error:
        text = f"{here} cannot be written ({error.strerror})"
        return Finding("folder", "warning", text, "give --record and `uwserver new` a path elsewhere")


def scenario(reference: str) -> Finding:
    """A scenario, shipped or a file, is right, and all that it needs is installed."""
    from uwserver.scenario.files.errors import ScenarioError
    from uwserver.scenario.load.scenario import load

    name = f"scenario {reference}"
    try:
        resolved = load(reference, adapters=installed_adapters())
    except (ScenarioError, AdapterNotFound) as error:
        return Finding(name, "fault", str(error), f"mend it until this says ok: uwserver check {reference}")
    if resolved.missing:
        absent, _, remedy = resolved.missing.partition("; all that this scenario needs: ")
        return Finding(name, "fault", absent, remedy)
    return Finding(name, "ok", "all that it needs is installed")


def examine(reference: str = "") -> Iterator[Finding]:
    """Everything, in the order in which it is needed; also that of one scenario, when there is a reference to one."""
    yield python()
    yield from wheels()
    yield contacts()
    yield rays()
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
