"""A scenario names the kernels that its worlds need, and no others."""

from __future__ import annotations

import pytest

from uwserver.scenario.build.kernels import kernels_of
from uwserver.scenario.load.scenario import load

ALL = ("sensors", "autopilots")
"""What any vehicle of these needs."""


@pytest.mark.parametrize(
    ("scenario", "sea", "needs"),
    [
        ("bluerov2_pool", False, {"fins", *ALL}),
        ("bluerov2_pool", True, {"fins", "sea", *ALL}),
        (
            "one_of_everything", True,
            {"fins", "sea", "solids", "contact", "fins in contact", "echoes", "pictures", "soundings", "sound", *ALL},
        ),
        ("push_the_crate", False, {"fins", "solids", "contact", "fins in contact", *ALL}),
    ],
)  # fmt: skip
def test_what_shipped_scenarios_need(scenario: str, sea: bool, needs: set[str]) -> None:
    from uwserver.adapter import installed_adapters

    assert kernels_of(load(scenario, adapters=installed_adapters()), sea) == needs
