"""The conformance suite for modifiers: changes of a stream can be repeated and saved, and fit the declared fields."""

from __future__ import annotations

from collections.abc import Sequence

from uwserver.modifiers import Measurement, Modifier, ModifierTable, Stream
from uwserver.ports import Field, Value
from uwserver.sensors.base import blank
from uwserver.testing.sensors import check_values, kept

FIELDS = (Field("s", "m", "a scalar"), Field("x", "m", "a vector", "S", (3,)), Field("ok", "1", "a flag", type="bool"))
VALUES: tuple[Value, ...] = (7.0, (0.1, -0.2, 0.3), True)
_DT_NS = 10_000_000
_RUN = 50

_Outcome = tuple[tuple[Value, ...], bool, int, bool, int]


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
    first = _run(modifier, values)
    for read, valid, delay_ns, dropped, stamp_ns in first:
        check_values(kind, fields, read, valid)
        whole = type(valid) is bool and type(dropped) is bool and type(delay_ns) is int and type(stamp_ns) is int
        assert whole, f"{kind}: valid and dropped are bools, delay_ns and stamp_ns whole numbers"
        assert delay_ns >= 0, f"{kind}: it delivers before it has measured"
    assert _run(built(), values) == first, f"{kind}: with the same random numbers it does something else"
    memory = kept(kind, modifier)
    later = _run(modifier, values, _RUN)
    other = built()
    other.memory = memory
    assert _run(other, values, _RUN) == later, (
        f"{kind}: with the memory of another run it does not go on as that: all that it remembers belongs in memory"
    )
    empty, gap = blank(tuple(fields)), built()
    for read, *_ in _run(gap, empty):
        assert list(read) == empty, f"{kind}: values that were missing are there: {read!r}"
    assert _run(gap, values, _RUN) == later, (
        f"{kind}: missing values shift what comes after them: draw whether there is a value or not"
    )


def _run(modifier: Modifier, values: Sequence[Value], start: int = 0) -> list[_Outcome]:
    outcome = []
    for k in range(start, start + _RUN):
        reading = Measurement(list(values), True, t_ns=(k + 1) * _DT_NS, number=k)
        modifier.stream.draws.seek(k)
        modifier.apply(reading)
        outcome.append((tuple(reading.values), reading.valid, reading.delay_ns, reading.dropped, reading.stamp_ns))
    return outcome
