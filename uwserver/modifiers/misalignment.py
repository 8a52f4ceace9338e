"""A sensor that is not mounted exactly: it measures vectors and rotations in other axes than its table states."""

from __future__ import annotations

import math
from typing import Annotated, Any

from msgspec import Meta

from uwserver.frames import IDENTITY, quat_from_rpy
from uwserver.modifiers.base import Memory, ModifierTable, Stream
from uwserver.modifiers.operations import Operation
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import draw_normals
from uwserver.table import Name, NonNegative, Vector3
from uwserver.units import rad

MISALIGNMENT = 9
"""Code of the operation."""


class Misalignment(ModifierTable, tag="misalignment", kw_only=True, frozen=True):
    """The real axes of the device are those of its table turned by `rpy_deg`. It gives the named fields in the real axes.

    A vector v becomes R(rpy)^T v; a rotation q_NS becomes q_NS q(rpy). For vectors in N (`p_NS`, `v_NS`) the whole frame of the device is turned.

    Attributes:
        fields: vectors of three components, and rotations; all are turned by the same angles.
        rpy_deg: roll, pitch, yaw.
        sigma_deg: standard deviation of a further error of each angle that is drawn once.
    """

    fields: Annotated[tuple[Name, ...], Meta(min_length=1)]
    rpy_deg: Vector3 = (0.0, 0.0, 0.0)
    sigma_deg: NonNegative = 0.0

    def build(self, stream: Stream) -> Operation:
        """Return the modifier.

        Raises:
            ValueError: a field is unknown, or neither a vector of three components nor a rotation; the text lists those that are.
        """
        turning = [field for field in stream.fields if field.is_rotation or (field.frame and field.shape == (3,))]
        names = [field.name for field in turning]
        for name in self.fields:
            if name not in names:
                there = ", ".join(names) or "none"
                raise ValueError(f'no vector or rotation "{name}" to turn here, there are: {there}')
        first, *more = (k for k, field in enumerate(stream.fields) if field.name in self.fields)
        drawn = (rad(self.sigma_deg) * draw_normals(stream.key, 3)).tolist()
        roll, pitch, yaw = (rad(angle) + error for angle, error in zip(self.rpy_deg, drawn, strict=True))
        return _Misalignment(MISALIGNMENT, stream, first, memory=Turn(quat_from_rpy(roll, pitch, yaw)), more=more)


_Part = Annotated[float, Meta(ge=-1.001, le=1.001)]


class Turn(Memory):
    """The error of the mounting.

    Attributes:
        q: unit quaternion from the real axes to those of the table.
    """

    q: tuple[_Part, _Part, _Part, _Part] = IDENTITY


class _Misalignment(Operation):
    def valid(self, record: Memory) -> None:
        super().valid(record)
        assert isinstance(record, Turn)
        if abs(math.hypot(*record.q) - 1.0) > 1e-3:
            raise ValueError(f'"q" is no rotation: {record.q}')


@compiled
def misalign(op: Any, numbers: Array, row: Array) -> None:
    """Turn the field: a rotation if it has four components, otherwise a vector. Remembers `Turn`."""
    w, x, y, z = numbers[op.memory], numbers[op.memory + 1], numbers[op.memory + 2], numbers[op.memory + 3]
    k = op.first
    if op.count == 4:
        a, b, c, d = row[k], row[k + 1], row[k + 2], row[k + 3]
        row[k] = a * w - b * x - c * y - d * z
        row[k + 1] = a * x + b * w + c * z - d * y
        row[k + 2] = a * y - b * z + c * w + d * x
        row[k + 3] = a * z + b * y - c * x + d * w
        return
    # This is `frames.rotate` by the conjugate.
    u, v, s = row[k], row[k + 1], row[k + 2]
    tx, ty, tz = 2.0 * (z * v - y * s), 2.0 * (x * s - z * u), 2.0 * (y * u - x * v)
    row[k] = u + w * tx + z * ty - y * tz
    row[k + 1] = v + w * ty + x * tz - z * tx
    row[k + 2] = s + w * tz + y * tx - x * ty
