"""What the autopilot says reaches ground stations in their words."""

from __future__ import annotations

import pytest
from uwserver_adapters.mavlink.vehicle.modes import in_words_of_mavlink

ARM = "choose another mode, or arm with force = true"


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("the autopilot is not armed: call rov/autopilot/arm first", "the autopilot is not armed: arm first"),
        ("there is no mission: call rov/autopilot/set_mission first", "there is no mission: upload one first"),
        ("mission has no position: it needs a dvl", "AUTO has no position: it needs a dvl"),
        (f"mode depth_hold has no depth: it needs it; {ARM}",
         "mode ALT_HOLD has no depth: it needs it; choose another mode, or force arming"),
        ("there is water in the hull; arm with force = true if you must",
         "there is water in the hull; force arming if you must"),
        ('"rov/autopilot/depth" is not followed in mode manual: call rov/autopilot/set_mode with depth_hold or velocity or guided first',
         '"rov/autopilot/depth" is not followed in mode MANUAL: change to ALT_HOLD or GUIDED first'),
        ('"rov/thrusters" is held by the autopilot while it is armed: call rov/autopilot/disarm first, or steer by rov/autopilot/pilot',
         '"rov/thrusters" is held by the autopilot while it is armed: disarm first, or steer by the sticks'),
        ("no depth: it needs a valid sensor of kind pressure", "no depth: it needs a valid sensor of kind pressure"),
        ("", ""),
    ],
)  # fmt: skip
def test_words(said, told):
    assert in_words_of_mavlink(said) == told


async def test_auto_without_a_mission_is_refused_in_words_of_mavlink(bench):
    """ArduSub: "Mode change to AUTO failed", the acknowledgement FAILED."""
    station = bench.station()
    assert await station.command(176, 1.0, 3.0) == 4
    assert station.texts() == ["Mode change to AUTO failed: there is no mission: upload one first"]
    bench.rov.items = [{"kind": "surface"}]
    assert await station.command(176, 1.0, 3.0) == 0
