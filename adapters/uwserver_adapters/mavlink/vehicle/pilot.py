"""The pilot's sticks and buttons, mapped as in ArduSub, and the fail-safes for the loss of the pilot or the ground station."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from uwserver_adapters.mavlink.vehicle.bridge import CRITICAL, NOTICE, WARNING, Bridge, Done
from uwserver_adapters.mavlink.vehicle.modes import ALT_HOLD, SURFACE
from uwserver_adapters.mavlink.vehicle.parameters import Parameters
from uwserver_adapters.mavlink.wire.codec import NEUTRAL_US, SPAN_US, deflection
from uwserver_adapters.mavlink.wire.dialect import MavlinkMessage

CHANNELS = 18
PITCH, ROLL, HEAVE, YAW, SURGE, SWAY = range(6)
"""Channels of the radio, from 0."""
OVERRIDE_S = 3.0
"""Sticks and overrides that are not renewed for this time end."""
REPEAT_S = 0.1
"""Interval at which overrides are repeated: the pilot port expects commands more often than a ground station must send them."""
_BUTTONS = 32
_SHIFT, _GAIN_TOGGLE, _GAIN_UP, _GAIN_DOWN, _INPUT_HOLD, _ROLL_PITCH = 1, 41, 42, 43, 48, 49
_TRIMS = {44: (ROLL, 10), 45: (ROLL, -10), 46: (PITCH, 10), 47: (PITCH, -10)}
_UNCHANGED, _RELEASED = 0xFFFF, 0xFFFF - 1
_DISARM, _HOLD, _SURFACE = 2, 3, 4
AGAIN_S, GCS_AGAIN_S = 20.0, 30.0
"""Time after which a fail-safe that lasts is announced again, s: the second is for the ground station's."""


