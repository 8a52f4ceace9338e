"""What a stop takes back: that which would move what it stops."""

from __future__ import annotations

import pytest

from uwserver.ports import Call, Command
from uwserver.ports.stops import is_stop, is_withdrawn


@pytest.mark.parametrize(
    ("service", "expected"),
    [
        ("rov/autopilot/disarm", True), ("rov/thrusters/deactivate", True), ("world/pause", True),
        ("rov/autopilot/arm", False), ("world/resume", False), ("rov/pause", False), ("", False),
    ],
)  # fmt: skip
def test_which_services_stop(service: str, expected: bool) -> None:
    assert is_stop(service) is expected


@pytest.mark.parametrize(
    ("item", "by_disarm", "by_deactivate"),
    [
        (Command("rov/thrusters", (), "a"), True, True),
        (Command("rov/lights", (), "a"), True, False),
        (Command("rov/autopilot/depth", (), "a"), True, False),
        (Command("rover/thrusters", (), "a"), False, False),
        (Call("rov/autopilot/arm", {}, "a"), True, False),
        (Call("rov/thrusters/activate", {}, "a"), False, True),
        (Call("rov/autopilot/set_mission", {}, "a"), False, False),
        (Call("rov/autopilot/disarm", {}, "a"), False, False),
        (Call("world/reset", {}, "a"), False, False),
    ],
)
def test_what_a_stop_withdraws(item: Command | Call, by_disarm: bool, by_deactivate: bool) -> None:
    assert is_withdrawn(item, "rov/autopilot/disarm") is by_disarm
    assert is_withdrawn(item, "rov/thrusters/deactivate") is by_deactivate
