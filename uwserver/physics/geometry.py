"""What sensors and the contact solver may ask of solid things. The engines behind it are chosen at load; nothing here imports one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


class Hits(NamedTuple):
    """First thing that each ray meets.

    Attributes:
        distance: (n) m; inf where nothing is hit.
        normal: (n, 3) outward unit normal in N; zeros where nothing is hit.
        body: (n) id of what is hit; -1 for nothing.
        material: (n) number of its material; -1 for nothing.
    """

    distance: FloatArray
    normal: FloatArray
    body: IntArray
    material: IntArray


class Geometry(Protocol):
    """Solid things at one instant."""

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """Cast rays.

        Args:
            origin: (n, 3) starts in N, m.
            direction: (n, 3) unit directions in N.
            max_range: m; farther things are not seen.
        """


def no_hits(n: int) -> Hits:
    """The answer to n rays that meet nothing; its arrays may be filled in."""
    nothing = np.full(n, -1, dtype=np.int64)
    return Hits(np.full(n, np.inf), np.zeros((n, 3)), nothing, nothing.copy())


class OpenWater:
    """A world without anything solid."""

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """Nothing is hit."""
        return no_hits(len(origin))


@dataclass(frozen=True, eq=False)
class Contacts:
    """Where bodies touch, or may touch within a tick; a pure function of the state, in an order that depends on nothing else.

    Attributes:
        body_a: (k) row of the body in the state array.
        body_b: (k) row of the other body; -1 for something static.
        point: (k, 3) in N, m: midway between the two surfaces.
        normal: (k, 3) unit, in N, from b towards a.
        gap: (k) m along the normal; negative where they penetrate.
        key: (k) the same for the same pair of features from tick to tick, for warm starting.
        friction: (k) geometric mean of the two.
        restitution: (k) the larger of the two.
    """

    body_a: IntArray
    body_b: IntArray
    point: FloatArray
    normal: FloatArray
    gap: FloatArray
    key: IntArray
    friction: FloatArray
    restitution: FloatArray

    def __len__(self) -> int:
        return len(self.gap)


_NO_ROWS = np.zeros(0, dtype=np.int64)
NO_CONTACTS = Contacts(
    _NO_ROWS, _NO_ROWS, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), _NO_ROWS, np.zeros(0), np.zeros(0)
)
