"""Contact points between bodies, the impulses in them, and the data with which compiled code finds contacts."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray, IntArray

NUMBERS = 7
"""Columns of a contact before it becomes part of `Contacts`: point (3) midway between the surfaces, normal (3) from b to a, gap."""
_NO_TABLE: IntArray = np.zeros((0, 2), np.int64)


class Contacts(NamedTuple):
    """Points where bodies touch or may touch within the tick: k contacts, in an order that depends on the poses alone.

    Attributes:
        body_a, body_b: (k) rows of the two bodies; `body_b` is -1 for a static solid.
        point: (k, 3) in N, m: midway between the two surfaces.
        normal: (k, 3) unit vector in N, from b towards a.
        gap: (k) distance along the normal, m; negative where they penetrate.
        key: (k) identifies the same contact in two successive ticks.
        friction, restitution: (k) geometric mean, and the larger, of the two.
    """

    body_a: IntArray
    body_b: IntArray
    point: FloatArray
    normal: FloatArray
    gap: FloatArray
    key: IntArray
    friction: FloatArray
    restitution: FloatArray


_NO_ROWS: IntArray = np.zeros(0, np.int64)
NO_CONTACTS = Contacts(
    _NO_ROWS, _NO_ROWS, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), _NO_ROWS, np.zeros(0), np.zeros(0)
)


class Collider(Protocol):
    """Finds contacts. The result depends on the arguments alone: the same poses give the same contacts, bit for bit."""

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        """Return the contacts that are closed or may close within `dt` (s).

        Args:
            state: (n, 13) p_NB, q_NB (w x y z), nu of all bodies.
            dt: length of the tick, s.
        """


class Impulses(NamedTuple):
    """The impulses of a tick's contacts, with which the next tick starts.

    Attributes:
        contacts: the contacts.
        impulse: (k, 3) on body a, in N, N s.
        hold: (k, 3) likewise, without hits; the first guess of the next tick.
    """

    contacts: Contacts
    impulse: FloatArray
    hold: FloatArray


NO_IMPULSES = Impulses(NO_CONTACTS, np.zeros((0, 3)), np.zeros((0, 3)))


class Finding(NamedTuple):
    """The data with which compiled code finds contacts as `Solids.find_contacts` does, if no engine is needed. It is valid until a solid comes or
    goes.

    Attributes:
        find_pairs, find_lines, find_contacts: addresses of the code of the stages (`kernel.calling`) in `broad_phase`, `directions`, `narrow_phase`.
        table: table of the shapes.
        margin: margin of the search, m.
        pairs, line_first, lines, overlapping: results of the first two stages.
        bodies, numbers, keys, coefficients: results of the last stage.
        led: rows of bodies that do not yield; they have no contacts with static solids or with each other.
    """

    find_pairs: int
    find_lines: int
    find_contacts: int
    table: IntArray
    margin: float
    pairs: IntArray
    line_first: IntArray
    lines: FloatArray
    overlapping: Any
    bodies: IntArray
    numbers: FloatArray
    keys: IntArray
    coefficients: FloatArray
    led: IntArray


NO_FINDING = Finding(
    0, 0, 0, _NO_TABLE, 0.0, _NO_TABLE, np.zeros(1, np.int64), np.zeros((0, 7)), np.zeros(0, np.bool_), _NO_TABLE, np.zeros((0, NUMBERS)), _NO_ROWS,
    np.zeros((0, 2)), _NO_ROWS,
)  # fmt: skip
"""For a world in which nothing can touch."""
