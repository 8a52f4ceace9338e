"""The command `check`: faults of scenarios and vehicles, and warnings of sensors that cannot work as their tables ask."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import click
import numpy as np

from uwserver.adapter import AdapterTable, installed_adapters
from uwserver.cli.loading import alike, meant
from uwserver.cli.scenarios.other_files import CHECKS, alone, check_other, vehicle_lines, vehicle_summary
from uwserver.cli.terminal import coloured_problems, styled
from uwserver.frames import matrix
from uwserver.physics.geometry.shapes import Solid
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.files.documents import read
from uwserver.scenario.files.errors import Problem, ScenarioError, Severity
from uwserver.scenario.load.export import explain as explain_resolved
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.sensors import ModemTable, Pose, SensorConfig
from uwserver.sensors.acoustic.pinging import PingingSonar, PingTable

_MOST_CORES = 0.8
"""Part of a core above which one thread cannot make all pictures in real time."""
_MOST_NAMED = 4
"""Sensors that are named in a warning; further ones are counted."""
_CAMERA = (
    "more read_out_s or latency_s, fewer pixels (width, height), or lower all rate_hz, so that readings seldom coincide"
)
_SONAR = (
    "more processing_s or latency_s, fewer beams, bins or rays, or lower all rate_hz, so that readings seldom coincide"
)
_SHARE = 0.05
"""Part of a sonar's power, sent and received, that may meet its own vehicle without a warning."""
_MOST_RAYS = 2000
_FARTHEST_M = 100.0


@click.command(short_help="Check files: scenarios, vehicles, devices, missions, plans.")
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@click.option("--explain", is_flag=True, help="Print the loaded scenario or vehicle as TOML, with every default.")
def check(files: tuple[str, ...], explain: bool) -> None:
    """Check files, or what is shipped, by name. The exit status is 1 if any of them has a fault.

    FILE is a scenario, a vehicle file, a device file, a mapping of a log, a mission (a JSON list of items), a plan of QGroundControl, or a
    file of waypoints (QGC WPL 110). Of any other file it says what it is, and which command helps.
    """
    adapters = installed_adapters()
    are_fine = [_check(file, adapters, explain) for file in files]
    sys.exit(0 if all(are_fine) else 1)


def _check(file: str, adapters: Mapping[str, type[Any]], explain: bool) -> bool:
    """Print what is wrong with a file, or a summary; return whether nothing is wrong."""
    kind, path = meant(file)
    if kind is not None and kind in CHECKS:
        return check_other(kind, path, file)
    is_vehicle = kind == "vehicle"
    try:
        resolved = alone(path) if is_vehicle else load(file, adapters=adapters)
        if explain:
            click.echo(explain_resolved(resolved), nl=False)
        for warning in resolved.warnings:
            click.echo(coloured_problems(str(warning)), err=True)
        if resolved.missing:
            click.echo(styled(f"{file}: {resolved.missing}", fg="red"), err=True)
            return False
        problems = unserved(resolved)
        if any(problem.severity == "error" for problem in problems):
            raise ScenarioError(problems)
    except ScenarioError as error:
        click.echo(coloured_problems(str(error)), err=True)
        return False
    for warning in problems:
        click.echo(coloured_problems(str(warning)), err=True)
    # With --explain, standard output is TOML and nothing else.
    text = vehicle_summary(file, resolved) if is_vehicle else summary(file, resolved)
    click.echo(styled("ok", fg="green") + text.removeprefix("ok"), err=explain)
    for line in vehicle_lines(resolved) if is_vehicle else parts(resolved):
        click.echo(f"  {line}", err=explain)
    for line in (*pictures(resolved), *late(resolved), *hasty(resolved), *facing_their_hull(resolved)):
        click.echo(line, err=True)
    return True


def summary(file: str, resolved: Resolved) -> str:
    """Return one line with the vehicles, their ports and rates, and the adapters."""
    scenario = resolved.scenario
    vehicles = ", ".join(f"{name} ({v.entry.model})" for name, v in alike(resolved).items()) or "none"
    ports = [
        f"{vehicle}/{name}{rate}"
        for vehicle, v in alike(resolved).items()
        for name, rate in [
            *((sensor.port_of("", name)[1:], f" {sensor.rate_hz:g} Hz") for name, sensor in v.vehicle.sensors.items()),
            *((f"{name}/send", "") for name, sensor in v.vehicle.sensors.items() if isinstance(sensor, ModemTable)),
            *((f"{name}/{key}", "") for name, sensor in v.vehicle.sensors.items() for key in sensor.streams),
            *((name, "") for name in v.vehicle.actuators),
            *((name, "") for name in v.external_ports),
        ]
    ]
    adapters = [
        f"{name} ({config.__struct_config__.tag}{f', port {port}' if isinstance(port := getattr(config, 'port', None), int) else ''})"
        for name, config in scenario.adapters.items()
    ]
    return (
        f"ok: {file}: physics {scenario.world.rate_hz:g} Hz; vehicles: {vehicles}; ports: {', '.join(ports) or 'none'}; "
        f"adapters: {', '.join(adapters) or 'none'}"
        f"{'; ran ' + ', '.join(scenario.extensions) if scenario.extensions else ''}"
    )


