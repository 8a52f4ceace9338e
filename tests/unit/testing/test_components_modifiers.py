"""The modifier suite passes all shipped modifiers and sees the faults it is there for."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest

from uwserver.modifiers import Measurement, Memory, Modifier, ModifierConfig, ModifierTable, Stream
from uwserver.testing import check_modifier

KEYS: dict[str, dict[str, Any]] = {
    "gauss_markov": {"sigma": 1.0, "tau_s": 0.1},
    "random_walk": {"density": 1.0},
    "outlier": {"probability": 0.5, "sigma": 1.0},
    "quantise": {"step": 0.25},
    "saturate": {"maximum": 0.2},
    "delay": {"latency_s": 0.01, "jitter_s": 0.02},
    "dropout": {"probability": 0.5},
    "reorder": {"probability": 0.5},
    "misalignment": {"fields": ("x",), "sigma_deg": 1.0},
}


@pytest.mark.parametrize("kind", get_args(ModifierConfig), ids=lambda kind: str(kind.__struct_config__.tag))
def test_shipped_modifiers(kind: type[Any]) -> None:
    target = {"field": "x"} if "field" in kind.__struct_fields__ else {}
    check_modifier(kind(**target, **KEYS.get(kind.__struct_config__.tag, {})))


class Walk(Memory):
    error: float = 0.0


class Odd(Modifier):
    """A right modifier of `x`, which the tests spoil."""

    def __init__(self, fault: str, stream: Stream) -> None:
        super().__init__(stream)
        self.fault, self.memory, self.calls = fault, Walk(), 0

    def apply(self, reading: Measurement) -> None:
        value = reading.values[1]
        present = isinstance(value, tuple) and None not in value
        error = float(self.stream.rng.normal()) if present or self.fault != "shifts" else 0.0
        self.memory.error += error
        self.calls += 1
        if self.fault == "hides":
            error += self.calls
        elif self.fault == "early":
            reading.delay_ns -= 1
        elif self.fault == "numpy":
            self.memory.error = np.float64(self.memory.error)
        elif self.fault == "fills":
            reading.values[1], present = (0.0,) * 3, False
        elif self.fault == "shape":
            reading.values[1], present = (0.0,) * 2, False
        if present:
            reading.values[1] = tuple(v + error + self.memory.error for v in value)  # type: ignore[operator, union-attr, misc]


class OddConfig(ModifierTable, tag="odd", kw_only=True, frozen=True):
    fault: str = ""

    def build(self, stream: Stream) -> Odd:
        return Odd(self.fault, stream)


def test_right() -> None:
    check_modifier(OddConfig())


@pytest.mark.parametrize(
    ("fault", "phrase"),
    [
        ("hides", "belongs in memory"), ("early", "before it has measured"), ("numpy", "more than plain values"),
        ("fills", "were missing are there"), ("shape", "2 components"), ("shifts", "missing values shift"),
    ],
)  # fmt: skip
def test_faults_are_seen(fault: str, phrase: str) -> None:
    with pytest.raises(AssertionError, match=phrase):
        check_modifier(OddConfig(fault=fault))


def test_a_config_that_builds_nothing_is_seen() -> None:
    with pytest.raises(AssertionError, match=r"build\(stream\)"):
        check_modifier(ModifierTable())
