"""Closed forms and measures: that each names what it measures, and that a wrong kernel would be found."""

from __future__ import annotations

import pytest
from uwserver_bench.proofs.closed_forms import ClosedForm, floating_equilibria, sphere_added_mass, table_a1
from uwserver_bench.proofs.contact_forms import DIAGONAL, HITS, hit, standing


def test_an_error_is_relative() -> None:
    assert ClosedForm("x", "m", 2.0, 2.1).error == pytest.approx(0.05)
    assert ClosedForm("x", "m", -2.0, -2.0).error == 0.0


@pytest.mark.parametrize("forms", [floating_equilibria, sphere_added_mass])
def test_the_kernel_meets_its_closed_forms(forms: object) -> None:
    found = forms()  # type: ignore[operator]
    assert len({form.name for form in found}) == len(found)
    for form in found:
        assert form.unit in ("m", "m/s", "m/s2", "rad/s", "N")
        assert form.error < 1e-3, form


def test_table_a1_is_neutral_unless_it_is_told_otherwise() -> None:
    assert table_a1().weight == table_a1().buoyancy
    assert table_a1(weight=140.0).weight == 140.0
    assert not table_a1(damped=False).D_Q.any()


@pytest.mark.parametrize("name", HITS)
def test_an_elastic_hit_keeps_the_energy_and_a_dead_one_does_not(name: str) -> None:
    nu, expected, impulse, closed = hit(name, 1.0)
    assert nu == pytest.approx(expected, abs=1e-6)
    assert impulse == pytest.approx(closed, rel=1e-6)
    assert hit(name, 0.0)[2] == pytest.approx(0.5 * closed, rel=1e-6)


def test_a_standing_vehicle_stands() -> None:
    hydro = standing(DIAGONAL, 0.01)
    for k in range(50):
        assert hydro.advance(k * 0.01) < 0
    assert len(hydro.touched.impulse) == 4
    assert abs(hydro.state[0, 7:]).max() < 1e-6
