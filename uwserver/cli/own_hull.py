"""Sonars that shall see their own vehicle, and see little else: so near to its collision shapes, or so turned, that these fill their field."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uwserver.frames import matrix
from uwserver.physics.geometry.shapes import Solid
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.load.resolved import Resolved
from uwserver.sensors import Pose, SensorConfig
from uwserver.sensors.acoustic.pinging import PingingSonar, PingTable

_SHARE = 0.05
"""Of the power that a sonar sends and hears; what meets less of it is its margin."""
_MOST = 2000
_FARTHEST_M = 100.0


def facing_their_hull(resolved: Resolved) -> Iterator[str]:
    """A line for each sonar of which a good part of the rays meets its own vehicle, as it starts.

    Only the outside of shapes is met: a sonar that sits inside one looks through that one, but not through those beside it.
    """
    told = set()
    for vehicle in resolved.vehicles.values():
        for name, sensor in vehicle.vehicle.sensors.items():
            key = id(vehicle.vehicle), name  # copies share it
            if vehicle.solid is None or not isinstance(sensor, PingTable) or not sensor.enabled or key in told:
                continue
            if not sensor.sees_own_vehicle:
                continue
            told.add(key)
            from uwserver.scenario.build.members import mount_of  # takes a moment, which most scenarios need not

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
    """The part of a sonar's power that meets a solid of its body, as it starts, and the distance (m) of what is nearest.

    Args:
        sensor: its table, of a `PingTable`.
        mount: X_BS.
        solid: in B.
    """
    from uwserver.physics.rays.casting import Rays  # compiled

    built = sensor.build(mount)
    assert isinstance(built, PingingSonar)
    lighting = built.head.lighting
    grid = lighting.swath.grid
    some = slice(None, None, max(len(grid.direction) // _MOST, 1))
    direction: FloatArray = grid.direction[some] @ (np.array(matrix(mount.q)) @ lighting.axes).T
    power = grid.cells["emitted"][some]
    rays, state = Rays(), np.zeros((1, 13))
    state[0, 3] = 1.0
    rays.add_moving(0, solid, 0)
    origin = np.tile(np.array(mount.p), (len(direction), 1))
    distance = rays.cast(state, origin, direction, _FARTHEST_M).distance
    met = np.isfinite(distance)
    return float(power[met].sum() / power.sum()), float(distance.min())