def unserved(resolved: Resolved) -> list[Problem]:
    """Return what adapters name in the world that is missing or does not fit, so that a run would refuse it.

    The world is built only if an adapter has such checks.
    """
    overridden = {
        name: config
        for name, config in resolved.scenario.adapters.items()
        if isinstance(config, AdapterTable) and type(config).faults is not AdapterTable.faults
    }
    if not overridden:
        return []
    # Imported here because it takes a moment, and most scenarios need no such check.
    from uwserver.scenario.build.world import build

    assert resolved.path is not None
    world, document = build(resolved), read(resolved.path)
    problems = []
    for name, config in overridden.items():
        ports = {path: port for path, port in world.ports.items() if config.truth or not port.is_truth}
        for keys, fault in config.faults(ports, world.services):
            # A run tries again and again to start an adapter that is not required.
            severity: Severity = "error" if config.required else "warning"
            text = fault + _off(fault, resolved)
            problems.append(document.problem(("adapters", name, *keys), text, severity=severity))
    return problems


def _off(fault: str, resolved: Resolved) -> str:
    """Return what to do about a fault that names a sensor which exists but is not enabled; "" for other faults."""
    paths = (f'"{vehicle.name}/{sensor}"' for vehicle in resolved.vehicles.values() for sensor in vehicle.off)
    return "; it is off: set enabled = true in its table" if any(path in fault for path in paths) else ""


def parts(resolved: Resolved) -> Iterator[str]:
    """Yield a line for each part of an adapter that serves more than one thing: ``devices.device.dvl: ...``."""
    for name, config in resolved.scenario.adapters.items():
        for key, text in config.parts().items():
            yield f"{name}.{key}: {text}"


def pictures(resolved: Resolved) -> Iterator[str]:
    """Yield a line about the cost in real time of the sensors that make pictures, if there are any."""
    each = [
        (getattr(sensor, "cores", 0.0), f"{vehicle}/{name}")
        for vehicle, v in resolved.vehicles.items()
        for name, sensor in v.vehicle.sensors.items()
        if sensor.enabled
    ]
    each = sorted([one for one in each if one[0] > 0.0], reverse=True)
    if not each:
        return
    total = sum(part for part, _ in each)
    named = ", ".join(f"{path} {100.0 * part:.0f} %" for part, path in each[:_MOST_NAMED])
    more = f" and {len(each) - _MOST_NAMED} more" if len(each) > _MOST_NAMED else ""
    advice = "; one thread makes all pictures, so most will be dropped. Lower rate_hz, beams, bins or rays_vertical, or a clock in mode freerun"
    yield (
        f"pictures: in real time about {100.0 * total:.0f} % of a core while all of them are read ({named}{more})"
        f"{advice if total > _MOST_CORES else ''}"
    )


# -- sensors that cannot keep their times -----------------------------------------------------------------------------------------------


class _Computed(NamedTuple):
    """A sensor whose readings take processor time to compute.

    Attributes:
        path: path of its port.
        cost: processor time of a reading, s.
        given: time from the start of a reading to its delivery, s.
        piece: longest piece of a reading that is computed in pieces, s; otherwise the cost.
        keys: changes to the table that lengthen `given` or shorten `cost`.
    """

    path: str
    cost: float
    given: float
    piece: float
    keys: str

    def keeps(self, other: _Computed) -> float:
        """Return how long another sensor may have to wait for this one, s.

        If this reading is due first, the other one waits for all of it. If it is due later, the other one waits for the piece that is being
        computed, or for what cannot have been done in the time by which this reading began earlier.
        """
        later = self.given - other.given
        return self.cost if later <= 0.0 else max(self.piece, self.cost - later)


