"""The verbs of the command line, each with a connected client. Results go to standard output.

Lists show ports and services by vehicle, sensors first, with services of equal components together.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import itertools
import json
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from uwclient import live
from uwclient.buffers import Buffer, as_text
from uwclient.errors import Timeout, UwError
from uwclient.figure import draw, require_matplotlib
from uwclient.ports import Field, Port, Progress, Sample, Service
from uwclient.sync import Client


def listing(ports: Sequence[Port], services: Sequence[Service], whole: bool = False) -> Iterator[str]:
    """Yield lines for people.

    Args:
        ports: ports of the server.
        services: services of the server.
        whole: whether each service gets a line with its arguments; otherwise those of equal components share a line.
    """
    owners = list(
        dict.fromkeys(path.partition("/")[0] for path in [p.path for p in ports] + [s.path for s in services])
    )
    owners.sort(key=lambda owner: owner == "world")  # vehicles first
    for owner in owners:
        own_ports = [port for port in ports if port.path.startswith(f"{owner}/")]
        own_services = [service for service in services if service.path.startswith(f"{owner}/")]
        yield owner
        for port in sorted(own_ports, key=lambda port: port.direction != "sensor"):
            yield f"  {_port_line(port)}"
        for line in map(_service_line, own_services) if whole else _folded(owner, own_services):
            yield f"  {line}"
    if services and not whole:
        yield "--services shows the arguments of services, --json shows everything."


def _port_line(port: Port) -> str:
    rate_hz = f"{port.rate_hz:g} Hz" if port.rate_hz else "-"
    fields = ", ".join(_field(field) for field in port.fields)
    return f"{port.path:30} {port.direction:9} {rate_hz:8} {fields}"


def _field(field: Field) -> str:
    shape = "x".join("n" if size < 0 else str(size) for size in field.shape)
    shape = " ".join(filter(None, (field.dtype, shape)))
    return field.name + (f"[{shape}]" if shape else "") + (f" {field.unit}" if field.unit not in ("", "1") else "")


def _service_line(service: Service) -> str:
    arguments = ", ".join(entry.name if entry.required else f"[{entry.name}]" for entry in service.arguments)
    return f"{service.path:30} {'service':9} {'-':8} {arguments}".rstrip()


def _folded(owner: str, services: Sequence[Service]) -> Iterator[str]:
    """Yield a line for the services of each component; components with the same services share a line."""
    names: dict[str, list[str]] = {}
    for service in services:
        component, _, name = service.path.removeprefix(f"{owner}/").rpartition("/")
        names.setdefault(component, []).append(name)
    alike: dict[tuple[str, ...], list[str]] = {}
    for component, own in names.items():
        alike.setdefault(tuple(own), []).append(component)
    for own_names, components in alike.items():
        which = ",".join(components)
        place = f"{owner}/{{{which}}}/" if len(components) > 1 else f"{owner}/{which}/".replace("//", "/")
        yield f"{place} services: {', '.join(own_names)}"


@dataclass(frozen=True)
class Rate:
    """Figures of one port. They are None if there are fewer than two instants.

    Attributes:
        port: path of the port.
        samples: number of samples that came.
        sim_hz: rate in simulation time.
        wall_hz: rate of arrivals in wall time.
        sim_jitter_ms: standard deviation of the period in simulation time.
        wall_jitter_ms: standard deviation of the period between arrivals.
        drops: samples that are missing by gaps of `seq`, because they were lost, or left out by a rate limit.
    """

    port: str
    samples: int
    sim_hz: float | None
    wall_hz: float | None
    sim_jitter_ms: float | None
    wall_jitter_ms: float | None
    drops: int


def rate(port: str, arrivals: Sequence[tuple[float, Sample]]) -> Rate:
    """Return the figures of a port's samples, each with its time of arrival on a wall clock, s."""
    sim_hz, sim_jitter_ms = _regularity([sample.time_s for _, sample in arrivals])
    wall_hz, wall_jitter_ms = _regularity([arrival for arrival, _ in arrivals])
    sequence = [sample.seq for _, sample in arrivals]
    # A sequence goes back after a reset or a restart of the server; this is no loss.
    drops = sum(max(later - earlier - 1, 0) for earlier, later in zip(sequence, sequence[1:]))
    return Rate(port, len(arrivals), sim_hz, wall_hz, sim_jitter_ms, wall_jitter_ms, drops)


def _regularity(times_s: Sequence[float]) -> tuple[float | None, float | None]:
    periods = [later - earlier for earlier, later in zip(times_s, times_s[1:])]
    total = sum(periods)
    if not periods or total <= 0:
        return None, None
    return len(periods) / total, statistics.pstdev(periods) * 1e3


