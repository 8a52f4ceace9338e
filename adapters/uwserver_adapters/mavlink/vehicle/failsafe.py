"""ArduSub's fail-safes, with its parameters and texts: what happens when the pilot, the ground station or the battery is lost, or a leak occurs."""

from __future__ import annotations

from collections.abc import Callable

from uwserver_adapters.mavlink.vehicle.autopilot import Done
from uwserver_adapters.mavlink.vehicle.bridge import CRITICAL, NOTICE, WARNING, Bridge
from uwserver_adapters.mavlink.vehicle.modes import ALT_HOLD, SURFACE
from uwserver_adapters.mavlink.vehicle.parameters import Parameters
from uwserver_adapters.mavlink.vehicle.pilot import Pilot

_DISARM, _HOLD, _SURFACE = 2, 3, 4
AGAIN_S, GCS_AGAIN_S = 20.0, 30.0
"""Time after which a fail-safe that lasts is announced again, s: the second is for the ground station's."""


class Failsafes:
    """Watches pilot, ground station, leak and battery. Acts once for each loss. Times are simulation time, s.

    Args:
        bridge: the way to ground stations and autopilot.
        parameters: which fail-safe does what.
        pilot: the sticks.
        disarm: disarms the vehicle.
    """

    def __init__(self, bridge: Bridge, parameters: Parameters, pilot: Pilot, disarm: Callable[[Done], None]) -> None:
        self._bridge = bridge
        self._value = parameters.value
        self._parameters = parameters
        self._pilot = pilot
        self._disarm_vehicle = disarm
        self._tell_failure = bridge.failure_teller("Failsafe action failed: ", CRITICAL)
        self._active: dict[str, float] = {}
        self._gcs_at: float | None = None
        self._autopilot = ""
        self._has_acted_on_gcs = False

    @property
    def is_active(self) -> bool:
        """Whether pilot, ground station or battery is lost, or there is a leak."""
        return self._pilot.is_lost or bool(self._active)

    def heard_gcs(self, now: float) -> None:
        """Note a heartbeat of the ground station in charge, or a message that counts as one."""
        self._gcs_at = now
        self._has_acted_on_gcs = False
        if self._active.pop("gcs", None) is not None:
            self._bridge.tell(WARNING, "GCS Failsafe Cleared")

    def restart(self) -> None:
        """Forget everything: simulation time has begun again."""
        self._active.clear()
        self._pilot.forget()
        self._gcs_at = None
        self._has_acted_on_gcs = False

    def tick(self, now: float) -> None:
        """Check everything."""
        self._check_pilot(now)
        self._check_gcs(now)
        self._check_leak(now)
        self._check_battery(now)
        self._tell_autopilot()

    def _begins(self, name: str, now: float, severity: str, text: str, again_s: float = AGAIN_S) -> bool:
        """Announce a loss that begins or lasts. Returns whether to act: it begins, and the vehicle is armed."""
        since = self._active.get(name)
        if since is None or now - since >= again_s:
            self._active[name] = now
            self._bridge.tell(severity, text)
        return since is None and self._bridge.readings.state().armed

    def _check_pilot(self, now: float) -> None:
        action = self._value("FS_PILOT_INPUT")
        heard_at = self._pilot.heard_at
        if action == 0 or heard_at is None or now - heard_at <= self._value("FS_PILOT_TIMEOUT"):
            return
        self._pilot.forget()
        self._pilot.neutral()
        if self._bridge.readings.state().armed:
            self._pilot.is_lost = True
            self._bridge.tell(CRITICAL, "Lost manual control")
            if action == _DISARM:
                self._disarm()

    def _check_gcs(self, now: float) -> None:
        action = self._value("FS_GCS_ENABLE")
        if action == 0 or self._gcs_at is None or now - self._gcs_at <= self._value("FS_GCS_TIMEOUT"):
            return
        self._begins("gcs", now, WARNING, f"MYGCS: {self._parameters.gcs_system}, heartbeat lost", GCS_AGAIN_S)
        if self._has_acted_on_gcs or not self._bridge.readings.state().armed:
            return  # it acts when the vehicle is armed later
        self._has_acted_on_gcs = True
        if action == _DISARM:
            self._disarm()
        elif action in (_HOLD, _SURFACE):
            self._bridge.set_mode(ALT_HOLD if action == _HOLD else SURFACE, self._or_disarm)

    def _check_leak(self, now: float) -> None:
        action = self._value("FS_LEAK_ENABLE")
        reading = self._bridge.readings.last("leak")
        if action == 0 or reading is None or not reading.get("leak"):
            self._active.pop("leak", None)
            return
        if self._begins("leak", now, CRITICAL, "Leak Detected") and action == 2:
            self._bridge.set_mode(SURFACE, self._tell_failure)

    def _check_battery(self, now: float) -> None:
        voltage = self._bridge.readings.number("battery", "voltage")
        low, critical = self._value("BATT_LOW_VOLT"), self._value("BATT_CRT_VOLT")
        level = "" if voltage is None else "critical" if voltage < critical else "low" if voltage < low else ""
        if not level:
            self._active.pop("battery", None)
            return
        action = self._value("BATT_FS_CRT_ACT" if level == "critical" else "BATT_FS_LOW_ACT")
        if self._begins("battery", now, WARNING, f"Battery 1 is {level} {voltage:.2f}V"):
            if action == 2:
                self._disarm()
            elif action == 3:
                self._bridge.set_mode(SURFACE, self._tell_failure)

    def _tell_autopilot(self) -> None:
        """Announce a fail-safe of the autopilot itself that ArduSub does not have."""
        reason = self._bridge.readings.state().failsafe
        if reason == "pilot" or (reason == "leak" and self._value("FS_LEAK_ENABLE")):
            reason = ""  # the checks above announce it in ArduSub's words
        if reason != self._autopilot:
            self._autopilot = reason
            self._bridge.tell(*((CRITICAL, f"Failsafe: {reason}") if reason else (NOTICE, "Failsafe cleared")))

    def _disarm(self) -> None:
        if self._bridge.readings.state().armed:
            self._disarm_vehicle(self._tell_failure)

    def _or_disarm(self, reason: str) -> None:
        """Disarm if the mode could not be entered."""
        if reason:
            self._tell_failure(reason)
            self._disarm()
