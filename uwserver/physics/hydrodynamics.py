"""All submerged bodies of a world: their arrays, and the calls into the compiled kernel."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from types import ModuleType

import numpy as np

from uwserver.physics import layout
from uwserver.physics.bodies import (
    BodyParams,
    FloatArray,
    ForceTable,
    Records,
    body_row,
    concatenate,
    lag_row,
    shape_rows,
    table_row,
    thruster_row,
    wrench_rows,
)
from uwserver.physics.contact import NO_CONTACTS, NO_IMPULSES, Collider, Contacts, Impulses
from uwserver.physics.lag import Lag


@cache
def _kernel() -> ModuleType:
    """The compiled functions, loaded at the first step: they cost half a second, and `import uwserver` must stay quick."""
    from uwserver.physics import integrator

    return integrator


@cache
def _contact_kernel() -> ModuleType:
    """Likewise, at the first contact: most worlds have none."""
    from uwserver.physics import touching

    return touching


class Hydrodynamics:
    """State and parameters of all bodies, one row each. Not thread-safe: owned by the simulation thread.

    Attributes:
        state: (n, 13) p_NB (m), q_NB (w x y z), nu (m/s, rad/s).
        currents: (n, 3) water velocity at each body in N, m/s.
        thrusters, wrenches: (m) rows of the commanded propulsors and prescribed wrenches (`layout`).
        collider: finds contacts; None in open water.
        touched: contacts of the last tick and their impulses.
        contact_nu_dot: (n, 6) mean acceleration by contacts in the last tick, in B.
    """

    def __init__(self, bodies: Sequence[BodyParams], dt: float) -> None:
        self.dt = dt
        self._params: tuple[BodyParams, ...] = ()
        self._tables: dict[ForceTable, int] = {}
        self._lags: dict[Lag, int] = {}
        self.bodies: Records = np.zeros(0, layout.BODY)
        self.shapes: Records = np.zeros(0, layout.SHAPE)
        self.thrusters: Records = np.zeros(0, layout.THRUSTER)
        self.wrenches: Records = np.zeros(0, layout.WRENCH)
        self.tables: Records = np.zeros(0, layout.TABLE)
        self.lags: Records = np.zeros(0, layout.LAG)
        self.state: FloatArray = np.zeros((0, layout.STATE_SIZE))
        self.currents: FloatArray = np.zeros((0, 3))
        self.collider: Collider | None = None
        self.touched: Impulses = NO_IMPULSES
        self.contact_nu_dot: FloatArray = np.zeros((0, 6))
        for body in bodies:
            self.add(body)

    def __len__(self) -> int:
        return len(self._params)

    def add(self, body: BodyParams) -> int:
        """Append a body at rest at the origin; the rows of the others stay as they are. Returns its row."""
        row = body_row(body)
        row["shape_first"], row["shape_count"] = len(self.shapes), len(body.shapes)
        row["thruster_first"], row["thruster_count"] = len(self.thrusters), len(body.thrusters)
        row["wrench_first"], row["wrench_count"] = len(self.wrenches), body.wrenches
        for thruster in body.thrusters:
            self._tables.setdefault(thruster.table, len(self._tables))
            self._lags.setdefault(thruster.lag, len(self._lags))
        self.tables = concatenate([table_row(table) for table in self._tables], layout.TABLE)
        self.lags = concatenate([lag_row(lag, self.dt) for lag in self._lags], layout.LAG)
        thrusters = [thruster_row(t, self._tables[t.table], self._lags[t.lag]) for t in body.thrusters]
        self.bodies = np.concatenate([self.bodies, row])
        self.shapes = np.concatenate([self.shapes, shape_rows(body)])
        self.thrusters = np.concatenate([self.thrusters, concatenate(thrusters, layout.THRUSTER)])
        self.wrenches = np.concatenate([self.wrenches, wrench_rows(body.wrenches)])
        rest = np.zeros((1, layout.STATE_SIZE))
        rest[0, layout.Q] = 1.0
        self.state = np.concatenate([self.state, rest])
        self.currents = np.concatenate([self.currents, np.zeros((1, 3))])
        self.contact_nu_dot = np.concatenate([self.contact_nu_dot, np.zeros((1, 6))])
        self._params = (*self._params, body)
        return len(self._params) - 1

    @property
    def rows(self) -> layout.Rows:
        """All rows of the world, as the kernel takes them."""
        return layout.Rows(self.bodies, self.shapes, self.thrusters, self.tables, self.lags, self.wrenches)

    def advance(self, t: float) -> int:
        """Carry all bodies from t to t + dt (s). Returns -1, or the row of the first body whose state is not finite."""
        if self.collider is not None:
            contacts = self.collider.find_contacts(self.state, self.dt)
            if len(contacts.gap):
                return self._advance_touching(contacts, t)
            if len(self.touched.impulse):
                self.touched = NO_IMPULSES
                self.contact_nu_dot[:] = 0.0
        return self._advance_free(t)

    def _advance_free(self, t: float) -> int:
        return int(_kernel().advance(self.rows, self.state, self.currents, t, self.dt))

    def _advance_touching(self, contacts: Contacts, t: float) -> int:
        """The stages are told in `touching`."""
        kernel, old = _contact_kernel(), self.touched
        trial = self.rows._replace(thrusters=self.thrusters.copy())
        struck = kernel.strike(trial, self.state, self.currents, contacts, old.contacts.key, old.impulse, t, self.dt)
        diverged = self._advance_free(t)
        if diverged < 0:
            self.touched = Impulses(contacts, np.empty((len(contacts.gap), 3)))
            kernel.settle(struck, self.state, contacts, self.dt, self.touched.impulse, self.contact_nu_dot)
        return diverged

    def rates_of_change(self, t: float) -> tuple[FloatArray, FloatArray]:
        """nu_dot (n, 6) in B, and the applied wrench (n, 6) about the origin in B, at the present state.

        nu_dot holds the mean of the last tick's contacts, as an accelerometer would; the wrench is that of thrusters and prescribed rows.
        """
        nu_dot, tau = np.empty((len(self), 6)), np.empty((len(self), 6))
        _kernel().rates_of_change(self.rows, self.state, self.currents, t, nu_dot, tau)
        if len(self.touched.impulse):
            nu_dot += self.contact_nu_dot
        return nu_dot, tau

    def load_kernels(self) -> None:
        """Load the compiled kernels, or compile them, now rather than in the first tick; runs them on no bodies at all."""
        nothing = Hydrodynamics((), self.dt)
        nothing.advance(0.0)
        nothing.rates_of_change(0.0)
        if self.collider is not None:
            nothing._advance_touching(NO_CONTACTS, 0.0)

    def kinetic_energy(self) -> FloatArray:
        """(n) kinetic energy of bodies and water, J: (nu^T M_RB nu + nu_r^T M_A nu_r) / 2, fully submerged."""
        from uwserver.physics.energy import kinetic_energy

        return kinetic_energy(self.bodies, self.state, self.currents)
