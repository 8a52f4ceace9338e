"""Arming and disarming, with what must be reset before."""

from __future__ import annotations

from uwserver_adapters.mavlink.vehicle.autopilot import Done
from uwserver_adapters.mavlink.vehicle.bridge import INFO, Bridge
from uwserver_adapters.mavlink.vehicle.outputs import Outputs
from uwserver_adapters.mavlink.vehicle.pilot import Pilot


class Arming:
    """Arms and disarms the vehicle, and tells ground stations. Runs on the loop thread.

    Args:
        bridge: the way to ground stations and autopilot.
        pilot: its sticks are released.
        outputs: its motor test starts again.
    """

    def __init__(self, bridge: Bridge, pilot: Pilot, outputs: Outputs) -> None:
        self._bridge = bridge
        self._pilot = pilot
        self._outputs = outputs

    def arm(self, force: bool, done: Done) -> None:
        """Arm. The last sticks do not count, because they were moved while the vehicle was disarmed."""
        self._pilot.forget()
        self._pilot.neutral()
        self._outputs.begin_test()

        def on_done(reason: str) -> None:
            if not reason:
                self._bridge.tell(INFO, "Arming motors")
                self._bridge.tell_home()  # as ArduPilot does; QGroundControl waits for it
            done(reason)

        self._bridge.switch("arm", {"force": force}, on_done, armed=True)

    def disarm(self, done: Done) -> None:
        """Disarm, with all sticks released."""
        self._pilot.neutral()

        def on_done(reason: str) -> None:
            if not reason:
                self._bridge.tell(INFO, "Disarming motors")
            done(reason)

        self._bridge.switch("disarm", {}, on_done, armed=False)