class Pilot:
    """Sticks, gain and buttons. Times are simulation time, s.

    Args:
        parameters: gains, and functions of buttons.
        post: takes the deflections (6,), -1 to 1, along and about x, y, z of B.
        actions: what buttons do, by the number of their function; only functions that do not concern the sticks.
        say: tells the pilot of a change.

    Attributes:
        gain: fraction of the full deflection that a full stick gives.
        is_held: stick positions that a button has stored are added.
        steers_attitude: the surge and sway sticks change pitch and roll instead.
        channels: pulse widths of all channels, us.
        heard_at: when the pilot last steered; None if not since the vehicle was armed or the pilot was lost.
        is_lost: the pilot no longer steers, and a fail-safe has announced it.
    """

    def __init__(
        self,
        parameters: Parameters,
        post: Callable[[Sequence[float]], None],
        actions: Mapping[int, Callable[[], None]],
        say: Callable[[str], None],
    ) -> None:
        self._parameters = parameters
        self._post = post
        self._actions = actions
        self._say = say
        self.gain = parameters.value("JS_GAIN_DEFAULT")
        self.is_held = False
        self.steers_attitude = False
        self.channels = [NEUTRAL_US] * CHANNELS
        self.heard_at: float | None = None
        self.is_lost = False
        self._held = [0] * 6
        self._trim = {ROLL: 0, PITCH: 0}
        self._pressed = 0
        self._overridden: dict[int, float] = {}
        self._sticks_at: float | None = None
        self._posted_at = 0.0

    @property
    def deflections(self) -> tuple[float, ...]:
        """Surge, sway, heave (down positive), roll, pitch and yaw, -1 to 1."""
        us = [deflection(width) for width in self.channels[:6]]
        # Adding zero turns -0.0 into 0.0.
        return (us[SURGE], us[SWAY], -us[HEAVE] + 0.0, us[ROLL], us[PITCH], us[YAW])

    def steer(self, message: MavlinkMessage, now: float) -> None:
        """Take MANUAL_CONTROL: x, y and r are -1000 to 1000; z is 0 to 1000, with 500 for no heave; s and t are pitch and roll if enabled."""
        self._hear(now)
        sticks = {axis: message.integer(axis) for axis in "xyzr"}
        if any(abs(value) > 1000 for value in sticks.values()):
            return  # 32767 marks an axis that the joystick does not have
        extensions = message.integer("enabled_extensions")
        s = message.integer("s") if extensions & 1 else 0
        t = message.integer("t") if extensions & 2 else 0
        self._press(message.integer("buttons") | message.integer("buttons2") << 16)
        wide = 0.4 * self.gain
        thrust = 0.8 * self.gain * self._parameters.value("JS_THR_GAIN")
        pushes = [0.0] * 6
        pushes[PITCH], pushes[ROLL] = s * wide + self._trim[PITCH], t * wide + self._trim[ROLL]
        pushes[HEAVE] = (sticks["z"] - 500) * thrust
        pushes[YAW] = sticks["r"] * wide
        forward, lateral = (PITCH, ROLL) if self.steers_attitude else (SURGE, SWAY)
        pushes[forward] += sticks["x"] * wide
        pushes[lateral] += sticks["y"] * wide
        for channel, push in enumerate(pushes):
            self._set(channel, NEUTRAL_US + push + self._held[channel])
        self._overridden.clear()
        self._sticks_at = now
        self._send(now)

    def override(self, message: MavlinkMessage, now: float) -> None:
        """Take RC_CHANNELS_OVERRIDE: 65535 leaves a channel as it is, and 0 (from the ninth channel on 65534) releases it."""
        self._hear(now)
        for channel in range(CHANNELS):
            pulse_us = message.integer(f"chan{channel + 1}_raw")
            if pulse_us == _UNCHANGED or (pulse_us == 0 and channel >= 8):
                continue
            if pulse_us in (0, _RELEASED):
                self._overridden.pop(channel, None)
                self._set(channel, NEUTRAL_US)
            else:
                self._overridden[channel] = now
                self._set(channel, pulse_us)
        self._send(now)

    def tick(self, now: float) -> None:
        """End sticks and overrides that were not renewed, and repeat overrides that still hold.

        Sticks are never repeated: a ground station sends them ten times per second, and the port must notice when it stops.
        """
        if now < self._posted_at:
            self.neutral()  # simulation time has begun again
            self._posted_at = now
        for channel, since in list(self._overridden.items()):
            if now - since > OVERRIDE_S:
                del self._overridden[channel]
                self._set(channel, NEUTRAL_US)
                if not self._overridden:
                    self._send(now)
        if self._sticks_at is not None and now - self._sticks_at > OVERRIDE_S:
            self.neutral()
        if now - self._posted_at >= REPEAT_S and self._overridden:
            self._send(now)

    def neutral(self) -> None:
        """Release all sticks."""
        was_steered = self._sticks_at is not None or bool(self._overridden)
        self.channels[:6] = [NEUTRAL_US] * 6
        self._overridden.clear()
        self._held = [0] * 6
        self.is_held = False
        self._sticks_at = None
        if was_steered:
            self._post(self.deflections)

    def forget(self) -> None:
        """Forget that anybody has steered."""
        self.heard_at, self.is_lost = None, False

    def _hear(self, now: float) -> None:
        self.heard_at, self.is_lost = now, False

    def _set(self, channel: int, pulse_us: float) -> None:
        self.channels[channel] = round(min(NEUTRAL_US + SPAN_US, max(NEUTRAL_US - SPAN_US, pulse_us)))

    def _send(self, now: float) -> None:
        self._posted_at = now
        self._post(self.deflections)

    def _press(self, buttons: int) -> None:
        fresh = buttons & ~self._pressed
        self._pressed = buttons
        value = self._parameters.value
        functions = {k: round(value(f"BTN{k}_FUNCTION")) for k in range(_BUTTONS) if buttons >> k & 1}
        is_shifted = _SHIFT in functions.values()
        for k, function in functions.items():
            if fresh >> k & 1:
                self._do(round(value(f"BTN{k}_SFUNCTION")) if is_shifted and function != _SHIFT else function)

    def _do(self, function: int) -> None:
        value = self._parameters.value
        low, high, steps = value("JS_GAIN_MIN"), value("JS_GAIN_MAX"), max(1.0, value("JS_GAIN_STEPS") - 1)
        if function in (_GAIN_UP, _GAIN_DOWN, _GAIN_TOGGLE):
            step = (high - low) / steps
            if function == _GAIN_TOGGLE:
                self.gain = high if self.gain < 0.5 * (low + high) else low
            else:
                self.gain = min(high, max(low, self.gain + (step if function == _GAIN_UP else -step)))
            self._say(f"#Gain is at {round(self.gain * 100)}%")
        elif function in _TRIMS:
            channel, step = _TRIMS[function]
            self._trim[channel] = min(200, max(-200, self._trim[channel] + int(step)))
        elif function == _INPUT_HOLD:
            self.is_held = not self.is_held
            axes = (HEAVE, YAW, SURGE, SWAY)
            self._held = [self.channels[k] - NEUTRAL_US if self.is_held and k in axes else 0 for k in range(6)]
            self._say("#Input Hold Set" if self.is_held else "#Input Hold Disabled")
        elif function == _ROLL_PITCH:
            self.steers_attitude = not self.steers_attitude
            self._say("#Attitude Control" if self.steers_attitude else "#Movement Control")
        elif function in self._actions:
            self._actions[function]()


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
