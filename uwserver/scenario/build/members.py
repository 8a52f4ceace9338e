"""Builds the members of a world, bodies with their components, from resolved vehicles and objects.

An external vehicle is a body that follows poses.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import UNSET, UnsetType, structs

from uwserver.actuators import ActuatorConfig, Body, CameraMount
from uwserver.modifiers import Modifier, ModifierConfig, Stream
from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, Placed, Solid, Sphere, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.random import key_of
from uwserver.ports import Field, Port
from uwserver.scenario.build.autopilot import build_autopilot, divisor_of
from uwserver.scenario.build.modems import range_services, send_slots
from uwserver.scenario.load.resolved import Resolved, ResolvedObject, ResolvedVehicle
from uwserver.scenario.vehicle.body import own_rows
from uwserver.scenario.vehicle.tables import Electric as ElectricTable
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.sensors import Pose, Sensor, SensorConfig, SensorTable
from uwserver.sensors.base import Outline
from uwserver.sensors.compiled import CompiledSensor
from uwserver.sensors.truth import TRUTH
from uwserver.sensors.wiring import Electric, Wiring
from uwserver.units import NANOSECONDS, rad
from uwserver.world.bodies.members import Member
from uwserver.world.external.body import Difference, External, ExternalState
from uwserver.world.external.motion import LiveMotion, Moving, RecordedMotion, ShownActuator
from uwserver.world.external.pose_source import LivePoses, PoseSource, RecordedPoses
from uwserver.world.external.track import AT_REST, TrackPose
from uwserver.world.parts.vehicle import Vehicle
from uwserver.world.sensing.sensor_rows import SensorStream
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.state.services import component_services
from uwserver.world.stepping.commands import ActuatorSlot
from uwserver.world.world import World

if TYPE_CHECKING:
    from uwserver.physics.scene import Stocks


log = logging.getLogger(__name__)
STATE_RATE_HZ = 10
"""Rate of `state` and `difference`, or the highest rate below it that divides the physics rate."""


def physics_rate(rate_hz: float) -> Fraction:
    """Return the rate as the exact fraction that the user wrote in decimals."""
    return Fraction(str(rate_hz))


def build_scene(world: World, resolved: Resolved, stocks: Stocks | None = None) -> None:
    """Give a world the solid things of its scenario that never move. stocks: see `Scene`."""
    # A world without anything solid does not need these engines.
    from uwserver.physics.rays.surfaces import has_embree
    from uwserver.physics.scene import Scene
    from uwserver.physics.warm import solid_kernels

    solid_kernels()
    if not has_embree():
        log.info("embreex is not installed: rays of sonars use a slower tree of uwserver's own, with the same results")
    scene = Scene(lambda: world.hydro.state, resolved.scenario.world.engine, stocks)
    for solid in resolved.static.values():
        scene.add_static(solid)
    world.set_scene(scene)


def object_member(world: World, resolved: ResolvedObject, row: int, name: str) -> Member:
    """Return a free object, whose body is in a row of the world, with its components."""
    truth = resolved.entry.truth
    sensors = () if isinstance(truth, UnsetType) else tuple(truth_slots(world, name, truth.rate_hz, row))
    services = tuple(component_services(world, sensors, ()))
    return Member(Vehicle(name, "object", row, world.hydro), sensors, (), services, resolved.solid, is_object=True)


def vehicle_member(world: World, resolved: ResolvedVehicle, row: int, name: str) -> Member:
    """Return a vehicle, whose body is in a row of the world, with its components."""
    file, entry, hydro = resolved.vehicle, resolved.entry, world.hydro
    params, bodies = hydro.params[row], own_rows(hydro, file, row)
    body = bodies[""]
    tables = {key: device.electric for key, device in resolved.devices.items()}
    electrics = {key: electric_of(table) for key, table in tables.items() if not isinstance(table, UnsetType)}
    wiring = Wiring(hydro, row, body.thrusters, electrics)
    mounts = {key: mount_of(config, file) for key, config in file.sensors.items()}
    configs: dict[str, Any] = dict(file.sensors)
    for key, config in file.sensors.items():
        for name_below, (companion, mount) in config.companions(mounts[key]).items():
            configs[f"{key}/{name_below}"], mounts[f"{key}/{name_below}"] = companion, mount
    made = {key: config.build(mounts[key]) for key, config in configs.items()}
    built: dict[str, SensorSlot] = {}
    for key, sensor in sorted(made.items(), key=lambda item: item[1].repeats):
        path = configs[key].port_of(name, key)
        built[key] = sensor_slot(world, path, configs[key], sensor, row, mounts[key], built)
    for slot in built.values():
        slot.wiring = wiring
        slot.sensor.wire(wiring)
    sensors = list(built.values())
    if not isinstance(entry.truth, UnsetType):
        sensors += truth_slots(world, name, entry.truth.rate_hz, row)
    actuators = {
        key: _actuator(world, f"{name}/{key}", config, bodies.get(key, body)) for key, config in file.actuators.items()
    }
    hang_sensors(built, configs, actuators)
    ports = {slot.port.path: slot.port for slot in built.values()}
    piloted = build_autopilot(world, resolved, params, name, row, mounts, ports, actuators)
    slots = [*actuators.values(), *send_slots(world, sensors)]
    if piloted is not None:
        sensors.append(piloted.state)
        slots += piloted.set_points
    services = (*component_services(world, sensors, slots), *range_services(world, slots))
    services += () if piloted is None else piloted.services
    others = () if piloted is None else (piloted.part,)
    return Member(Vehicle(name, file.name, row, hydro), tuple(sensors), tuple(slots), services, resolved.solid, others)


def electric_of(table: ElectricTable) -> Electric:
    """Return the power and speed of a thruster, from the table of its device."""
    power, speed = table.reverse_power_WpN15, table.reverse_speed_radpspN05
    return Electric(
        (table.power_WpN15, table.power_WpN15 if isinstance(power, UnsetType) else power),
        (table.speed_radpspN05, table.speed_radpspN05 if isinstance(speed, UnsetType) else speed),
    )


def mount_of(config: SensorTable, file: VehicleFile) -> Pose:
    """Return X_BS of a sensor: the pose of its mount, or its own."""
    place = config if config.mount is UNSET else file.mounts[str(config.mount)]
    return Pose.from_degrees(place.rpy_deg, place.position_frd_m)


def hang_sensors(
    slots: Mapping[str, SensorSlot], configs: Mapping[str, SensorTable], actuators: Mapping[str, ActuatorSlot]
) -> None:
    """Let sensors tilt with the mounts that they sit on."""
    joints = {
        slot.actuator.mount: slot.actuator for slot in actuators.values() if isinstance(slot.actuator, CameraMount)
    }
    for key, slot in slots.items():
        mount = str(configs[key].mount)
        for sensor in filter(None, (slot.sensor, slot.twin) if mount in joints else ()):
            sensor.joint = joints[mount]


def sensor_slot(
    world: World,
    path: str,
    config: SensorConfig,
    sensor: Sensor,
    row: int,
    mount: Pose,
    built: Mapping[str, SensorSlot],
) -> SensorSlot:
    """Return the slot of a sensor in a world.

    Args:
        world: the world.
        path: path of its port.
        config, sensor, mount: its table, the sensor that was built of it, and its mount.
        row: row of the body.
        built: the sensors of the vehicle that are built already.
    """
    divisor = round(world.rate_hz / physics_rate(config.rate_hz))
    sensor.dt = float(divisor / world.rate_hz)
    sensor.start(key_of(world.seed, path))
    sensor.load_kernels()
    sensor.join(built)
    kind = str(config.__struct_config__.tag)
    rate_hz = float(world.rate_hz / divisor)
    port = Port(path, "sensor", kind, sensor.fields, sensor.doc, rate_hz, message=config.message or UNSET)
    streams = [SensorStream(port, _modifiers(world, port, config.modifiers))]
    for name, side in config.streams.items():
        at = structs.replace(port, path=f"{path}/{name}")
        streams.append(SensorStream(at, _modifiers(world, at, side.modifiers), side.ideal))
    twin: Sensor | None = None
    needs_twin = "ideal" in config.__struct_fields__ and any(stream.ideal for stream in streams)
    if needs_twin and not isinstance(sensor, CompiledSensor):
        twin = structs.replace(config, ideal=True).build(mount)
        twin.load_kernels()
    latency_ns = round((config.latency_s or 0.0) * NANOSECONDS)
    return SensorSlot(sensor, tuple(streams), row, world.rate_hz, divisor, latency_ns, twin)


def _modifiers(world: World, port: Port, tables: Mapping[str, ModifierConfig]) -> tuple[Modifier, ...]:
    assert port.rate_hz is not None
    return tuple(
        table.build(Stream(port.fields, 1.0 / port.rate_hz, key_of(world.seed, f"{port.path}/{name}")))
        for name, table in tables.items()
    )


def stream_of(seed: int, path: str) -> np.random.Generator:
    """Return the random stream of a path. It depends only on the seed of the scenario and on the path."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=tuple(path.encode()))))


