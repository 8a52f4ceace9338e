"""The servo outputs of an ArduSub: motors as the autopilot commands them, and lights and camera mount, which the vehicle's lamps and mount follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from uwserver.adapter import AdapterContext, Conversation
from uwserver.ports import Port
from uwserver_adapters.mavlink.vehicle.bridge import SOURCE, command
from uwserver_adapters.mavlink.vehicle.parameters import Parameters
from uwserver_adapters.mavlink.wire.codec import NEUTRAL_US, deflection, from_degrees, pulse

TILT_STEP_DEG, TILT_LIMIT_DEG = 5.0, 45.0
COUNT = 16
_MOTOR_1, _MOTORS = 33, 8
_TILT, _LIGHTS = 7, {59: 0, 60: 1, 181: 0, 182: 1}
"""Values of SERVOn_FUNCTION. Lights without a function of their own follow RC inputs 9 and 10."""


class Payload:
    """Camera mount and lights as ArduSub keeps them. Runs on the loop thread.

    The vehicle's lamps and mount are commanded only when something has changed, so that others may command them in between. All lamps shine
    as the brighter of ArduSub's two lights, because the lamps of a BlueROV share one output.

    Args:
        context: the world.
        vehicle: name of the vehicle.

    Attributes:
        tilt, pan: direction of the camera, degrees, up and to starboard positive.
        lights: brightness of both lights, 0 to 1.
    """

    def __init__(self, context: AdapterContext, vehicle: str) -> None:
        self.tilt = 0.0
        self.pan = 0.0
        self.lights = [0.0, 0.0]
        self._context = context
        self._root = f"{vehicle}/"
        self._peer = Conversation(context, SOURCE, queue="payload")
        self._commanded = (0.0, 0.0)

    def point(self, tilt: float, pan: float) -> None:
        """Point the camera, degrees, within its limits."""
        self.tilt = min(TILT_LIMIT_DEG, max(-TILT_LIMIT_DEG, tilt))
        self.pan = min(TILT_LIMIT_DEG, max(-TILT_LIMIT_DEG, pan))

    def tick(self) -> None:
        """Command what has changed. Called about 20 times per second of wall time."""
        level, tilt = max(self.lights), self.tilt
        if (level, tilt) == self._commanded:
            return
        was_level, was_tilt = self._commanded
        self._commanded = level, tilt
        for port in self._context.ports.values():
            if not port.path.startswith(self._root):
                continue
            if port.kind == "lamps" and level != was_level:
                self._command(port, [level] * port.fields[0].size)
            elif port.kind == "camera_mount" and tilt != was_tilt:
                field = port.fields[0]
                self._command(port, min(max(from_degrees(tilt), field.minimum or 0.0), field.maximum or 0.0))

    def _command(self, port: Port, value: object) -> None:
        command(self._peer, port.path, {port.fields[0].name: value}, self._answered)

    def _answered(self, reason: str) -> None:
        if reason:
            self._context.stats.count_error(reason)

    def actions(self, light_steps: Callable[[], float]) -> Mapping[int, Callable[[], None]]:
        """Return what buttons do here, by the number of their function in ArduSub.

        Args:
            light_steps: returns the number of steps from dark to bright.
        """

        def light(which: int, step: float) -> None:
            level = self.lights[which] + step / max(1.0, light_steps())
            self.lights[which] = min(1.0, max(0.0, level))

        def cycle(which: int) -> None:
            if self.lights[which] >= 1.0:
                self.lights[which] = 0.0
            else:
                light(which, 1.0)

        return {
            21: lambda: self.point(0.0, 0.0),
            22: lambda: self.point(self.tilt + TILT_STEP_DEG, self.pan),
            23: lambda: self.point(self.tilt - TILT_STEP_DEG, self.pan),
            31: lambda: cycle(0),
            32: lambda: light(0, 1.0),
            33: lambda: light(0, -1.0),
            34: lambda: cycle(1),
            35: lambda: light(1, 1.0),
            36: lambda: light(1, -1.0),
        }


def wired(motors: int) -> Mapping[str, float]:
    """Return the parameters of a vehicle with this number of motors on its first outputs."""
    return {f"SERVO{k}_FUNCTION": _MOTOR_1 + k - 1.0 for k in range(1, min(motors, _MOTORS) + 1)}


class Outputs:
    """The pulses of SERVO_OUTPUT_RAW, and the motor test.

    Args:
        parameters: functions of the outputs.
        payload: lights and mount.
        motors: number of motors that the autopilot commands.
        patience_s: simulation time without a command after which the autopilot ends a motor test.
    """

    def __init__(self, parameters: Parameters, payload: Payload, motors: int, patience_s: float) -> None:
        self._parameters = parameters
        self._payload = payload
        self._tested = [0.0] * motors
        self._tested_at = -math.inf
        self._patience_s = patience_s
        self._set: dict[int, int] = {}

    def pulses(self, motors: Sequence[float]) -> Mapping[int, int]:
        """Return the pulse widths (us) of the outputs that do something, by output.

        Args:
            motors: deflections, -1 to 1; empty while disarmed.
        """
        pulses = {k: self._pulse(k, motors) for k in range(1, COUNT + 1)}
        return {k: width for k, width in pulses.items() if width} | self._set

    def _function(self, output: int) -> int:
        return round(self._parameters.value(f"SERVO{output}_FUNCTION"))

    def _motor(self, output: int) -> int | None:
        motor = self._function(output) - _MOTOR_1
        return motor if 0 <= motor < min(len(self._tested), _MOTORS) else None

    def _pulse(self, output: int, motors: Sequence[float]) -> int:
        function, motor = self._function(output), self._motor(output)
        if function == _TILT:
            return pulse(self._payload.tilt / TILT_LIMIT_DEG)
        if function in _LIGHTS:
            return pulse(2.0 * self._payload.lights[_LIGHTS[function]] - 1.0)
        if motor is None:
            return 0
        return pulse(motors[motor]) if motor < len(motors) else NEUTRAL_US

    def set_servo(self, output: int, pulse_us: float) -> bool:
        """Set an output, or the lights on it. Returns False if it does not exist, drives a motor or the mount, or the pulse is not valid."""
        if not 1 <= output <= COUNT or not _is_pulse(pulse_us) or self._motor(output) is not None:
            return False
        function = self._function(output)
        if function in _LIGHTS:
            self._payload.lights[_LIGHTS[function]] = 0.5 + 0.5 * deflection(pulse_us)
        elif function != _TILT:
            self._set[output] = round(pulse_us)
        return function != _TILT

    def begin_test(self) -> None:
        """Begin a motor test with all motors at rest."""
        self._tested = [0.0] * len(self._tested)

    def test(self, motor: int, pulse_us: float, now: float) -> Sequence[float] | None:
        """Add one motor to the motor test, and return the deflections of all.

        Args:
            motor: its number, from 0. The other motors keep what this test gave them.
            pulse_us: its pulse width.
            now: simulation time, s.

        Returns:
            None if there is no such motor, or the pulse is not valid.
        """
        if not 0 <= motor < len(self._tested) or not _is_pulse(pulse_us):
            return None
        # A test may also end unnoticed: by another client, a change of mode or a reset of the world.
        if not 0.0 <= now - self._tested_at <= self._patience_s:
            self.begin_test()
        self._tested_at = now
        self._tested[motor] = deflection(pulse_us)
        return list(self._tested)


def _is_pulse(pulse_us: float) -> bool:
    return 500 <= pulse_us <= 2500
