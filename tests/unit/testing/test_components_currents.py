"""The conformance suite for currents passes those that keep the contract, and names what the others break."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pytest

from uwserver.environment.currents import CurrentTable, GaussMarkovConfig, UniformConfig
from uwserver.testing import check_current


class Steady:
    """Keeps the contract: wanders from its last velocity."""

    interval_s = 0.1

    def velocity(self, t: float, dt: float, last: Any, rng: np.random.Generator) -> Any:
        return rng.standard_normal(3) if last is None else 0.9 * last + 0.1 * rng.standard_normal(3)


class OddConfig(CurrentTable, tag="odd", kw_only=True, frozen=True):
    """Of the class that a test sets."""

    made: ClassVar[Any] = Steady

    def build(self) -> Any:
        return self.made()


def told(monkeypatch: pytest.MonkeyPatch, made: Any) -> str:
    monkeypatch.setattr(OddConfig, "made", made)
    with pytest.raises(AssertionError) as error:
        check_current(OddConfig())
    return str(error.value)


def test_good_currents_pass() -> None:
    check_current(OddConfig())
    check_current(GaussMarkovConfig(sigma_ned_mps=(0.1, 0.2, 0.0), tau_s=3.0))
    check_current(UniformConfig(velocity_ned_mps=(0.1, 0.2, 0.0)))


def test_memory_of_its_own_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    class Secret(Steady):
        def velocity(self, t: float, dt: float, last: Any, rng: np.random.Generator) -> Any:
            self.secret = getattr(self, "secret", 0.0) + float(rng.random())
            return (self.secret, 0.0, 0.0)

    text = told(monkeypatch, Secret)
    assert 'current "odd": from the last velocity and random stream of another run it does not go on as that' in text


def test_chance_from_elsewhere_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = np.random.default_rng(3)

    class Moody(Steady):
        def velocity(self, t: float, dt: float, last: Any, rng: np.random.Generator) -> Any:
            return elsewhere.standard_normal(3)

    assert "with the same random numbers it does something else" in told(monkeypatch, Moody)


def test_numbers_that_are_none_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    class Endless(Steady):
        def velocity(self, t: float, dt: float, last: Any, rng: np.random.Generator) -> Any:
            return (t, 0.0, np.inf)

    assert "a velocity is not finite: [inf" in told(monkeypatch, Endless)


def test_something_else_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "build() must return a UniformConfig, a ProfileConfig, or something with velocity()" in told(
        monkeypatch, staticmethod(lambda: 3)
    )


def test_a_steady_current_that_changes_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = iter(range(9))
    made = told(monkeypatch, staticmethod(lambda: UniformConfig(velocity_ned_mps=(float(next(drawn)), 0.0, 0.0))))
    assert "build() gives something else the second time" in made
