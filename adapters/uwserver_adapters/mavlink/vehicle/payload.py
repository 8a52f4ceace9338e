"""Camera tilt and lights, as the buttons and commands of a ground station move them. They are remembered and told; `fittings`
commands what the vehicle has of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

TILT_STEP_DEG, TILT_LIMIT_DEG = 5.0, 45.0


class Payload:
    """What ArduSub keeps of camera mount and lights.

    Attributes:
        tilt, pan: of the camera, degrees, up and to starboard positive.
        lights: brightness of both, 0 to 1.
    """

    def __init__(self) -> None:
        self.tilt = 0.0
        self.pan = 0.0
        self.lights = [0.0, 0.0]

    def point(self, tilt: float, pan: float) -> None:
        """Point the camera, degrees; it goes as far as it can."""
        self.tilt = min(TILT_LIMIT_DEG, max(-TILT_LIMIT_DEG, tilt))
        self.pan = min(TILT_LIMIT_DEG, max(-TILT_LIMIT_DEG, pan))

    def actions(self, light_steps: Callable[[], float]) -> Mapping[int, Callable[[], None]]:
        """What buttons do here, by the number of their function in ArduSub.

        Args:
            light_steps: steps from dark to bright.
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
