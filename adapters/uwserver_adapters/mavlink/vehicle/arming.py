"""Arming and disarming, and what is put right beforehand."""

from __future__ import annotations

from uwserver_adapters.mavlink.vehicle.autopilot import Done
from uwserver_adapters.mavlink.vehicle.bridge import INFO, Bridge
from uwserver_adapters.mavlink.vehicle.outputs import Outputs
from uwserver_adapters.mavlink.vehicle.pilot import Pilot


class Arming:
    """Arms and disarms, and says so. Loop thread.

    Args:
        bridge: to ground stations and autopilot.
        pilot: whose sticks are let go.
        outputs: whose test of motors begins anew.
    """

    def __init__(self, bridge: Bridge, pilot: Pilot, outputs: Outputs) -> None:
        self._bridge = bridge
        self._pilot = pilot
        self._outputs = outputs

    def arm(self, force: bool, done: Done) -> None:
        """Arm. What the sticks last said was said to a vehicle at rest: it does not count."""
        self._pilot.forget()
        self._pilot.neutral()
        self._outputs.begin_test()

        def told(reason: str) -> None:
            if not reason:
                self._bridge.tell(INFO, "Arming motors")
                self._bridge.tell_home()  # as ArduPilot; QGroundControl waits for it
            done(reason)

        self._bridge.switch("arm", {"force": force}, told, armed=True)

    def disarm(self, done: Done) -> None:
        """Disarm."""
        self._pilot.neutral()

        def told(reason: str) -> None:
            if not reason:
                self._bridge.tell(INFO, "Disarming motors")
            done(reason)

        self._bridge.switch("disarm", {}, told, armed=False)
