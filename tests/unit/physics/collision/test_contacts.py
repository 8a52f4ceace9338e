"""No contacts: the columns that a solver is compiled for."""

from __future__ import annotations

import numpy as np

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.collision.contacts import NO_CONTACTS, NO_IMPULSES, Contacts
from uwserver.physics.collision.solids import Solids
from uwserver.physics.geometry.shapes import HalfSpace, Placed, Solid, Sphere


def test_no_contacts_have_the_types_of_some() -> None:
    """Else the first contact of a run would compile a second solver."""
    with Solids() as solids:
        solids.add_static(Solid("ground", (Placed(HalfSpace()),)))
        solids.add_moving(Solid("ball", (Placed(Sphere(1.0)),)), 0)
        state = np.zeros((1, 13))
        state[0, 2], state[0, 3] = -1.0, 1.0
        some = solids.find_contacts(state, 0.01)
    assert len(some.gap) == 1
    for name in Contacts._fields:
        ours, theirs = getattr(NO_CONTACTS, name), getattr(some, name)
        assert (ours.dtype, ours.shape[1:], ours.flags.c_contiguous) == (
            theirs.dtype,
            theirs.shape[1:],
            theirs.flags.c_contiguous,
        ), name
        assert len(ours) == 0
    assert NO_IMPULSES.impulse.shape == (0, 3)


def test_a_world_begins_with_none() -> None:
    assert Hydrodynamics((), 0.01).touched is NO_IMPULSES
