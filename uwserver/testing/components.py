"""Conformance suites for modifiers, actuators and currents."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from msgspec import msgpack

from uwserver.actuators import Actuator, ActuatorTable, Body, Given
from uwserver.environment.currents import CurrentTable, Drift, ProfileConfig, UniformConfig, flow_of
from uwserver.modifiers import Measurement, Modifier, ModifierTable, Stream
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.ports import Field, Value
from uwserver.scenario.vehicle.component_checks import check_memory
from uwserver.sensors.base import blank
from uwserver.testing.sensors import check_fields, check_values, kept

# -- modifiers --------------------------------------------------------------------------------------------------------------------------

FIELDS = (Field("s", "m", "a scalar"), Field("x", "m", "a vector", "S", (3,)), Field("ok", "1", "a flag", type="bool"))
VALUES: tuple[Value, ...] = (7.0, (0.1, -0.2, 0.3), True)
_DT_NS = 10_000_000
_RUN = 50

_Outcome = tuple[tuple[Value, ...], bool, int, bool, int]
_ROWS = ("state", "bodies", "thrusters", "wrenches", "servos")
_RATE_HZ = 100.0
_DRAWS = 20


def check_modifier(
    config: ModifierTable, *, fields: Sequence[Field] = FIELDS, values: Sequence[Value] = VALUES
) -> None:
    """Build a modifier from its configuration, and check its contract.

    Args:
        config: a configuration with `build(stream)`.
        fields: fields of the stream; default: a scalar `s`, a vector `x` and a flag `ok`.
        values: a valid reading of these fields.

    Raises:
        AssertionError: the text names the modifier and says what the contract requires.
    """
    kind = f'modifier "{config.__struct_config__.tag}"'
    assert callable(getattr(config, "build", None)), f"{kind}: the config needs build(stream), which makes the modifier"

    def built(seed: int = 1) -> Modifier:
        # The base class has no build(), which was checked above.
        modifier: Modifier = config.build(Stream(tuple(fields), _DT_NS * 1e-9, seed))  # type: ignore[attr-defined]
        return modifier

    modifier = built()
    first = _modified(modifier, values)
    for read, valid, delay_ns, dropped, stamp_ns in first:
        check_values(kind, fields, read, valid)
        whole = type(valid) is bool and type(dropped) is bool and type(delay_ns) is int and type(stamp_ns) is int
        assert whole, f"{kind}: valid and dropped are bools, delay_ns and stamp_ns whole numbers"
        assert delay_ns >= 0, f"{kind}: it delivers before it has measured"
    assert _modified(built(), values) == first, f"{kind}: with the same random numbers it does something else"
    memory = kept(kind, modifier)
    later = _modified(modifier, values, _RUN)
    other = built()
    other.memory = memory
    assert _modified(other, values, _RUN) == later, (
        f"{kind}: with the memory of another run it does not go on as that: all that it remembers belongs in memory"
    )
    empty, gap = blank(tuple(fields)), built()
    for read, *_ in _modified(gap, empty):
        assert list(read) == empty, f"{kind}: values that were missing are there: {read!r}"
    assert _modified(gap, values, _RUN) == later, (
        f"{kind}: missing values shift what comes after them: draw whether there is a value or not"
    )


def _modified(modifier: Modifier, values: Sequence[Value], start: int = 0) -> list[_Outcome]:
    outcome = []
    for k in range(start, start + _RUN):
        reading = Measurement(list(values), True, t_ns=(k + 1) * _DT_NS, number=k)
        modifier.stream.draws.seek(k)
        modifier.apply(reading)
        outcome.append((tuple(reading.values), reading.valid, reading.delay_ns, reading.dropped, reading.stamp_ns))
    return outcome


# -- actuators --------------------------------------------------------------------------------------------------------------------------


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


# -- currents ---------------------------------------------------------------------------------------------------------------------------


def check_current(config: CurrentTable) -> None:
    """Build a current from its configuration, and check its contract.

    Raises:
        AssertionError: the text names the current and says what the contract requires.
    """
    kind = f'current "{config.__struct_config__.tag}"'
    try:
        flow = flow_of(config)
    except ValueError as error:
        raise AssertionError(f"{kind}: {error}") from None
    if isinstance(flow, UniformConfig | ProfileConfig):
        assert flow_of(config) == flow, f"{kind}: build() gives something else the second time"
        return

    def built(seed: int) -> Drift:
        again = flow_of(config)
        assert not isinstance(again, UniformConfig | ProfileConfig), f"{kind}: build() gives something else each time"
        return Drift(again, _RATE_HZ, np.random.default_rng(seed))

    first, other = built(1), built(2)
    ends = _moved(first, 0)
    assert np.isfinite(ends).all(), f"{kind}: a velocity is not finite: {ends[~np.isfinite(ends)]}"
    assert (_moved(built(1), 0) == ends).all(), f"{kind}: with the same random numbers it does something else"
    other.ends[...], other.rng.bit_generator.state = first.ends, first.rng.bit_generator.state
    assert (_moved(other, _DRAWS) == _moved(first, _DRAWS)).all(), (
        f"{kind}: from the last velocity and random stream of another run it does not go on as that"
    )


def _moved(drift: Drift, start: int) -> np.ndarray:
    """Return the velocities (_DRAWS, 3) from a draw on, m/s."""
    ends = []
    for k in range(start, start + _DRAWS):
        drift.move((k + 1) * drift.ticks)
        ends.append(drift.ends[1].copy())
    return np.array(ends)
