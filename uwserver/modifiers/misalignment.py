"""A sensor that sits askew: vectors and rotations come out in other axes than those that its table states."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Meta

from uwserver.frames import IDENTITY, Quat, conjugate, multiply, quat_from_rpy, rotate
from uwserver.modifiers.base import Measurement, Memory, Modifier, ModifierTable, Stream
from uwserver.table import Name, NonNegative, Vector3
from uwserver.units import rad


class Misalignment(ModifierTable, tag="misalignment", kw_only=True, frozen=True):
    """The real axes of the device are those of its table turned by `rpy_deg`; all named fields are given in the real ones.

    A vector v becomes R(rpy)^T v; a rotation q_NS becomes q_NS q(rpy). Vectors in N (`p_NS`, `v_NS`) stand for a whole frame that is askew.

    Attributes:
        fields: vectors of three and rotations, which turn together.
        rpy_deg: roll, pitch, yaw.
        sigma_deg: standard deviation of a further error of each angle, drawn once.
    """

    fields: Annotated[tuple[Name, ...], Meta(min_length=1)]
    rpy_deg: Vector3 = (0.0, 0.0, 0.0)
    sigma_deg: NonNegative = 0.0

    def build(self, stream: Stream) -> _Misalignment:
        """The modifier.

        Raises:
            ValueError: a field is unknown, or neither a vector of three nor a rotation; the text lists those that are.
        """
        return _Misalignment(self, stream)


_Part = Annotated[float, Meta(ge=-1.001, le=1.001)]


class Turn(Memory):
    """Attributes:
    q: from the real axes to those of the table, of unit length."""

    q: tuple[_Part, _Part, _Part, _Part] = IDENTITY


class _Misalignment(Modifier):
    memory: Turn
    draws = False

    def __init__(self, config: Misalignment, stream: Stream) -> None:
        super().__init__(stream)
        turning = [field for field in stream.fields if field.is_rotation or (field.frame and field.shape == (3,))]
        names = [field.name for field in turning]
        for name in config.fields:
            if name not in names:
                there = ", ".join(names) or "none"
                raise ValueError(f'no vector or rotation "{name}" to turn here, there are: {there}')
        self._indices = [(i, f.is_rotation) for i, f in enumerate(stream.fields) if f.name in config.fields]
        drawn = stream.rng.normal(0.0, rad(config.sigma_deg), 3).tolist()
        roll, pitch, yaw = (rad(angle) + error for angle, error in zip(config.rpy_deg, drawn, strict=True))
        self.memory = Turn(quat_from_rpy(roll, pitch, yaw))

    def apply(self, reading: Measurement) -> None:
        q: Quat = self.memory.q
        for index, is_rotation in self._indices:
            value = reading.values[index]
            if not isinstance(value, tuple) or None in value:
                continue
            turned = multiply(value, q) if is_rotation else rotate(conjugate(q), value)  # type: ignore[arg-type]
            reading.values[index] = turned

    def valid(self, record: Memory) -> None:
        super().valid(record)
        assert isinstance(record, Turn)
        if abs(math.hypot(*record.q) - 1.0) > 1e-3:
            raise ValueError(f'"q" is no rotation: {record.q}')
