"""The fittings of a vehicle as viewers get them: actuators, lamps, sensors, and the beacons that sensors interrogate."""

from __future__ import annotations

import math
from collections.abc import Iterator

from msgspec import UNSET, UnsetType, structs

from uwserver.modifiers import Bias, GaussMarkov, WhiteNoise
from uwserver.physics.dynamics.params import BodyParams
from uwserver.ports import ActuatorView, BeaconView, LampView, SensorView
from uwserver.scenario.build.members import mount_of
from uwserver.scenario.load.resolved import ResolvedVehicle
from uwserver.scenario.scene.shapes import unit
from uwserver.scenario.vehicle.appendage_tables import Fin
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.sensors import Pose, SensorTable
from uwserver.sensors.base import Sigma
from uwserver.units import rad
from uwserver.world.state.scene_probe import full_thrust


def actuator_views(name: str, resolved: ResolvedVehicle, params: BodyParams) -> tuple[ActuatorView, ...]:
    """Return all actuators in the order of the kernel's rows and of `SceneState.achieved`: thrusters, fins, propellers, ballasts, moving masses.

    Args:
        name: name of the body, for the paths of its ports.
        resolved: the vehicle.
        params: parameters of its rows.
    """
    file = resolved.vehicle
    ports = dict(commanded(name, file))
    views = []
    for table, view in _uncommanded(resolved, params):
        port, index = ports.get(f"{table}.{view.name}", (None, None))
        views.append(structs.replace(view, port=port, index=index))
    return tuple(views)


def lamp_views(file: VehicleFile) -> tuple[LampView, ...]:
    """Return all lamps of a vehicle."""
    views = []
    for name, lamp in file.lamps.items():
        mount = file.mounts[lamp.mount]
        pose = Pose.from_degrees(mount.rpy_deg, mount.position_frd_m)
        views.append(LampView(name, pose.p, pose.q, rad(lamp.cone_deg), lamp.lumens))
    return tuple(views)


Place = tuple[str | None, int | None]
"""An actuator port, and an element of its vector."""


def commanded(name: str, file: VehicleFile) -> Iterator[tuple[str, Place]]:
    """Yield what each actuator port of a vehicle commands: ("thrusters.fore", (path, index)). The index is None if the field is a number."""
    for key, config in file.actuators.items():
        path = f"{name}/{key}"
        devices = config.devices()
        if devices is not None:
            for k, member in enumerate(devices.members or getattr(file, devices.table)):
                yield f"{devices.table}.{member}", (path, k if devices.is_vector else None)


_SMALL_FIN_M2 = 0.0064
_ASPECT = 2.0
"""Area (m2) and aspect ratio of a fin whose table gives neither."""


def _uncommanded(resolved: ResolvedVehicle, params: BodyParams) -> Iterator[tuple[str, ActuatorView]]:
    """Yield all actuators in their order, each with its table in the vehicle file, and without the port that commands it."""
    file = resolved.vehicle
    for thruster, (key, table) in zip(params.thrusters, file.thrusters.items(), strict=True):
        ahead, astern = full_thrust(thruster)
        yield "thrusters", ActuatorView(
            key, "thruster", table.position_frd_m, unit(table.axis_frd), diameter=resolved.devices[key].propeller.diameter_m,
            handedness=table.handedness, low=-astern, high=ahead, unit="N",
        )  # fmt: skip
    for key, fin in file.fins.items():
        limit = rad(fin.limit_deg)
        yield "fins", ActuatorView(
            key, "fin", fin.position_frd_m, unit(fin.hinge_frd), chord=unit(fin.chord_frd), span=_span(fin),
            low=-limit, high=limit, unit="rad",
        )  # fmt: skip
    for key, propeller in file.propellers.items():
        most = propeller.max_speed_radps
        yield "propellers", ActuatorView(
            key, "propeller", propeller.position_frd_m, unit(propeller.axis_frd), diameter=propeller.diameter_m,
            handedness=propeller.handedness, low=-most, high=most, unit="rad/s",
        )  # fmt: skip
    for key, ballast in file.ballasts.items():
        low, high = ballast.min_volume_m3, ballast.max_volume_m3
        yield "ballasts", ActuatorView(key, "ballast", ballast.position_frd_m, low=low, high=high, unit="m^3")
    for key, mass in file.moving_masses.items():
        low, high, axis = mass.min_position_m, mass.max_position_m, unit(mass.axis_frd)
        yield "moving_masses", ActuatorView(key, "moving_mass", (0.0, 0.0, 0.0), axis, low=low, high=high, unit="m")


def _span(fin: Fin) -> float:
    """Return the span of a fin. If the file gives only derivatives, it is that of a small fin."""
    if not isinstance(fin.span_m, UnsetType):
        return fin.span_m
    area = fin.area_m2 or _SMALL_FIN_M2
    return math.sqrt(area * (_ASPECT if isinstance(fin.aspect_ratio, UnsetType) else fin.aspect_ratio))


def sensor_views(name: str, file: VehicleFile) -> tuple[SensorView, ...]:
    """Return all sensors of a vehicle, which has this name in the world."""
    views = []
    for key, config in file.sensors.items():
        traits, mount = config.traits(), mount_of(config, file)
        path, kind = config.port_of(name, key), str(config.__struct_config__.tag)
        exact, message = sigmas(config) or UNSET, config.message or UNSET
        views.append(SensorView(path, kind, mount.p, mount.q, traits.beams, traits.fan, exact, traits.address, message))
    return tuple(views)


def beacon_views(name: str, file: VehicleFile) -> Iterator[BeaconView]:
    """Yield the beacons that the sensors of a vehicle interrogate, at their assumed positions at t = 0."""
    for key, config in file.sensors.items():
        for beacon in config.traits().beacons:
            yield BeaconView(beacon.name, f"{name}/{key}", beacon.p, beacon.body, delay=beacon.delay)


def sigmas(config: SensorTable) -> dict[str, Sigma]:
    """Return field -> 1-sigma of a sample in the field's unit: one number for each axis, or one for all components.

    White noise, slowly changing biases, and biases drawn once a run are added in variance. Scale errors, drifts without limit and modifiers of other
    kinds are left out. Fields without configured errors have no entry, and a sensor that is `ideal` has only those of its modifiers.
    """
    variances: dict[str, Sigma] = {}
    if not getattr(config, "ideal", False):
        for field, sigma in config.traits().sigmas.items():
            variances[field] = tuple(part * part for part in sigma)
    for modifier in config.modifiers.values():
        if isinstance(modifier, WhiteNoise | GaussMarkov | Bias):
            variance = modifier.sigma**2
            if isinstance(modifier, WhiteNoise):
                variance += modifier.density**2 * config.rate_hz
            before = variances.get(modifier.field, (0.0,))
            variances[modifier.field] = tuple(part + variance for part in before)
    return {field: tuple(map(math.sqrt, parts)) for field, parts in variances.items() if any(parts)}
