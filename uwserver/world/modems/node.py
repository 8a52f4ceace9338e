"""A modem as the medium sees it: its sensor, its vehicle, and its pose now or shortly before."""

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
        path: of the port at which it reports what it hears.
        slot: of that port.
        modem: its sensor.
        vehicle: carries it.
    """

    path: str
    slot: SensorSlot
    modem: Modem
    vehicle: Vehicle

    def pose(self, ago: float = 0.0) -> tuple[Vec3, Quat]:
        """Return p_NS (m) and q_NS, now or `ago` seconds before."""
        p, q = self.vehicle.p_NB, self.vehicle.q_NB
        if ago:
            p, q = earlier(p, q, self.vehicle.nu, ago)
        mount = self.modem.mount
        dx, dy, dz = rotate(q, mount.p)
        return (p[0] + dx, p[1] + dy, p[2] + dz), multiply(q, mount.q)

    def velocity(self) -> Vec3:
        """Return v_NS, m/s."""
        vehicle, (rx, ry, rz) = self.vehicle, self.modem.mount.p
        vx, vy, vz, wx, wy, wz = vehicle.nu
        return rotate(vehicle.q_NB, (vx + wy * rz - wz * ry, vy + wz * rx - wx * rz, vz + wx * ry - wy * rx))


def nodes_of(sensors: Mapping[str, SensorSlot], vehicles: Mapping[str, Vehicle]) -> dict[str, Node]:
    """Return all modems of a world, by path."""
    return {
        path: Node(path, slot, slot.sensor, vehicles[path.partition("/")[0]])
        for path, slot in sensors.items()
        if isinstance(slot.sensor, Modem)
    }
