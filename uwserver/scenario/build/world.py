"""Builds a World from a resolved scenario. Only this module and `members` bring the concrete classes together."""

from __future__ import annotations

from functools import cache, partial

from uwserver.environment.acoustics.boundaries import lambert, sediments
from uwserver.environment.earth import NO_FIELD, Earth
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.appendage_params import Appendages
from uwserver.ports.checks import checked_seed
from uwserver.scenario.build.members import build_scene, physics_rate, stream_of
from uwserver.scenario.build.modems import add_medium
from uwserver.scenario.build.population import ScenarioPopulation
from uwserver.scenario.load.export import identity
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.solids.tables import FlatSeabed
from uwserver.scenario.vehicle.body import params_by_name
from uwserver.scenario.world.earth import instant, magnetic_about, nanoseconds, year_of
from uwserver.scenario.world.sea import water_of
from uwserver.units import rad
from uwserver.world.builds import prepare, progress
from uwserver.world.faults import Faults, effects
from uwserver.world.state.held_start import HeldStart
from uwserver.world.state.saving import offer_state_services
from uwserver.world.state.services import offer_world_services
from uwserver.world.world import World


def build(resolved: Resolved, seed: int | None = None, like: World | None = None) -> World:
    """Return a world at t = 0. Missing kernels are compiled first, with a message on standard error.

    Args:
        resolved: a loaded and checked scenario.
        seed: replaces the seed of the scenario; a whole number, 0 or more.
        like: another world of this scenario, stepped in the same thread. Nothing has to be compiled then, and the worlds share read-only data.

    Raises:
        Refused: the seed is something else.
    """
    scenario = resolved.scenario
    rate = physics_rate(scenario.world.rate_hz)
    hydro = Hydrodynamics((), float(1 / rate))
    seed = scenario.seed if seed is None else checked_seed(seed)
    water = water_of(scenario.environment, float(rate), partial(stream_of, seed))
    hydro.sea = None if water.sea is None else water.sea.rows
    if isinstance(scenario.seabed, FlatSeabed):
        hydro.floor = scenario.seabed.depth_m
    if like is None:
        prepare(kernels_of(resolved, hydro.sea is not None), progress())
    world = World(resolved.name, rate, seed, scenario.world.epoch_utc, hydro, water)
    world.threads.use(scenario.world.threads)
    world.earth = _earth(resolved)
    world.lambert, world.sediments = lambert(resolved.materials), sediments(resolved.materials)
    if resolved.is_solid:
        build_scene(world, resolved, None if like is None or like.scene is None else like.scene.stocks)
    faults = Faults(world)
    world.add(faults)
    add_medium(world, resolved)
    world.population = ScenarioPopulation(world, resolved)
    world.add(world.population)
    world.identity = cache(partial(identity, resolved))
    world.population.begin()
    hydro.load_kernels()
    world.set_current(water.current)
    for name, fault in scenario.faults.items():
        for part, effect in effects(name, fault, faults.targets(), stream_of(seed, f"faults/{name}")).items():
            faults.set(part, effect)
    if any(config.traits().needs_sight for config in resolved.sensors):
        from uwserver.scenario.build.sight import give_sight  # loads all that pictures need

        give_sight(world, resolved)
    if scenario.start == "held":
        world.add(HeldStart(world))
    offer_world_services(world)
    offer_state_services(world)
    return world


def _earth(resolved: Resolved) -> Earth:
    """Return where N lies on the Earth. The magnetic field takes a moment, and is computed only if a sensor needs it."""
    table = resolved.scenario.world
    epoch = instant(table.epoch_utc)
    if table.origin is None:
        return Earth(epoch_ns=nanoseconds(epoch))
    latitude, longitude = map(rad, table.origin)
    needs_field = any(config.traits().needs_field for config in resolved.sensors)
    field = magnetic_about(latitude, longitude, year_of(epoch)) if needs_field else NO_FIELD
    return Earth(latitude, longitude, nanoseconds(epoch), field, table.rotating)


def kernels_of(resolved: Resolved, sea: bool) -> frozenset[str]:
    """Return the stages of `world.builds` whose kernels the worlds of a scenario need.

    Args:
        resolved: the scenario.
        sea: its water has more than a uniform, steady current.
    """
    vehicles, environment = resolved.vehicles.values(), resolved.scenario.environment
    simulated = {each.name: (each.vehicle, each.devices) for each in vehicles if not each.entry.is_external}
    params = list(params_by_name(simulated, environment).values())
    params += [body.params for body in resolved.objects.values()]
    fins = any(body.appendages != Appendages() for body in params)
    needs = {"fins" if fins else "free"}
    if resolved.is_solid:
        needs |= {"solids", "contact"} | ({"fins in contact"} if fins else set())
    if sea:
        needs.add("sea")
    for config in resolved.sensors:
        needs.update(config.traits().stages)
    if vehicles:
        needs.add("sensors")
    if any(vehicle.entry.autopilot is not None for vehicle in vehicles):
        needs.add("autopilots")
    return frozenset(needs)
