"""All topics and services of a world, in ROS' words. Made anew when its ports change."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from uwserver.adapter import AdapterContext
from uwserver.ports import Port
from uwserver_adapters.ros.messages import acoustic, codec, motion, onboard, water
from uwserver_adapters.ros.messages.actions import Action, actions
from uwserver_adapters.ros.messages.commands import Inlet, inlets
from uwserver_adapters.ros.messages.generated import generated
from uwserver_adapters.ros.messages.services import Offer, offers
from uwserver_adapters.ros.messages.settings import Setting, settings
from uwserver_adapters.ros.messages.simulation import simulation
from uwserver_adapters.ros.messages.source import Facts, Outlet, Source
from uwserver_adapters.ros.messages.transforms import static_transforms
from uwserver_adapters.ros.messages.types import Types

KINDS: Mapping[str, Callable[[Source], Iterator[Outlet]]] = {
    "altimeter": acoustic.altimeter,
    "attitude": codec.attitude_sensor,
    "autopilot": motion.estimate,
    "bathymetry": acoustic.bathymetry,
    "battery": onboard.battery,
    "clock": onboard.clock,
    "contact": onboard.contact,
    "ctd": water.ctd,
    "dvl": acoustic.dvl,
    "gps": codec.gps,
    "imu": motion.imu,
    "lbl": acoustic.beacons,
    "leak": onboard.leak,
    "magnetometer": motion.magnetometer,
    "motion_capture": motion.motion_capture,
    "multibeam": acoustic.multibeam,
    "pressure": water.pressure,
    "profiler": acoustic.profiler,
    "range_array": onboard.range_array,
    "rpm": onboard.rpm,
    "scanning_sonar": acoustic.scanning_sonar,
    "side_scan": acoustic.side_scan,
    "sound_speed": water.sound_speed,
    "truth_acceleration": motion.truth_acceleration,
    "truth_pose": motion.truth_pose,
    "truth_velocity": motion.truth_velocity,
    "truth_wrench": motion.truth_wrench,
    "usbl": acoustic.beacons,
}
"""Kind of a port -> its topics; every other kind has a generated message."""

CLOCK, TF_STATIC = "/clock", "/tf_static"


@dataclass(frozen=True)
class Catalogue:
    """What a world has.

    Attributes:
        types: of the distribution.
        facts: of the world.
        outlets: all that sensors become; several may share a topic, which is of one type.
        inlets: topic -> what it commands.
        offers: service -> what it asks for.
        actions: name of an action -> what its goals ask for.
        settings: name of a parameter -> how it is read and changed.
        tf_static: TFMessage of all mounts; latched.
    """

    types: Types
    facts: Facts
    outlets: tuple[Outlet, ...]
    inlets: Mapping[str, Inlet]
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
            tuple(outlet for port in sensors for outlet in topics_of(types, facts, port)),
            {inlet.topic: inlet for port in actuators for inlet in inlets(types, port)},
            {
                offer.name: offer
                for offer in (*offers(types, context.services.values()), *simulation(types, facts, context))
            },
            {action.name: action for action in actions(types, context.services.values())},
            {setting.name: setting for setting in settings(context.services.values())},
            static_transforms(types, facts, [(port.path, port.kind) for port in sensors], pilots),
        )

    def clock(self, t_ns: int) -> object:
        """A message of ``/clock``."""
        return self.types.make("rosgraph_msgs/msg/Clock", clock=self.types.stamp(self.facts.epoch_ns + t_ns))


def topics_of(types: Types, facts: Facts, port: Port) -> list[Outlet]:
    """The topics of one sensor: of standard messages, or where its fields are others than its kind's, of a generated one."""
    source = Source(types, facts, port)
    table = KINDS.get(port.kind, generated)
    try:
        return list(table(source))
    except ValueError:  # it lacks a field
        return list(generated(source))
