"""What happens when the pilot, the ground station or the battery goes: ArduSub's fail-safes, with its parameters and texts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from uwserver_adapters.mavlink.vehicle.modes import ALT_HOLD, SURFACE, Mode

if TYPE_CHECKING:
    from uwserver_adapters.mavlink.vehicle.ardusub import Vehicle

EMERGENCY, CRITICAL, ERROR, WARNING, NOTICE, INFO = 0, 2, 3, 4, 5, 6
"""Severities of STATUSTEXT."""
_DISARM, _SURFACE = 2, 4
AGAIN_S = 20.0
"""A fail-safe that lasts is told again."""


class Failsafes:
    """Watches; acts once when something goes, and again when it has come back and gone. Times are simulation time, s.

    Args:
        vehicle: to be kept safe.

    Attributes:
        active: those that are on: pilot, gcs, leak, battery.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.active: dict[str, float] = {}
        self._pilot_at: float | None = None
        self._gcs_at: float | None = None
        self._autopilot = ""

    def heard_pilot(self, now: float) -> None:
        """The pilot steers."""
        self._pilot_at = now
        self.active.pop("pilot", None)

    def armed(self) -> None:
        """Who steered before the vehicle was armed has not begun to steer it yet."""
        self._pilot_at = None
        self.active.pop("pilot", None)

    def heard_gcs(self, now: float) -> None:
        """A heartbeat of the ground station that is in charge."""
        self._gcs_at = now
        if self.active.pop("gcs", None) is not None:
            self._vehicle.tell(WARNING, "GCS Failsafe Cleared")

    def restart(self) -> None:
        """The time begins anew."""
        self.active.clear()
        self._pilot_at = self._gcs_at = None

    def tick(self, now: float) -> None:
        """Look."""
        self._check_pilot(now)
        self._check_gcs(now)
        self._check_leak(now)
        self._check_battery(now)
        self._tell_autopilot()

    def _value(self, name: str) -> float:
        return self._vehicle.parameters.value(name)

    def _begins(self, name: str, now: float, is_told_again: bool = False) -> tuple[bool, bool]:
        """Whether it begins now, and whether it is to be told."""
        since = self.active.get(name)
        if since is None or (is_told_again and now - since >= AGAIN_S):
            self.active[name] = now
            return since is None, True
        return False, False

    def _check_pilot(self, now: float) -> None:
        action = self._value("FS_PILOT_INPUT")
        if action == 0 or self._pilot_at is None or now - self._pilot_at <= self._value("FS_PILOT_TIMEOUT"):
            return
        self._pilot_at = None
        self._vehicle.pilot.neutral()
        if self._vehicle.readings.state().armed and self._begins("pilot", now)[0]:
            self._vehicle.tell(CRITICAL, "Lost manual control")
            if action == _DISARM:
                self._disarm()

    def _check_gcs(self, now: float) -> None:
        action = self._value("FS_GCS_ENABLE")
        if action == 0 or self._gcs_at is None or now - self._gcs_at <= self._value("FS_GCS_TIMEOUT"):
            return
        begins, is_told = self._begins("gcs", now, is_told_again=True)
        if is_told:
            self._vehicle.tell(WARNING, f"MYGCS: {self._vehicle.gcs_system}, heartbeat lost")
        if begins and self._vehicle.readings.state().armed:
            if action == _DISARM:
                self._disarm()
            elif action in (3, _SURFACE):
                self._enter(ALT_HOLD if action == 3 else SURFACE)

    def _check_leak(self, now: float) -> None:
        action = self._value("FS_LEAK_ENABLE")
        reading = self._vehicle.readings.last("leak")
        if action == 0 or reading is None or not reading.get("leak"):
            self.active.pop("leak", None)
            return
        begins, is_told = self._begins("leak", now, is_told_again=True)
        if is_told:
            self._vehicle.tell(CRITICAL, "Leak Detected")
        if begins and action == 2 and self._vehicle.readings.state().armed:
            self._enter(SURFACE)

    def _check_battery(self, now: float) -> None:
        voltage = self._vehicle.readings.number("battery", "voltage")
        low, critical = self._value("BATT_LOW_VOLT"), self._value("BATT_CRT_VOLT")
        level = "" if voltage is None else "critical" if voltage < critical else "low" if voltage < low else ""
        if not level:
            self.active.pop("battery", None)
            return
        begins, is_told = self._begins("battery", now, is_told_again=True)
        if is_told:
            self._vehicle.tell(WARNING, f"Battery 1 is {level} {voltage:.2f}V")
        action = self._value("BATT_FS_CRT_ACT" if level == "critical" else "BATT_FS_LOW_ACT")
        if begins and self._vehicle.readings.state().armed:
            if action == 2:
                self._disarm()
            elif action == 3:
                self._enter(SURFACE)

    def _tell_autopilot(self) -> None:
        """The autopilot has fail-safes of its own."""
        reason = self._vehicle.readings.state().failsafe
        if reason != self._autopilot:
            self._autopilot = reason
            self._vehicle.tell(*((CRITICAL, f"Failsafe: {reason}") if reason else (NOTICE, "Failsafe cleared")))

    def _disarm(self) -> None:
        if self._vehicle.readings.state().armed:
            self._vehicle.disarm(self._tell_failure)

    def _enter(self, mode: Mode) -> None:
        self._vehicle.set_mode(mode, self._tell_failure)

    def _tell_failure(self, reason: str) -> None:
        if reason:
            self._vehicle.tell(CRITICAL, f"Failsafe action failed: {reason}")
