"""The conformance suite for actuators: commands depend on, and change, only the rows that they may write and the memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from msgspec import msgpack

from uwserver.actuators import Actuator, ActuatorTable, Body, Given
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.scenario.vehicle.component_checks import check_memory
from uwserver.testing.sensors import check_fields

_ROWS = ("state", "bodies", "thrusters", "wrenches", "servos")


def plain_body() -> Body:
    """Return a body of 10 kg and 1 kg m2 without thrusters and fins."""
    inertia, none = np.diag([10.0, 10.0, 10.0, 1.0, 1.0, 1.0]), np.zeros((6, 6))
    params = BodyParams(
        M_RB=inertia, M_A=none, D_L=none, D_Q=none, D_S=none, weight=98.1, buoyancy=98.1, r_g=(0.0, 0.0, 0.0), r_b=(0.0, 0.0, 0.0)
    )  # fmt: skip
    return Body(Hydrodynamics((params,), 0.01), 0, {}, 0)


def check_actuator(config: ActuatorTable, commands: Sequence[Given], *, body: Callable[[], Body] = plain_body) -> None:
    """Build an actuator from its configuration, and check its contract.

    Args:
        config: a configuration with `build(body)`.
        commands: at least two checked commands that show what the actuator does, with values in the order of its fields.
        body: makes a body, the same one each time, with the rows that the actuator may write.

    Raises:
        AssertionError: the text names the actuator and says what the contract requires.
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
    _carry_out(actuator, commands[:half], on)
    memory = msgpack.encode(getattr(actuator, "memory", None))
    rows = {name: getattr(on.hydro, name).copy() for name in _ROWS}
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
    at_rest = _bits(on)
    actuator.neutral()
    assert _bits(on) == at_rest, f"{kind}: neutral is not the same the second time"


def _carry_out(actuator: Actuator, commands: Sequence[Given], on: Body) -> list[tuple[bytes, ...]]:
    """Apply commands, and return the rows of the body after each of them."""
    done = []
    for command in commands:
        actuator.apply(command)
        done.append(_bits(on))
    return done


def _bits(body: Body) -> tuple[bytes, ...]:
    return tuple(getattr(body.hydro, name).tobytes() for name in _ROWS)
