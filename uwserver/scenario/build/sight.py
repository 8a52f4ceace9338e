"""What cameras see of a scenario's world: things in the colours that viewers show too, lamps at their present level, and the light.

Only a world with cameras imports this module, because it loads all that pictures need.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

from uwserver.actuators import Lamps
from uwserver.environment.light import WATER_TYPES
from uwserver.physics.geometry.shapes import HalfSpace
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.solids.appearance import CLEAN, OBJECT, SEABED, STRUCTURE, VEHICLE, Colour, colour_of
from uwserver.sensors import Pose
from uwserver.sensors.base import Sight
from uwserver.sensors.optical.camera.faces import GROWTH, PLAIN, TILES, Paint
from uwserver.sensors.optical.camera.faces import SEABED as SAND
from uwserver.sensors.optical.camera.lamps import LampAt
from uwserver.sensors.optical.camera.visible import SceneCache, VisibleThing
from uwserver.units import rad
from uwserver.world.bodies.members import Member
from uwserver.world.world import World

log = logging.getLogger(__name__)


def give_sight(world: World, resolved: Resolved) -> None:
    """Let the cameras of a world see what its scenario has. Everything is prepared now, so that no tick waits for it."""
    environment = resolved.scenario.environment
    scene = _CameraScene(world, resolved)
    cache = SceneCache(scene.things, scene.bodies)
    light = WATER_TYPES[environment.water_type], environment.daylight.daylight
    world.sight = Sight(*light, cache.scene, scene.lamps, lambda: world.hydro.state)
    for fault in cache.faults():
        log.warning("cameras show this without its own looks: %s", fault)


class _CameraScene:
    """Lists the things and the lamps of a world."""

    def __init__(self, world: World, resolved: Resolved) -> None:
        self._world, self._resolved = world, resolved

    def bodies(self) -> tuple[tuple[str, int], ...]:
        """Return the names and rows of the bodies in the world."""
        return tuple((name, member.vehicle.row) for name, member in self._world.members.items())

    def things(self) -> Iterator[VisibleThing]:
        """Yield seabed, structures, and bodies."""
        resolved = self._resolved
        for name, solid in resolved.static.items():
            paint = self._paint(SEABED, SAND) if name == "seabed" else self._paint(STRUCTURE, GROWTH)
            looks, placed = resolved.looks.get(name, b""), solid.shapes[0] if solid.shapes else None
            if looks and placed is not None and not isinstance(placed.shape, HalfSpace):
                yield VisibleThing(name, solid, paint, looks, p=placed.p, R=placed.R)
            else:
                yield VisibleThing(name, solid, paint)
        for name, member, like in self._present():
            row = member.vehicle.row
            if like in resolved.vehicles:
                vehicle = resolved.vehicles[like]
                yield VisibleThing(name, vehicle.solid, self._paint(VEHICLE, PLAIN), vehicle.looks, row)
            else:
                body = resolved.objects[like]
                yield VisibleThing(name, body.solid, self._paint(OBJECT, PLAIN), body.looks, row)

    def _present(self) -> Iterator[tuple[str, Member, str]]:
        """Yield name and member of each body in the world, and the name of the body of the scenario that it is built like."""
        likes = self._world.population.likes()
        for name, member in self._world.members.items():
            if name in likes:
                yield name, member, likes[name]

    def _paint(self, otherwise: Colour, pattern: int) -> Paint:
        """Return the paint of each material. `otherwise` and `pattern` are for materials without an entry of their own."""
        names = self._resolved.materials
        special = dict.fromkeys(CLEAN, PLAIN) | {"tiles": TILES}
        patterns = tuple(special.get(name, pattern) for name in names)
        return Paint((*(colour_of(name, otherwise) for name in names), otherwise), (*patterns, pattern))

    def lamps(self) -> tuple[LampAt, ...]:
        """Return all lamps that shine."""
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