def truth_slots(world: World, vehicle: str, rate_hz: float, row: int) -> Iterable[SensorSlot]:
    """Yield the sensors of the ground truth of the body in a row."""
    divisor = round(world.rate_hz / physics_rate(rate_hz))
    for name, make in TRUTH.items():
        sensor = make()  # it draws nothing; a random stream of its own would take longer than all the rest
        path = f"{vehicle}/truth/{name}"
        sensor.start(key_of(world.seed, path))
        kind, message, rate = f"truth_{name}", f"True{name.capitalize()}", float(world.rate_hz / divisor)
        port = Port(path, "sensor", kind, sensor.fields, sensor.doc, rate, message=message)
        yield SensorSlot(sensor, (SensorStream(port),), row, world.rate_hz, divisor)


def _actuator(world: World, path: str, config: ActuatorConfig, body: Body) -> ActuatorSlot:
    actuator = config.build(body)
    fields: tuple[Field, ...] = actuator.fields
    kind = str(config.__struct_config__.tag)
    propulsors = getattr(actuator, "propulsors", UNSET)  # only thrusters have some
    message, timeout_s = config.message or UNSET, config.timeout_s or None
    port = Port(
        path, "actuator", kind, fields, actuator.doc, timeout_s=timeout_s, propulsors=propulsors, message=message
    )
    return ActuatorSlot(port, actuator, world.rate_hz, round(physics_rate(config.timeout_s) * world.rate_hz))


