"""Makes the water of a scenario, with currents and waves as the arrays of a sea."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from msgspec import UnsetType

from uwserver.environment.column import WaterColumn
from uwserver.environment.currents import Drift, Drifting, ProfileConfig, UniformConfig, flow_of, profile_rows
from uwserver.environment.water import Sea, Water
from uwserver.environment.waves import wave_rows
from uwserver.physics.kernel.layout import PROFILE_SIZE, WAVE_SIZE, SeaRows
from uwserver.scenario.world.tables import Environment
from uwserver.units import rad

_TIDE_WAVE_NUMBER = 1e-12
"""Wave number (rad/m) of the tide. It is a wave without a period, so long that it is flat; so forces and sensors see the same level."""

Streams = Callable[[str], np.random.Generator]
"""Returns the random stream of a path."""


def water_of(environment: Environment, rate_hz: float, streams: Streams) -> Water:
    """Return the water of a scenario at t = 0, with a `Sea` if it has more than a uniform, steady current."""
    flows = {name: flow_of(current) for name, current in environment.currents.items()}
    steady = [environment.current.velocity_ned_mps]
    steady += [flow.velocity_ned_mps for flow in flows.values() if isinstance(flow, UniformConfig)]
    north, east, down = (sum(components) for components in zip(*steady, strict=True))
    density, gravity, column = environment.density, environment.gravity, environment.water
    return Water(
        density=density,
        gravity=gravity,
        temperature=environment.temperature_degc,
        atmospheric_pressure=environment.atmospheric_pressure_pa,
        current=(north, east, down),
        sea=_sea(environment, flows, rate_hz, streams),
        given=None if isinstance(column, UnsetType) else WaterColumn(column, gravity, density, environment.growth),
        growth=environment.growth,
        jerlov=environment.water_type,
    )


def _sea(
    environment: Environment,
    flows: Mapping[str, UniformConfig | ProfileConfig | Drifting],
    rate_hz: float,
    streams: Streams,
) -> Sea | None:
    profiles, waves, drifts = [np.zeros((0, PROFILE_SIZE))], np.zeros((0, WAVE_SIZE)), []
    for name, flow in flows.items():
        if isinstance(flow, ProfileConfig):
            profiles.append(profile_rows(flow))
        elif not isinstance(flow, UniformConfig):
            drifts.append(Drift(flow, rate_hz, streams(f"environment/currents/{name}")))
    if not isinstance(environment.waves, UnsetType):
        direction = rad(environment.waves.direction_deg)
        waves = wave_rows(environment.waves, direction, environment.gravity, streams("environment/waves"))
    if environment.surface_level_m:
        waves = np.concatenate(
            [waves, [(_TIDE_WAVE_NUMBER, 0.0, _TIDE_WAVE_NUMBER, 0.0, environment.surface_level_m, 0.0, np.inf)]]
        )
    rows = np.concatenate(profiles)
    if not (len(rows) or len(waves) or drifts):
        return None
    return Sea(SeaRows(np.zeros(7), rows, waves), drifts, 1.0 / rate_hz)
