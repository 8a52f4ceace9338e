"""Sound-velocity sensor: a short acoustic path in the water."""

from __future__ import annotations

from uwserver.modifiers.base import Measurement, Memory, Number
from uwserver.ports import Field
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable
from uwserver.table import NonNegative


class SoundSpeedConfig(SensorTable, tag="sound_speed", kw_only=True, frozen=True):
    """A sound-velocity sensor.

    Attributes:
        ideal: exact, whatever else is given.
        accuracy_mps: standard deviation of a constant error, drawn once a run.
        sigma_mps: standard deviation of white noise.
    """

    ideal: bool = False
    accuracy_mps: NonNegative = 0.0
    sigma_mps: NonNegative = 0.0

    def build(self, mount: Pose) -> SoundSpeed:
        return SoundSpeed(mount, self)


class SoundSpeedMemory(Memory):
    """Attributes:
    offset: constant error, m/s."""

    offset: Number = 0.0


class SoundSpeed(Sensor):
    """Speed of sound at the mount."""

    doc = "Speed of sound in the water at the mount; no value in air."
    fields = (Field("sound_speed", "m/s", "speed of sound"),)

    memory: SoundSpeedMemory

    def __init__(self, mount: Pose, config: SoundSpeedConfig) -> None:
        self._mount = mount
        self._accuracy, self._sigma = (0.0, 0.0) if config.ideal else (config.accuracy_mps, config.sigma_mps)
        super().__init__()

    def turn_on(self) -> SoundSpeedMemory:
        """The constant error."""
        return SoundSpeedMemory(self._accuracy * self.rng.standard_normal())

    def sense(self, scope: Scope) -> Measurement:
        """Invalid in air."""
        p_NS = scope.position(self._mount.p)
        noise = self._sigma * self.rng.standard_normal()
        if scope.submergence(p_NS) < 0.0:
            return Measurement([None], False)
        return Measurement([scope.water.sound_speed(p_NS[2]) + self.memory.offset + noise], True)
