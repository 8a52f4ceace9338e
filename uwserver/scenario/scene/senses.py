"""Sensors of a vehicle as a viewer gets them: where they sit, and what they send out; and the beacons that they ask."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import UNSET

from uwserver.ports import BeaconView, SensorView
from uwserver.scenario.build.members import mount_of
from uwserver.scenario.scene.errors import sigmas
from uwserver.scenario.vehicle.tables import VehicleFile


def sensor_views(name: str, file: VehicleFile) -> tuple[SensorView, ...]:
    """All sensors of a vehicle under this name."""
    views = []
    for key, config in file.sensors.items():
        traits, mount = config.traits(), mount_of(config, file)
        path, kind = config.port_of(name, key), str(config.__struct_config__.tag)
        exact, message = sigmas(config) or UNSET, config.message or UNSET
        views.append(SensorView(path, kind, mount.p, mount.q, traits.beams, traits.fan, exact, traits.address, message))
    return tuple(views)


def beacon_views(name: str, file: VehicleFile) -> Iterator[BeaconView]:
    """Beacons that sensors of a vehicle under this name ask, where they are thought to be at t = 0."""
    for key, config in file.sensors.items():
        for beacon in config.traits().beacons:
            yield BeaconView(beacon.name, f"{name}/{key}", beacon.p, beacon.body, delay=beacon.delay)