def topics(client: Client, options: argparse.Namespace) -> None:
    """List ports and services."""
    if options.json:
        description = client.describe()
        ports = [dataclasses.asdict(port) for port in description.ports.values()]
        services = [dataclasses.asdict(service) for service in description.services.values()]
        whole = {"server": description.server, "world": description.world, "ports": ports, "services": services}
        print(json.dumps(whole, indent=2))
        return
    for line in listing(list(client.ports.values()), list(client.services.values()), options.services):
        print(line)


def watch(client: Client, options: argparse.Namespace) -> None:
    """Show live values in one place of the terminal. Without --seconds, Ctrl-C is the normal end."""
    with contextlib.suppress(KeyboardInterrupt):
        live.watch(client, options.pattern, options.rate, options.seconds, sys.stdout)


def echo(client: Client, options: argparse.Namespace) -> None:
    """Print samples. Without -n, Ctrl-C is the normal end."""
    client.subscribe(options.pattern, rate_hz=options.rate, fields=options.fields)
    with contextlib.suppress(KeyboardInterrupt):
        for sample in itertools.islice(client, options.n):
            print(_json_line(sample) if options.json else _sample_line(sample), flush=True)


def hz(client: Client, options: argparse.Namespace) -> None:
    """Print rate, jitter and drops of each port. Ctrl-C ends the measurement early."""
    client.subscribe(options.pattern)
    arrivals: dict[str, list[tuple[float, Sample]]] = {}
    with contextlib.suppress(KeyboardInterrupt):
        for sample in _collect(client, options.seconds):
            arrivals.setdefault(sample.port, []).append((time.monotonic(), sample))
    if not arrivals:
        raise UwError(
            f"no sample of {options.pattern} came within {options.seconds:g} s; is the world paused?",
            code="no_samples",
            where=options.pattern,
        )
    print(
        f"{'port':32} {'samples':>8} {'sim Hz':>9} {'wall Hz':>9} {'sim jit ms':>11} {'wall jit ms':>11} {'drops':>6}"
    )
    for path in sorted(arrivals):
        found = rate(path, arrivals[path])
        print(
            f"{path:32} {found.samples:8d} {_shown(found.sim_hz):>9} {_shown(found.wall_hz):>9} "
            f"{_shown(found.sim_jitter_ms):>11} {_shown(found.wall_jitter_ms):>11} {found.drops:6d}"
        )


def call(client: Client, options: argparse.Namespace) -> None:
    """Call a service, and print its value as JSON if it has one. Progress and "done" go to standard error."""
    value = client.call(options.service, dict(options.values), on_progress=_print_progress)
    if value is None:
        print(f"{options.service}: done", file=sys.stderr)
    else:
        print(json.dumps(value, indent=2, default=as_text))


def send(client: Client, options: argparse.Namespace) -> None:
    """Command an actuator once, or at a rate."""
    value = dict(options.values)
    if options.rate is None and options.seconds is None:
        ack = client.send(options.path, value)
        conflict = "; another client commands it, too" if ack.conflict else ""
        print(f"applied at tick {ack.tick}, {ack.time_s:.6f} s{conflict}")
        return
    period_s = 1.0 / (options.rate or 10.0)
    start = time.monotonic()
    sent = 0
    while options.seconds is None or time.monotonic() - start < options.seconds:
        client.send(options.path, value)
        sent += 1
        time.sleep(max(start + sent * period_s - time.monotonic(), 0.0))
    print(f"{sent} commands applied")


def plot(client: Client, options: argparse.Namespace) -> None:
    """Collect samples, and draw one field. Ctrl-C ends the collection early."""
    require_matplotlib()
    client.subscribe(options.pattern)
    samples: list[Sample] = []
    with contextlib.suppress(KeyboardInterrupt):
        samples.extend(_collect(client, options.seconds))
    draw(samples, dict(client.ports), options.field, options.out)
    if options.out is not None:
        print(options.out)


def _collect(client: Client, seconds: float) -> Iterator[Sample]:
    """Yield samples for `seconds` of wall time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            yield client.read(timeout=end - time.monotonic())
        except Timeout:
            return


def _print_progress(progress: Progress) -> None:
    print(f"{progress.fraction:6.1%}", file=sys.stderr, flush=True)


def _json_line(sample: Sample) -> str:
    return json.dumps(vars(sample), separators=(",", ":"), default=as_text)


def _sample_line(sample: Sample) -> str:
    values = " ".join(f"{name}={json.dumps(value, default=_brief)}" for name, value in sample.value.items())
    return f"{sample.port} seq={sample.seq} t={sample.time_s:.6f}{'' if sample.valid else ' INVALID'} {values}"


def _brief(value: object) -> object:
    """Return type and shape of a buffer instead of its contents."""
    if isinstance(value, Buffer):
        return f"{value.dtype} {'x'.join(map(str, value.shape)) or 'scalar'}"
    return as_text(value)


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