def late(resolved: Resolved) -> list[str]:
    """Return a line for each sensor whose readings may be dropped in real time.

    One reading is computed at a time, the one that is due first before others; but a piece that has begun is not interrupted.
    """
    each = [
        _Computed(
            f"{vehicle}/{name}", sensor.computing_s, sensor.given_s, getattr(sensor, "piece_s", sensor.computing_s),
            _SONAR if isinstance(sensor, PingTable) else _CAMERA,
        )
        for vehicle, v in resolved.vehicles.items()
        for name, sensor in v.vehicle.sensors.items()
        if sensor.enabled and hasattr(sensor, "computing_s") and hasattr(sensor, "given_s") and sensor.computing_s > 0.0
    ]  # fmt: skip
    # Two of each group of equal sensors are enough to find the longest wait.
    alike: dict[tuple[float, ...], list[_Computed]] = {}
    for one in each:
        alike.setdefault((one.cost, one.given, one.piece), []).append(one)
    others = [one for few in alike.values() for one in few[:2]]
    lines = []
    for one in each:
        before = max((other for other in others if other is not one), key=lambda other: other.keeps(one), default=None)
        wait = 0.0 if before is None else before.keeps(one)
        need = one.cost + wait
        if need <= one.given:
            continue
        waits = "" if before is None else f" and {_ms(wait)} for {before.path}, which may be computed before it"
        lines.append(
            f"in time: {one.path} has {_ms(one.given)} from the start of a reading to its delivery, and may need {_ms(need)}: "
            f"{_ms(one.cost)} for itself{waits}. In real time such readings are dropped. Give it {one.keys}"
        )
    return _shortened(lines, "may be late too")


def hasty(resolved: Resolved) -> list[str]:
    """Return a line for each sonar whose rate is higher than its range leaves time for."""
    lines = [
        f"rate: {vehicle}/{name} cannot ping rate_hz = {sensor.rate_hz:g} times a second: with range_m = {sensor.range_m:g} and overhead_s = "
        f"{sensor.overhead_s:g} about {sensor.pings_hz:.3g} a second"
        for vehicle, v in resolved.vehicles.items()
        for name, sensor in v.vehicle.sensors.items()
        if sensor.enabled and isinstance(sensor, PingTable) and sensor.rate_hz > sensor.pings_hz
    ]
    return _shortened(lines, "cannot either")


def _shortened(lines: list[str], what: str) -> list[str]:
    more = len(lines) - _MOST_NAMED
    return lines if more <= 0 else [*lines[:_MOST_NAMED], f"and {more} more {what}"]


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"


# -- sonars that see their own vehicle --------------------------------------------------------------------------------------------------


def facing_their_hull(resolved: Resolved) -> Iterator[str]:
    """Yield a line for each sonar of which a good part of the power meets its own vehicle in its initial attitude.

    Rays meet only the outside of shapes, so a sonar inside a shape looks through that one, but not through those beside it.
    """
    seen = set()
    for vehicle in resolved.vehicles.values():
        for name, sensor in vehicle.vehicle.sensors.items():
            # Copies of a vehicle share its file: one line is enough for all.
            key = id(vehicle.vehicle), name
            if vehicle.solid is None or not isinstance(sensor, PingTable) or key in seen:
                continue
            if not (sensor.enabled and sensor.sees_own_vehicle):
                continue
            seen.add(key)
            # Imported here because it takes a moment and few scenarios need it.
            from uwserver.scenario.build.members import mount_of

            mount = mount_of(sensor, vehicle.vehicle)
            share, nearest = blocked(sensor, mount, vehicle.solid)
            if share > _SHARE:
                x, y, z = mount.p
                yield (
                    f"own hull: {vehicle.name}/{name} at [{x:g}, {y:g}, {z:g}] looks at its own vehicle: {100.0 * share:.0f} % of its power meet "
                    f"the collision shapes, the nearest {nearest:.3f} m away, and give a bright bar at short range. Move it away from them "
                    "(position_frd_m), turn it (rpy_deg), or leave sees_own_vehicle out"
                )


def blocked(sensor: SensorConfig, mount: Pose, solid: Solid) -> tuple[float, float]:
    """Return the part of a sonar's power that meets a solid of its body in the initial attitude, and the distance (m) of the nearest point.

    A sonar whose head turns meets its own vehicle in some directions only, which this does not judge: it counts as free.

    Args:
        sensor: the sonar's table, a `PingTable`.
        mount: pose of the sensor in B, X_BS.
        solid: the collision shapes in B.
    """
    # Imported here because its kernels may have to be compiled.
    from uwserver.physics.rays.casting import Rays

    built = sensor.build(mount)
    if not isinstance(built, PingingSonar):
        return 0.0, math.inf
    lighting = built.head.lighting
    grid = lighting.swath.grid
    some = slice(None, None, max(len(grid.direction) // _MOST_RAYS, 1))
    direction: FloatArray = grid.direction[some] @ (np.array(matrix(mount.q)) @ lighting.axes).T
    power = grid.cells["emitted"][some]
    rays, state = Rays(), np.zeros((1, 13))
    state[0, 3] = 1.0
    rays.add_moving(0, solid, 0)
    origin = np.tile(np.array(mount.p), (len(direction), 1))
    distance = rays.cast(state, origin, direction, _FARTHEST_M).distance
    met = np.isfinite(distance)
    return float(power[met].sum() / power.sum()), float(distance.min())
