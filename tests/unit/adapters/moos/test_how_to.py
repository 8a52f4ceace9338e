"""The listings of docs/how-to/moos.md fit the shipped vehicles: ports, fields, sizes and units."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from uwserver_adapters.moos.bridge.bridge import Bridge
from uwserver_adapters.moos.config import BridgeTable, MoosConfig, MoosDbConfig

from uwserver.adapter import installed_adapters
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.testing import FakeContext

PAGE = (Path(__file__).parents[4] / "docs" / "how-to" / "moos.md").read_text()
LISTINGS = re.findall(r"^ *```(?:toml|text)\n(.*?)^ *```", PAGE, re.S | re.M)
CLIENT, DATABASE = (listing for listing in LISTINGS if listing.startswith("schema"))
(OWN_GAINS,) = (listing for listing in LISTINGS if "159.7" in listing)
(RESET,) = (listing for listing in LISTINGS if "teleport" in listing)
(AUTOPILOT,) = (listing for listing in LISTINGS if "yaw_pid_kp" in listing)
(BUOYANCY,) = re.findall(r"`(BUOYANCY_RATE = .*?)`", PAGE)
COMMANDS = re.compile(r"(?m)^DESIRED_.*\n")
LAUV = """
DESIRED_THRUST = [{ port = "propeller", field = "speed_radps", full = 395.0 }]
DESIRED_RUDDER = [{ port = "fins", field = "angle_rad", full_deg = [100, 0, 100, 0], limit = 20 }]
DESIRED_ELEVATOR = [{ port = "fins", field = "angle_rad", full_deg = [0, 100, 0, 100], limit = 20 }]
"""


def table(listing: str, folder: Path) -> tuple[BridgeTable, FakeContext]:
    """The bridge's table of a scenario, and a context with the ports of its world."""
    file = folder / "sim.toml"
    file.write_text(listing)
    resolved = load(file, adapters=installed_adapters())
    ports = build(resolved).ports
    config = resolved.scenario.adapters["moos"]
    if isinstance(config, MoosConfig):
        return config.communities["alpha"], FakeContext(ports=dict(ports))
    assert isinstance(config, MoosDbConfig)
    return config.bridge, FakeContext(ports=dict(ports))


@pytest.mark.parametrize(
    "listing",
    [
        CLIENT,
        DATABASE,
        DATABASE + RESET,
        CLIENT + AUTOPILOT,
        COMMANDS.sub("", CLIENT) + OWN_GAINS,
        COMMANDS.sub("", DATABASE).replace("remus100", "lauv") + LAUV,
        COMMANDS.sub("", DATABASE).replace("remus100", "tethys").replace("hold_depth_m = 0\n", "") + BUOYANCY,
    ],
    ids=["client", "database", "reset", "autopilot", "own gains", "lauv", "buoyancy"],
)
async def test_listings_fit_the_vehicles(listing, tmp_path):
    config, context = table(listing, tmp_path)
    posted: list[tuple[str, float | str]] = []
    bridge = Bridge(config, context, posted.extend, lambda names: None, "moos", lambda: 0.0)
    assert set(config.commands) <= set(bridge.listens_to)
    bridge.take([(name, 10.0, "pMarinePIDV22", 1.0) for name in config.commands])
    assert {command.port for command in context.commands} == {
        f"auv/{target.port}" for targets in config.commands.values() for target in targets
    }
    assert posted == []


def test_a_depth_is_held_in_the_pages_scenarios(tmp_path):
    """Else a hull with fins leaves its depth in a mission that has none."""
    for listing in (CLIENT, DATABASE):
        assert table(listing, tmp_path)[0].hold_depth_m == 0.0


def test_the_page_says_of_the_lauv_what_is_tested_here():
    for part in ("395 (limit", "full_deg = [100, 0, 100, 0]", "full_deg = [0, 100, 0, 100]", "limit = 20"):
        assert part in PAGE