def survey_structures(member: Member, vehicle: ResolvedVehicle, static: Mapping[str, Solid]) -> None:
    """Give the sensors of a new vehicle the outlines of the structures that their tables name. static: seabed and structures in N, by name."""
    sensors = {slot.path: slot.sensor for slot in member.sensors}
    for key, config in vehicle.vehicle.sensors.items():
        names = {named.name for named in config.traits().names if named.table == "structures"} & static.keys()
        if names:
            sensor = sensors[config.port_of(member.vehicle.name, key)]
            sensor.outlines = {name: outline_of(static[name]) for name in names}


def outline_of(solid: Solid) -> Outline:
    """Return the box around a structure, along the axes of its first shape."""
    first = solid.shapes[0]
    corners = np.concatenate([_corners(placed) for placed in solid.shapes])
    local = (corners - first.p) @ first.R
    low, high = local.min(axis=0), local.max(axis=0)
    middle = first.p + first.R @ (0.5 * (low + high))
    x, y, z = middle.tolist()
    a, b, c = (0.5 * (high - low)).tolist()
    return Outline((x, y, z), first.q, (a, b, c))


def _corners(placed: Placed) -> FloatArray:
    """Return (n, 3) points of N whose bounding box is that of the shape."""
    shape = placed.shape
    if isinstance(shape, TriangleMesh):
        points: FloatArray = np.asarray(shape.vertices, dtype=np.float64)
    elif isinstance(shape, ConvexHull):
        points = np.asarray(shape.points, dtype=np.float64)
    else:
        if isinstance(shape, Box):
            half = np.array(shape.half)
        elif isinstance(shape, Sphere):
            half = np.full(3, shape.radius)
        elif isinstance(shape, Cylinder | Capsule):
            ends = shape.radius if isinstance(shape, Capsule) else 0.0
            half = np.array([shape.half_length + ends, shape.radius, shape.radius])
        else:
            raise TypeError(f"a structure cannot have the shape {type(shape).__name__}")
        signs = np.array([[i, j, k] for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
        points = signs * half
    return points @ placed.R.T + placed.p


# -- external vehicles ------------------------------------------------------------------------------------------------------------------


def external_member(world: World, resolved: ResolvedVehicle, row: int, name: str) -> Member:
    """Return an external vehicle, whose body is in a row of the world, with its ports."""
    entry, slots, shown = resolved.entry, list[ActuatorSlot](), moving_parts(resolved)
    source: PoseSource
    moving: Moving
    if resolved.track is not None:
        source = RecordedPoses(resolved.track, entry.outside, entry.max_gap_s)
        moving = RecordedMotion(shown, resolved.track.motion)
    else:
        q = Pose.from_degrees(entry.attitude_rpy_deg).q
        start = TrackPose(entry.position_ned_m, q, AT_REST, 0.0)
        source = live = LivePoses(lambda: world.t_ns, start, entry.outside, entry.max_gap_s, entry.predict_s)
        port = Port(f"{name}/pose", "actuator", "pose", live.fields, live.doc, message="FollowedPose")
        slots.append(ActuatorSlot(port, live, world.rate_hz, 0))
        moving = turning = LiveMotion(shown, lambda: world.t_ns)
        if shown:
            port = Port(f"{name}/actuators", "actuator", "actuators", turning.fields, turning.doc)
            slots.append(ActuatorSlot(port, turning, world.rate_hz, 0))
    sensors = list(_status_slots(world, resolved, row, name, source))
    for key, config in resolved.vehicle.sensors.items():
        mount = mount_of(config, resolved.vehicle)
        path, modem = config.port_of(name, key), config.build(mount)
        sensors.append(sensor_slot(world, path, config, modem, row, mount, {}))
    slots += send_slots(world, sensors)
    if not isinstance(entry.truth, UnsetType):
        sensors += truth_slots(world, name, entry.truth.rate_hz, row)
    part = External(name, world.hydro, row, source, ghost=not entry.solid, moving=moving)
    services = (*component_services(world, sensors, slots), *range_services(world, slots))
    vehicle = Vehicle(name, resolved.vehicle.name, row, world.hydro)
    return Member(vehicle, tuple(sensors), tuple(slots), services, resolved.solid, (part,), led=True)


def moving_parts(resolved: ResolvedVehicle) -> tuple[ShownActuator, ...]:
    """Return the actuators of an external vehicle that viewers move, in the order of `uwserver.scenario.scene.fittings.actuator_views`."""
    file = resolved.vehicle
    fins = (ShownActuator(name, rad(fin.limit_deg)) for name, fin in file.fins.items())
    return (*map(ShownActuator, file.thrusters), *fins, *map(ShownActuator, file.propellers))


def _status_slots(
    world: World, resolved: ResolvedVehicle, row: int, name: str, source: PoseSource
) -> Iterator[SensorSlot]:
    entry = resolved.entry
    shown: list[tuple[str, str, Sensor]] = [("state", "external", ExternalState(source))]
    if not isinstance(entry.compare_with, UnsetType):
        shown.append(("difference", "external_difference", Difference(entry.compare_with)))
    divisor = divisor_of(world.rate_hz, entry.rate_hz, STATE_RATE_HZ)
    for key, kind, sensor in shown:
        port = Port(f"{name}/{key}", "sensor", kind, sensor.fields, sensor.doc, float(world.rate_hz / divisor))
        yield SensorSlot(sensor, (SensorStream(port),), row, world.rate_hz, divisor)
