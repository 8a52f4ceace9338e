"""A scenario names the kernels that its worlds need, and no others."""

from __future__ import annotations

import pytest

from uwserver.scenario.build.kernels import kernels_of
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.load.scenario import load

ALL = ("sensors", "autopilots")
"""What any vehicle of these needs."""


@pytest.mark.parametrize(
    ("scenario", "sea", "needs"),
    [
        ("bluerov2_pool", False, {"fins", *ALL}),
        ("bluerov2_pool", True, {"fins", "sea", *ALL}),
        (
            "one_of_everything",
            True,
            {
                "fins",
                "sea",
                "solids",
                "contact",
                "fins in contact",
                "echoes",
                "pictures",
                "soundings",
                "sonars",
                "sound",
                "cameras",
                *ALL,
            },
        ),
        ("push_the_crate", False, {"fins", "solids", "contact", "fins in contact", *ALL}),
    ],
)
def test_what_shipped_scenarios_need(scenario: str, sea: bool, needs: set[str]) -> None:
    from uwserver.adapter import installed_adapters

    assert kernels_of(load(scenario, adapters=installed_adapters()), sea) == needs


@pytest.mark.parametrize("kind", ["adcp", "altimeter", "dvl", "range_array"])
def test_each_kind_that_casts_rays_in_compiled_code_needs_those_of_soundings(kind: str) -> None:
    """Else its loops would be compiled where the world waits for them."""
    scenario = ScenarioBuilder("rays").vehicle("rov", "bluerov2_heavy").sensor("rov", "own", kind, rate_hz=1).build()
    assert kernels_of(load(scenario, adapters={}), False) == {"fins", "soundings", *ALL}
