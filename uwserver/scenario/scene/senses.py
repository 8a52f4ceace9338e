"""Sensors of a vehicle as a viewer gets them: where they sit, and what they send out; and the beacons that they ask."""

from __future__ import annotations

import math
from collections.abc import Iterator

from msgspec import UNSET, UnsetType

from uwserver.ports import BeaconView, BeamView, FanView, SensorView
from uwserver.scenario.build.members import mount_of
from uwserver.scenario.scene.errors import sigmas
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.sensors import (
    AdcpConfig,
    AltimeterConfig,
    BathymetryConfig,
    DvlConfig,
    LblConfig,
    ModemTable,
    MultibeamConfig,
    ProfilerConfig,
    RangeArrayConfig,
    ScanningSonarConfig,
    SensorConfig,
    SideScanConfig,
    UsblConfig,
)
from uwserver.units import rad

_SHOWN = 15
"""Beams of a swath that a viewer draws."""


def sensor_views(name: str, file: VehicleFile) -> tuple[SensorView, ...]:
    """All sensors of a vehicle under this name."""
    views = []
    for key, config in file.sensors.items():
        mount = mount_of(config, file)
        kind = str(config.__struct_config__.tag)
        exact = sigmas(config) or UNSET
        address = config.address if isinstance(config, ModemTable) and config.addressed else UNSET
        path = config.port_of(name, key)
        views.append(SensorView(path, kind, mount.p, mount.q, tuple(beams(config)), fan(config), exact, address))
    return tuple(views)


def beams(config: SensorConfig) -> Iterator[BeamView]:
    """What a sensor sends out in single beams."""
    if isinstance(config, AltimeterConfig):
        yield BeamView((0.0, 0.0, 1.0), rad(config.beam_width_deg), config.min_range_m, config.max_range_m)
    elif isinstance(config, DvlConfig):
        tilt = rad(config.beam_angle_deg)
        far = config.max_altitude_m / math.cos(tilt)
        for azimuth in config.beam_azimuth_deg:
            across = math.sin(tilt)
            direction = (across * math.cos(rad(azimuth)), across * math.sin(rad(azimuth)), math.cos(tilt))
            yield BeamView(direction, 0.0, config.min_altitude_m, far)
    elif isinstance(config, AdcpConfig):
        tilt = rad(config.beam_angle_deg)
        across, far = math.sin(tilt), config.max_range_m
        for azimuth in config.beam_azimuth_deg:
            direction = (across * math.cos(rad(azimuth)), across * math.sin(rad(azimuth)), math.cos(tilt))
            yield BeamView(direction, 0.0, config.blanking_m / math.cos(tilt), far / math.cos(tilt))
        if config.axial_beam:
            yield BeamView((0.0, 0.0, 1.0), 0.0, config.blanking_m, far)
    elif isinstance(config, SideScanConfig):
        tilt, width = rad(config.tilt_deg), rad(config.beam_width_horizontal_deg)
        for side in (-1.0, 1.0):
            direction = (0.0, side * math.cos(tilt), math.sin(tilt))
            yield BeamView(direction, width, config.min_range_m, config.range_m)
    elif isinstance(config, BathymetryConfig):
        half = 0.5 * rad(config.field_deg)
        for k in range(_SHOWN):
            angle = half * (2.0 * k / (_SHOWN - 1) - 1.0)
            direction = (0.0, math.sin(angle), math.cos(angle))
            yield BeamView(direction, rad(config.beam_width_across_deg), config.min_range_m, config.range_m)
    elif isinstance(config, RangeArrayConfig):
        width = rad(config.field_of_view_deg)
        for k in range(config.beams):
            angle = -0.5 * width + (width * k / (config.beams - 1) if config.beams > 1 else 0.5 * width)
            yield BeamView((math.cos(angle), math.sin(angle), 0.0), 0.0, config.min_range_m, config.max_range_m)


def fan(config: SensorConfig) -> FanView | None:
    """The sector of an imaging sonar."""
    if isinstance(config, MultibeamConfig):
        half = 0.5 * rad(config.field_deg)
        return FanView(
            rad(config.beam_width_horizontal_deg), rad(config.beam_width_vertical_deg), 0.0, (-half, half), config.bins,
            config.min_range_m, config.range_m,
        )  # fmt: skip
    if isinstance(config, ProfilerConfig):
        centre, half = rad(config.sector_center_deg), 0.5 * rad(config.sector_width_deg)
        width, step = rad(config.beam_width_deg), rad(config.step_deg)
        return FanView(width, width, step, (centre - half, centre + half), 1, config.min_range_m, config.range_m)
    if not isinstance(config, ScanningSonarConfig):
        return None
    centre = rad(config.sector_center_deg)
    half = math.pi if isinstance(config.sector_width_deg, UnsetType) else 0.5 * rad(config.sector_width_deg)
    return FanView(
        rad(config.beam_width_horizontal_deg), rad(config.beam_width_vertical_deg), rad(config.step_deg),
        (centre - half, centre + half), config.bins, config.min_range_m, config.range_m,
    )  # fmt: skip


def beacon_views(name: str, file: VehicleFile) -> Iterator[BeaconView]:
    """Beacons that sensors of a vehicle under this name ask, where they are thought to be at t = 0."""
    for key, config in file.sensors.items():
        if not isinstance(config, UsblConfig | LblConfig):
            continue
        for beacon, table in config.beacons.items():
            path = f"{name}/{key}"
            if isinstance(table.position_ned_m, UnsetType):
                assert isinstance(table.vehicle, str)
                yield BeaconView(beacon, path, table.position_frd_m, table.vehicle, delay=table.turn_around_s)
            else:
                yield BeaconView(beacon, path, table.position_ned_m, delay=table.turn_around_s)
