"""All topics and services of a world, in ROS' words. Made anew when its ports change."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from uwserver.adapter import AdapterContext
from uwserver.ports import Port
from uwserver_adapters.ros.messages import acoustic, codec, motion, onboard
from uwserver_adapters.ros.messages.actions import Action, actions
from uwserver_adapters.ros.messages.commands import CommandTopic, command_topics
from uwserver_adapters.ros.messages.generated import generated
from uwserver_adapters.ros.messages.motion import static_transforms
from uwserver_adapters.ros.messages.ros_port import Facts, RosPort, SensorTopic
from uwserver_adapters.ros.messages.services import Offer, offers
from uwserver_adapters.ros.messages.settings import Setting, settings
from uwserver_adapters.ros.messages.simulation import simulation
from uwserver_adapters.ros.messages.types import Types

MESSAGES: Mapping[str, Callable[[RosPort], Iterator[SensorTopic]]] = {
    "Range": acoustic.altimeter,
    "Attitude": codec.attitude_sensor,
    "Estimate": motion.estimate,
    "Bathymetry": acoustic.bathymetry,
    "BatteryState": onboard.battery,
    "TimeReference": onboard.clock,
    "Contact": onboard.contact,
    "Ctd": onboard.ctd,
    "Dvl": acoustic.dvl,
    "NavSatFix": codec.gps,
    "Imu": motion.imu,
    "BeaconRange": acoustic.beacons,
    "Leak": onboard.leak,
    "MagneticField": motion.magnetometer,
    "Pose": motion.motion_capture,
    "SonarImage": acoustic.multibeam,
    "FluidPressure": onboard.pressure,
    "SonarProfile": acoustic.profiler,
    "LaserScan": onboard.range_array,
    "ShaftSpeeds": onboard.rpm,
    "SonarPing": acoustic.scanning_sonar,
    "SideScan": acoustic.side_scan,
    "SoundSpeed": onboard.sound_speed,
    "TrueAcceleration": motion.truth_acceleration,
    "TruePose": motion.truth_pose,
    "TrueVelocity": motion.truth_velocity,
    "TrueWrench": motion.truth_wrench,
    "BeaconFix": acoustic.beacons,
}
"""Standard message that a port's fields fit -> its topics. Every other port has a generated message."""

CLOCK, TF_STATIC = "/clock", "/tf_static"


@dataclass(frozen=True)
class Catalogue:
    """What a world has.

    Attributes:
        types: types of the distribution.
        facts: facts of the world.
        sensor_topics: all that sensors become; several may share a topic, which is of one type.
        command_topics: topic -> what it commands.
        offers: service -> what it asks for.
        actions: name of an action -> what its goals ask for.
        settings: name of a parameter -> how it is read and changed.
        tf_static: TFMessage of all mounts; latched.
    """

    types: Types
    facts: Facts
    sensor_topics: tuple[SensorTopic, ...]
    command_topics: Mapping[str, CommandTopic]
    offers: Mapping[str, Offer]
    actions: Mapping[str, Action]
    settings: Mapping[str, Setting]
    tf_static: object

    @classmethod
    def of(cls, types: Types, facts: Facts, context: AdapterContext) -> Catalogue:
        """What this adapter may serve of the world now."""
        sensors = [port for port in context.ports.values() if port.direction == "sensor"]
        actuators = [port for port in context.ports.values() if port.direction == "actuator"]

        pilots = [port.path.split("/")[0] for port in sensors if port.kind == "autopilot"]
        return cls(
            types,
            facts,
            tuple(sensor_topic for port in sensors for sensor_topic in topics_of(types, facts, port)),
            {command_topic.name: command_topic for port in actuators for command_topic in command_topics(types, port)},
            {
                offer.name: offer
                for offer in (*offers(types, context.services.values()), *simulation(types, facts, context))
            },
            {action.name: action for action in actions(types, context.services.values())},
            {setting.name: setting for setting in settings(context.services.values())},
            static_transforms(types, facts, [(port.path, port.message or "") for port in sensors], pilots),
        )

    def clock(self, t_ns: int) -> object:
        """A message of ``/clock``."""
        return self.types.make("rosgraph_msgs/msg/Clock", clock=self.types.stamp(self.facts.epoch_ns + t_ns))


def topics_of(types: Types, facts: Facts, port: Port) -> list[SensorTopic]:
    """The topics of one sensor: of standard messages, or where its fields do not fit any, of a generated one."""
    ros_port = RosPort(types, facts, port)
    table = MESSAGES.get(port.message or "", generated)
    try:
        return list(table(ros_port))
    except ValueError:  # it lacks a field
        return list(generated(ros_port))
