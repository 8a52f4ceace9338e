"""Camera mount and lights: what buttons and commands of a ground station set, and the vehicle's lamps and mount that follow."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from uwserver.adapter import AdapterContext, Conversation
from uwserver.ports import Port
from uwserver_adapters.mavlink.vehicle.autopilot import SOURCE, command
from uwserver_adapters.mavlink.wire.codec import from_degrees

TILT_STEP_DEG, TILT_LIMIT_DEG = 5.0, 45.0


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
