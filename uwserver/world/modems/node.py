"""A modem in the world as the medium sees it: its sensor, the vehicle that carries it, and where it is or was a little while ago."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from uwserver.frames import Quat, Vec3, multiply, rotate
from uwserver.sensors.base import earlier
from uwserver.sensors.modem import Modem
from uwserver.world.sensor_slot import SensorSlot
from uwserver.world.vehicle import Vehicle


class Node(NamedTuple):
    """One modem.

    Attributes:
        path: of the port where it tells what it hears.
        slot: of that port.
        modem: its sensor.
        vehicle: that carries it.
    """

    path: str
    slot: SensorSlot
    modem: Modem
    vehicle: Vehicle

    def pose(self, ago: float = 0.0) -> tuple[Vec3, Quat]:
        """p_NS (m) and q_NS, a little while ago (s)."""
        p, q = self.vehicle.p_NB, self.vehicle.q_NB
        if ago:
            p, q = earlier(p, q, self.vehicle.nu, ago)
        mount = self.modem.mount
        dx, dy, dz = rotate(q, mount.p)
        return (p[0] + dx, p[1] + dy, p[2] + dz), multiply(q, mount.q)

    def velocity(self) -> Vec3:
        """v_NS, m/s."""
        vehicle, (rx, ry, rz) = self.vehicle, self.modem.mount.p
        vx, vy, vz, wx, wy, wz = vehicle.nu
        return rotate(vehicle.q_NB, (vx + wy * rz - wz * ry, vy + wz * rx - wx * rz, vz + wx * ry - wy * rx))


def nodes_of(sensors: Mapping[str, SensorSlot], vehicles: Mapping[str, Vehicle]) -> dict[str, Node]:
    """All modems of a world, by path."""
    found = {}
    for path, slot in sensors.items():
        if isinstance(slot.sensor, Modem):
            found[path] = Node(path, slot, slot.sensor, vehicles[path.partition("/")[0]])
    return found
