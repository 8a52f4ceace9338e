"""Checks the faults of a scenario against its vehicles."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from uwserver.scenario.files.convert import Node, Report
from uwserver.scenario.files.errors import KeyPath
from uwserver.scenario.files.wording import not_built
from uwserver.scenario.vehicle.body import matrices
from uwserver.scenario.vehicle.copies import starts
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.scenario.water.tables import Environment
from uwserver.sensors.truth import TRUTH
from uwserver.world.faults import FaultConfig, Hull, Targets, effects, refusals
from uwserver.world.faults.timeline import MAX_FAULTS


def check_faults(scenario: Node, vehicles: Mapping[str, VehicleFile], environment: Environment, report: Report) -> None:
    """Check targets, members and sizes of all faults, once all vehicles could be read; `vehicles` by table."""
    targets = _targets(scenario, vehicles, environment)
    before: list[FaultConfig] = []
    for name, fault in scenario.values("faults").items():
        path: KeyPath = ("faults", name)
        try:
            parts = effects(name, fault, targets, np.random.default_rng(0))
        except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
            report(path, not_built(fault, error))
            continue
        for part in parts.values():
            for key, text in refusals(part, targets, before):
                if part is fault:
                    report((*path, key), text)
                else:
                    report(path, f'it results in a "{part.__struct_config__.tag}" fault with an error: {key}: {text}')
            before.append(part)
        if len(before) > MAX_FAULTS:
            report(path, f"a world can have at most {MAX_FAULTS} faults, and this is one too many: remove some")
            return


def _targets(scenario: Node, vehicles: Mapping[str, VehicleFile], environment: Environment) -> Targets:
    thrusters: dict[str, tuple[str, ...]] = {}
    sensors: list[str] = []
    hulls: dict[str, Hull] = {}
    water = environment.density * environment.gravity
    for table, name, _ in starts(scenario, "vehicles"):
        vehicle = vehicles[table]
        for key, actuator in vehicle.actuators.items():
            devices = actuator.devices()
            if devices is not None and devices.table == "thrusters":
                thrusters[f"{name}/{key}"] = devices.members or tuple(vehicle.thrusters)
        sensors += [config.port_of(name, key) for key, config in vehicle.sensors.items()]
        if "truth" in scenario.at("vehicles", table).parts:
            sensors += [f"{name}/truth/{key}" for key in TRUTH]
        M_RB, r_g = matrices(vehicle).M_RB, vehicle.rigid_body.center_of_mass_frd_m
        hulls[name] = Hull(M_RB, r_g, vehicle.buoyancy.volume_m3, water)
    return Targets(hulls, thrusters, tuple(sensors))
