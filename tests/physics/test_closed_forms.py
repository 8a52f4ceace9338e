"""Motions with a known answer: 0.1 % is the bar, most are exact."""

from __future__ import annotations

import pytest
from uwserver_bench.proofs import closed_forms as forms
from uwserver_bench.proofs.motion import record

from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.layout import SHAPE_BOX, Q

PUBLISHED = {
    "surge at 10 N": 0.2221, "surge at 40 N": 0.4863, "sway at 10 N": 0.2147, "sway at 40 N": 0.4293, "heave at 10 N": 0.1585,
    "heave at 40 N": 0.3801, "yaw at 10 N m": 2.582, "free sinking": 0.0259, "roll, undamped": 1.7119, "pitch, undamped": 1.8987,
}  # fmt: skip


@pytest.fixture(scope="module")
def results() -> dict[str, forms.ClosedForm]:
    return {form.name: form for form in forms.closed_forms()}


def test_all_are_within_a_thousandth(results: dict[str, forms.ClosedForm]) -> None:
    assert len(results) == 14
    assert {name: form.error for name, form in results.items() if form.error > 1e-3} == {}


@pytest.mark.parametrize(("name", "value"), PUBLISHED.items())
def test_published_values(results: dict[str, forms.ClosedForm], name: str, value: float) -> None:
    digits = len(f"{value}".split(".")[1])
    assert round(results[name].measured, digits) == value


def test_a_disturbed_box_rights_itself() -> None:
    box = forms.floating(SHAPE_BOX, (0.5, 0.4, 0.15), 150.0, 0.24, 0.02)
    hydro = Hydrodynamics([box], 0.01)
    hydro.state[0, Q : Q + 4] = quat_from_rpy(0.3, -0.2, 0.0)
    assert forms.tilt(hydro.state[0]) > 0.3
    record(hydro, 60.0)
    assert forms.tilt(hydro.state[0]) < 1e-4
