"""The conformance suite for actuators: what commands make of the rows they may write, and of the memory, and of nothing else."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from msgspec import msgpack

from uwserver.actuators import Actuator, ActuatorTable, Body, Given
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.scenario.vehicle.actuator_checks import check_memory
from uwserver.testing.sensors import check_fields

_ROWS = ("state", "bodies", "thrusters", "wrenches", "servos")


def plain_body() -> Body:
    """A body of 10 kg, 1 kg m2, without thrusters and fins."""
    inertia, none = np.diag([10.0, 10.0, 10.0, 1.0, 1.0, 1.0]), np.zeros((6, 6))
    params = BodyParams(
        M_RB=inertia, M_A=none, D_L=none, D_Q=none, D_S=none, weight=98.1, buoyancy=98.1, r_g=(0.0, 0.0, 0.0), r_b=(0.0, 0.0, 0.0)
    )  # fmt: skip
    return Body(Hydrodynamics((params,), 0.01), 0, {}, 0)


def check_actuator(config: ActuatorTable, commands: Sequence[Given], *, body: Callable[[], Body] = plain_body) -> None:
    """Build the actuator of a config and check its contract.

    Args:
        config: with a `build(body)`.
        commands: checked commands, in the order of its fields, that show what it does; at least two.
        body: makes the rows that it may write, the same each time.

    Raises:
        AssertionError: the text names the actuator and says what the contract wants.
    """
    kind = f'actuator "{config.__struct_config__.tag}"'
    build = getattr(config, "build", None)
    assert build is not None, f"{kind}: the config needs build(body), which makes the actuator"

    def built() -> tuple[Actuator, Body]:
        on = body()
        return build(on), on

    actuator, on = built()
    check_fields(kind, actuator.fields)
    assert actuator.doc, f"{kind}: doc is empty"
    try:
        check_memory(getattr(actuator, "memory", None))
    except ValueError as error:
        raise AssertionError(f"{kind}: {error}") from None
    half = len(commands) // 2
    _carry_out(actuator, commands[:half])
    memory, rows = msgpack.encode(getattr(actuator, "memory", None)), _rows(on)
    done = _carry_out(actuator, commands[half:], on)
    again, other = built()
    assert _carry_out(again, commands, other)[half:] == done, f"{kind}: the same commands do something else"
    fresh, restored = built()
    for name, array in rows.items():
        getattr(restored.hydro, name)[...] = array
    if hasattr(fresh, "memory"):
        fresh.memory = msgpack.decode(memory, type=type(fresh.memory))
    assert _carry_out(fresh, commands[half:], restored) == done, (
        f"{kind}: with the rows and the memory of another run it does not go on as that: all that it remembers belongs in memory"
    )
    actuator.neutral()
    at_rest = _rows(on)
    actuator.neutral()
    assert _bits(_rows(on)) == _bits(at_rest), f"{kind}: neutral is not the same the second time"


def _carry_out(actuator: Actuator, commands: Sequence[Given], on: Body | None = None) -> list[tuple[bytes, ...]]:
    done = []
    for command in commands:
        actuator.apply(command)
        if on is not None:
            done.append(_bits(_rows(on)))
    return done


def _rows(body: Body) -> dict[str, Any]:
    return {name: copy.deepcopy(getattr(body.hydro, name)) for name in _ROWS}


def _bits(rows: dict[str, Any]) -> tuple[bytes, ...]:
    return tuple(array.tobytes() for array in rows.values())
