"""The servo outputs of an ArduSub: motors as the autopilot commands them, lights and camera mount as the payload has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from uwserver_adapters.mavlink.codec import NEUTRAL_US, deflection, pulse
from uwserver_adapters.mavlink.parameters import Parameters
from uwserver_adapters.mavlink.payload import TILT_LIMIT_DEG, Payload

COUNT = 16
_MOTOR_1, _MOTORS = 33, 8
_TILT, _LIGHTS = 7, {59: 0, 60: 1, 181: 0, 182: 1}
"""Values of SERVOn_FUNCTION; lights hang on RC inputs 9 and 10 where they have no function of their own."""


def wired(motors: int) -> Mapping[str, float]:
    """Parameters of a vehicle with so many motors, on its first outputs."""
    return {f"SERVO{k}_FUNCTION": _MOTOR_1 + k - 1.0 for k in range(1, min(motors, _MOTORS) + 1)}


class Outputs:
    """What SERVO_OUTPUT_RAW tells, and the test of motors.

    Args:
        parameters: which output is what.
        payload: lights and mount.
        motors: that the autopilot moves: its outputs.
    """

    def __init__(self, parameters: Parameters, payload: Payload, motors: int) -> None:
        self._parameters = parameters
        self._payload = payload
        self._tested = [0.0] * motors
        self._set: dict[int, int] = {}

    def pulses(self, motors: Sequence[float]) -> Mapping[int, int]:
        """Pulses (us) by output, of those that do something.

        Args:
            motors: deflections, -1 to 1; none while disarmed.
        """
        pulses = {k: self._pulse(self._function(k), motors) for k in range(1, COUNT + 1)}
        return {k: width for k, width in pulses.items() if width} | self._set

    def _function(self, output: int) -> int:
        return round(self._parameters.value(f"SERVO{output}_FUNCTION"))

    def _pulse(self, function: int, motors: Sequence[float]) -> int:
        if function == _TILT:
            return pulse(self._payload.tilt / TILT_LIMIT_DEG)
        if function in _LIGHTS:
            return pulse(2.0 * self._payload.lights[_LIGHTS[function]] - 1.0)
        motor = function - _MOTOR_1
        if not 0 <= motor < len(self._tested):
            return 0
        return pulse(motors[motor]) if motor < len(motors) else NEUTRAL_US

    def set_servo(self, output: int, pulse_us: float) -> bool:
        """Set an output; False for one that is not there or a motor's, or a pulse that no servo understands."""
        if not 1 <= output <= COUNT or not 500 <= pulse_us <= 2500:
            return False
        if 0 <= self._function(output) - _MOTOR_1 < len(self._tested):
            return False
        self._set[output] = round(pulse_us)
        return True

    def begin_test(self) -> None:
        """All motors stand."""
        self._tested = [0.0] * len(self._tested)

    def test(self, motor: int, pulse_us: float) -> Sequence[float] | None:
        """All deflections with that of one more motor, from 0; the others keep theirs. None when it is not there."""
        if not 0 <= motor < len(self._tested):
            return None
        self._tested[motor] = deflection(pulse_us)
        return list(self._tested)
