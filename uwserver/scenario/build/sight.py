"""What cameras see of a scenario's world: things with the colours that viewers know, lamps as their actuators have them, and its light."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import TYPE_CHECKING

from msgspec import UnsetType

from uwserver.actuators import Lamps
from uwserver.environment.light import WATER_TYPES
from uwserver.physics.geometry.shapes import HalfSpace
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.solids.palette import CLEAN, OBJECT, SEABED, STRUCTURE, VEHICLE, Colour, colour_of
from uwserver.sensors import Pose
from uwserver.sensors.sight import Sight
from uwserver.units import rad
from uwserver.world.members import Member
from uwserver.world.world import World

if TYPE_CHECKING:
    from uwserver.sensors.optical.camera.faces import Paint
    from uwserver.sensors.optical.camera.lamps import LampAt
    from uwserver.sensors.optical.camera.visible import Seen, Watch

log = logging.getLogger(__name__)
_SEABED_NAME = "seabed"


def give_sight(world: World, resolved: Resolved) -> Watch | None:
    """Let cameras of a world see what its scenario has; None where no sensor needs it, so that nothing is loaded for it."""
    if not any(config.traits().needs_sight for config in resolved.sensors):
        return None
    from uwserver.sensors.optical.camera.visible import Watch

    environment = resolved.scenario.environment
    scenery = _Scenery(world, resolved)
    watch = Watch(scenery.things, scenery.who)
    light = WATER_TYPES[environment.water_type], environment.daylight.daylight
    world.sight = Sight(*light, watch.look, scenery.lamps, lambda: world.hydro.state)
    return watch


def look_around(watch: Watch | None) -> None:
    """Make what cameras look at before a tick has to wait for it, and say what cannot be shown."""
    for fault in [] if watch is None else watch.faults():
        log.warning("cameras show it plain: %s", fault)


class _Scenery:
    """Tells what stands and swims in a world."""

    def __init__(self, world: World, resolved: Resolved) -> None:
        self._world, self._resolved = world, resolved

    def who(self) -> tuple[tuple[str, int], ...]:
        """The bodies in the world, with their rows."""
        return tuple((name, member.vehicle.row) for name, member in self._world.members.items())

    def things(self) -> Iterator[Seen]:
        """Seabed, structures, and bodies."""
        from uwserver.sensors.optical.camera.faces import GROWTH, PLAIN
        from uwserver.sensors.optical.camera.faces import SEABED as SAND
        from uwserver.sensors.optical.camera.visible import Seen

        resolved = self._resolved
        for name, solid in resolved.static.items():
            is_seabed = name == _SEABED_NAME and not isinstance(resolved.scenario.seabed, UnsetType)
            paint = self._paint(SEABED, SAND) if is_seabed else self._paint(STRUCTURE, GROWTH)
            looks, placed = resolved.looks.get(name, b""), solid.shapes[0] if solid.shapes else None
            if looks and placed is not None and not isinstance(placed.shape, HalfSpace):
                yield Seen(name, solid, paint, looks, p=placed.p, R=placed.R)
            else:
                yield Seen(name, solid, paint)
        for name, member, like in self._present():
            row = member.vehicle.row
            if like in resolved.vehicles:
                vehicle = resolved.vehicles[like]
                yield Seen(name, vehicle.solid, self._paint(VEHICLE, PLAIN), vehicle.looks, row)
            else:
                body = resolved.objects[like]
                yield Seen(name, body.solid, self._paint(OBJECT, PLAIN), body.looks, row)

    def _present(self) -> Iterator[tuple[str, Member, str]]:
        """Who is in the world, and like whom of the scenario: one that was dismissed is not."""
        likes = self._world.population.likes()
        for name, member in self._world.members.items():
            if name in likes:
                yield name, member, likes[name]

    def _paint(self, otherwise: Colour, pattern: int) -> Paint:
        """By material; `otherwise` and `pattern` for one that nobody names."""
        from uwserver.sensors.optical.camera.faces import PLAIN, TILES, Paint

        names = self._resolved.materials
        special = dict.fromkeys(CLEAN, PLAIN) | {"tiles": TILES}
        patterns = tuple(special.get(name, pattern) for name in names)
        return Paint((*(colour_of(name, otherwise) for name in names), otherwise), (*patterns, pattern))

    def lamps(self) -> tuple[LampAt, ...]:
        """All lamps that shine."""
        from uwserver.sensors.optical.camera.lamps import LampAt

        found = []
        for _, member, like in self._present():
            vehicle = self._resolved.vehicles.get(like)
            if vehicle is None or not vehicle.vehicle.lamps:
                continue
            file = vehicle.vehicle
            for slot in member.actuators:
                if isinstance(slot.actuator, Lamps):
                    for lamp, level in zip(slot.actuator.names, slot.actuator.memory.levels, strict=True):
                        if level > 0.0:
                            table = file.lamps[lamp]
                            place = file.mounts[table.mount]
                            pose = Pose.from_degrees(place.rpy_deg, place.position_frd_m)
                            lumens = level * table.lumens
                            found.append(LampAt(member.vehicle.row, pose.p, pose.q, rad(table.cone_deg), lumens))
        return tuple(found)
