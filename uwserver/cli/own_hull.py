"""Warns of sonars with `sees_own_vehicle` whose field of view is filled by the collision shapes of their own vehicle."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from uwserver.frames import matrix
from uwserver.physics.geometry.shapes import Solid
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.load.resolved import Resolved
from uwserver.sensors import Pose, SensorConfig
from uwserver.sensors.acoustic.pinging import PingingSonar, PingTable

_SHARE = 0.05
"""Part of a sonar's power, sent and received, that may meet its own vehicle without a warning."""
_MOST_RAYS = 2000
_FARTHEST_M = 100.0


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
