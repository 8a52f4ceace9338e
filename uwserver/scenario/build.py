"""From a resolved scenario to a World: with `members` the only place that brings concrete classes together."""

from __future__ import annotations

from functools import partial

from uwserver.physics.hydrodynamics import Hydrodynamics
from uwserver.scenario.members import build_scene, physics_rate, stream_of
from uwserver.scenario.population import Population
from uwserver.scenario.resolved import Resolved
from uwserver.scenario.sea import water_of
from uwserver.services import offer_world_services
from uwserver.world import World


def build(resolved: Resolved, seed: int | None = None) -> World:
    """A world at t = 0.

    Args:
        resolved: a loaded and checked scenario.
        seed: instead of the scenario's.
    """
    scenario = resolved.scenario
    rate = physics_rate(scenario.world.rate_hz)
    hydro = Hydrodynamics((), float(1 / rate))
    seed = scenario.seed if seed is None else seed
    water = water_of(scenario.environment, float(rate), partial(stream_of, seed))
    hydro.sea = None if water.sea is None else water.sea.rows
    world = World(resolved.name, rate, seed, scenario.world.epoch_utc, hydro, water)
    if resolved.is_solid:
        build_scene(world, resolved)
    hydro.load_kernels()
    Population(world, resolved).begin()
    world.set_current(water.current)
    for name, fault in scenario.faults.items():
        world.faults.set(name, fault, world.tick)
    offer_world_services(world)
    return world
