"""Checks actuators with a wrench of their own, as those of extensions. Each is built once on a trial body: a user's code may fail in any way."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct, msgpack

from uwserver.physics.bodies import Hydrodynamics
from uwserver.scenario.files.convert import Report
from uwserver.scenario.files.wording import not_built
from uwserver.scenario.vehicle.body import body_params, own_actuators, own_rows
from uwserver.scenario.vehicle.sensor_checks import check_fields
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.scenario.water.tables import Environment


def check_actuators(
    vehicle: VehicleFile, devices: Mapping[str, ThrusterDevice], environment: Environment, report: Report
) -> None:
    """Check that they can be built, go to neutral, and can be saved.

    Args:
        vehicle, devices, environment: without errors.
        report: called for errors.
    """
    own = own_actuators(vehicle)
    if not own:
        return
    bodies = own_rows(Hydrodynamics([body_params(vehicle, devices, environment)], 1.0), vehicle, 0)
    for name, config in own.items():
        try:
            actuator = config.build(bodies[name])
            check_fields(actuator.fields, config.message)
            check_memory(getattr(actuator, "memory", None))
            actuator.neutral()
        except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
            report(("actuators", name), not_built(config, error))


def check_memory(memory: object) -> None:
    """Raise ValueError unless the memory is None, or a Struct that can be encoded and decoded again."""
    if memory is None:
        return
    if not isinstance(memory, Struct) or msgpack.decode(msgpack.encode(memory), type=type(memory)) != memory:
        raise ValueError(f"its memory must be a msgspec Struct of plain typed values, not {memory!r}")
