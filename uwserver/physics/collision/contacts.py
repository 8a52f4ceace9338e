"""Contact points between bodies, and the impulses in them: what the collision engine finds and what the solver keeps from tick to tick."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray, IntArray

NUMBERS = 7
"""Columns of a contact on its way: point (3) midway between the surfaces, normal (3) from b to a, gap."""


class Contacts(NamedTuple):
    """Points where bodies touch or may touch within the tick; k of them, in an order that depends on the poses alone.

    Attributes:
        body_a, body_b: (k) rows of the two bodies; `body_b` is -1 for what does not move.
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
    """Finds contacts. A pure function of its arguments: the same poses give the same contacts, bit for bit, whatever was asked before."""

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        """Contacts that are closed or may close within `dt` (s).

        Args:
            state: (n, 13) p_NB, q_NB (w x y z), nu of all bodies.
            dt: length of the tick, s.
        """


class Impulses(NamedTuple):
    """What a tick's contacts carried, and the next tick starts from.

    Attributes:
        contacts: where.
        impulse: (k, 3) on body a, in N, N s.
        hold: (k, 3) likewise, without hits: where the next tick starts from.
    """

    contacts: Contacts
    impulse: FloatArray
    hold: FloatArray


NO_IMPULSES = Impulses(NO_CONTACTS, np.zeros((0, 3)), np.zeros((0, 3)))


class Finding(NamedTuple):
    """What compiled code needs to look for contacts, as `Solids.find_contacts` does where no engine has to be asked; until something comes or goes.

    Attributes:
        find_pairs, find_lines, find_contacts: where the code of the stages lies (`kernel.calling`): of `broad_phase`, `directions`, `narrow_phase`.
        table: of the shapes.
        margin: of the search, m.
        pairs, line_first, lines, overlapping: what the first two receive.
        bodies, numbers, keys, coefficients: what the last one receives.
        led: rows of bodies that yield to nothing, which have no contacts with what does not move, nor with their like.
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


_NO_TABLE: IntArray = np.zeros((0, 2), np.int64)
NO_FINDING = Finding(
    0, 0, 0, _NO_TABLE, 0.0, _NO_TABLE, np.zeros(1, np.int64), np.zeros((0, 7)), np.zeros(0, np.bool_), _NO_TABLE, np.zeros((0, NUMBERS)), _NO_ROWS,
    np.zeros((0, 2)), _NO_ROWS,
)  # fmt: skip
"""Where nothing can touch anything."""
