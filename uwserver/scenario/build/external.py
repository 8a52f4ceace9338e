"""Builds an external vehicle, a body of a world that follows poses, from a resolved one."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import UnsetType

from uwserver.ports import Port
from uwserver.scenario.build.autopilot import divisor_of
from uwserver.scenario.build.members import mount_of, sensor_slot, truth_slots
from uwserver.scenario.build.modems import range_services, send_slots
from uwserver.scenario.load.resolved import ResolvedVehicle
from uwserver.sensors import Pose
from uwserver.sensors.base import Sensor
from uwserver.units import rad
from uwserver.world.components import ActuatorSlot, SensorStream
from uwserver.world.external.body import External
from uwserver.world.external.motion import LiveMotion, Moving, RecordedMotion, ShownActuator
from uwserver.world.external.ports import Difference, ExternalState
from uwserver.world.external.pose_source import LivePoses, PoseSource, RecordedPoses
from uwserver.world.external.track import AT_REST, TrackPose
from uwserver.world.members import Member
from uwserver.world.sensor_slot import SensorSlot
from uwserver.world.services import component_services
from uwserver.world.vehicle import Vehicle
from uwserver.world.world import World

STATE_RATE_HZ = 10
"""Rate of `state` and `difference`, or the highest rate below it that divides the physics rate."""


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
