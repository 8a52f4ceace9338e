"""Which compiled kernels a scenario needs."""

from __future__ import annotations

from uwserver.physics.dynamics.appendage_params import Appendages
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.vehicle.body import params_by_name


def kernels_of(resolved: Resolved, sea: bool) -> frozenset[str]:
    """Stages of `world.builds` that the worlds of a scenario need.

    Args:
        resolved: the scenario.
        sea: whether its water is more than a uniform, steady current.
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
