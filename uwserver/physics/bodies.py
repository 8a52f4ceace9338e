"""All submerged bodies of a world: their arrays, and the calls into the compiled kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from types import ModuleType

import numpy as np

from uwserver.physics.collision.contacts import NO_CONTACTS, NO_IMPULSES, Collider, Contacts, Impulses
from uwserver.physics.dynamics.appendage_params import appendage_rows, servo_rows
from uwserver.physics.dynamics.lag import Lag
from uwserver.physics.dynamics.params import (
    BodyParams,
    ForceTable,
    body_row,
    concatenate,
    lag_row,
    shape_rows,
    table_row,
    thruster_row,
    wrench_rows,
)
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, Records


@cache
def _kernel() -> ModuleType:
    """The compiled functions, loaded at the first step: they cost half a second, and `import uwserver` must stay quick."""
    from uwserver.physics.dynamics import integrator

    return integrator


@cache
def _contact_kernel() -> ModuleType:
    """Likewise, at the first contact: most worlds have none."""
    from uwserver.physics.contact import step

    return step


@cache
def _sea_kernel() -> ModuleType:
    """As `_kernel`, for a sea."""
    from uwserver.physics.dynamics import flow

    return flow


_RUNNING = ("state", "bodies", "thrusters", "wrenches", "servos", "contact_nu_dot")
"""Arrays that change in a run."""
_FIXED = ("shapes", "tables", "lags", "foils", "propellers", "weights", "derivatives", "hulls")
"""Arrays that only `add` changes, by making new ones."""


@dataclass(frozen=True, eq=False)
class Saved:
    """All rows of a world at an instant; equal if their bits are.

    Attributes:
        params, tables, lags, fixed: what only `add` changes.
        running: copies of the other arrays.
        touched: contacts of the last tick.
    """

    params: tuple[BodyParams, ...]
    tables: dict[ForceTable, int]
    lags: dict[Lag, int]
    fixed: tuple[Records, ...]
    running: tuple[Records | FloatArray, ...]
    touched: Impulses

    def bits(self) -> tuple[bytes, ...]:
        """Everything that changes in a run."""
        arrays = (*self.running, *self.touched.contacts, self.touched.impulse)
        return tuple(array.tobytes() for array in arrays)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Saved) and self.bits() == other.bits()

    __hash__ = None  # type: ignore[assignment]  # as of any mutable thing


class Hydrodynamics:
    """State and parameters of all bodies, one row each. Not thread-safe: owned by the simulation thread.

    Attributes:
        state: (n, 13) p_NB (m), q_NB (w x y z), nu (m/s, rad/s).
        flows: (n, FLOW_SIZE) the water at each body (`layout`), filled before each use where there is a sea.
        sea: water that moves otherwise than uniformly and steadily; None for none.
        params: of each body, as added; `change` does not touch them.
        thrusters, wrenches, servos: (m) rows of the commanded propulsors, prescribed wrenches, and of what moves fins, shafts and ballast
            (`layout`).
        collider: finds contacts; None in open water.
        touched: contacts of the last tick and their impulses.
        contact_nu_dot: (n, 6) mean acceleration by contacts in the last tick, in B.
        forces, values, scratch: work space of the kernels.
    """

    def __init__(self, bodies: Sequence[BodyParams], dt: float) -> None:
        self.dt = dt
        self.params: tuple[BodyParams, ...] = ()
        self._tables: dict[ForceTable, int] = {}
        self._lags: dict[Lag, int] = {}
        self.bodies: Records = np.zeros(0, layout.BODY)
        self.shapes: Records = np.zeros(0, layout.SHAPE)
        self.thrusters: Records = np.zeros(0, layout.THRUSTER)
        self.wrenches: Records = np.zeros(0, layout.WRENCH)
        self.tables: Records = np.zeros(0, layout.TABLE)
        self.lags: Records = np.zeros(0, layout.LAG)
        self.servos: Records = np.zeros(0, layout.SERVO)
        self.foils: Records = np.zeros(0, layout.FOIL)
        self.propellers: Records = np.zeros(0, layout.PROPELLER)
        self.weights: Records = np.zeros(0, layout.WEIGHT)
        self.derivatives: Records = np.zeros(0, layout.DERIVATIVE)
        self.hulls: Records = np.zeros(0, layout.HULL)
        self.scratch: Records = np.zeros(1, layout.SCRATCH)
        self.state: FloatArray = np.zeros((0, layout.STATE_SIZE))
        self.collider: Collider | None = None
        self.touched: Impulses = NO_IMPULSES
        self.contact_nu_dot: FloatArray = np.zeros((0, 6))
        self.flows: FloatArray = np.zeros((0, layout.FLOW_SIZE))
        self.sea: layout.SeaRows | None = None
        self._gather()
        for body in bodies:
            self.add(body)

    def __len__(self) -> int:
        return len(self.params)

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
        self._append_appendages(body, row)
        self.bodies = np.concatenate([self.bodies, row])
        self.shapes = np.concatenate([self.shapes, shape_rows(body)])
        self.thrusters = np.concatenate([self.thrusters, concatenate(thrusters, layout.THRUSTER)])
        self.wrenches = np.concatenate([self.wrenches, wrench_rows(body.wrenches)])
        rest = np.zeros((1, layout.STATE_SIZE))
        rest[0, layout.Q] = 1.0
        self.state = np.concatenate([self.state, rest])
        self.flows = np.concatenate([self.flows, np.zeros((1, layout.FLOW_SIZE))])
        self.contact_nu_dot = np.concatenate([self.contact_nu_dot, np.zeros((1, 6))])
        self.params = (*self.params, body)
        self._gather()
        return len(self.params) - 1

    def change(self, row: int, body: BodyParams) -> None:
        """Give a body other masses, damping, weight and buoyancy, from now on; its thrusters, appendages and shapes stay."""
        new = body_row(body)
        kept = (
            "fitted",
            "retired",
            "external",
            "acted",
            *(name for name in layout.BODY.names or () if name.endswith(("_first", "_count"))),
        )
        for name in kept:
            new[name] = self.bodies[name][row]
        self.bodies[row] = new[0]

    def retire(self, row: int) -> None:
        """Take a body out. Its rows stay, at rest, so that those of the others keep their places."""
        self.bodies["retired"][row] = 1
        self.state[row] = 0.0
        self.state[row, layout.Q] = 1.0
        self.contact_nu_dot[row] = 0.0
        self.bodies["external"][row] = self.bodies["acted"][row] = 0.0

    def save(self) -> Saved:
        """All rows as they are."""
        running = tuple(getattr(self, name).copy() for name in _RUNNING)
        fixed = tuple(getattr(self, name) for name in _FIXED)
        return Saved(self.params, dict(self._tables), dict(self._lags), fixed, running, self.touched)

    def load(self, saved: Saved) -> None:
        """Put all rows back, bit for bit; bodies that were added since are gone. The water at the bodies is not part of it."""
        if saved.params is not self.params:
            self.params, self._tables, self._lags = saved.params, dict(saved.tables), dict(saved.lags)
            for name, rows in zip(_FIXED, saved.fixed, strict=True):
                setattr(self, name, rows)
            for name, array in zip(_RUNNING, saved.running, strict=True):
                setattr(self, name, array.copy())
            self.flows = np.zeros((len(self), layout.FLOW_SIZE))
            self._gather()
        for name, array in zip(_RUNNING, saved.running, strict=True):
            getattr(self, name)[...] = array
        self.touched = saved.touched

    def _append_appendages(self, body: BodyParams, row: Records) -> None:
        """Rows of the body's appendages; their ranges go into its BODY row."""
        added = {"servos": servo_rows(body.appendages), **appendage_rows(body.appendages, len(self.servos))}
        for name, rows in added.items():
            present = getattr(self, name)
            kind = name.removesuffix("s")
            row[f"{kind}_first"], row[f"{kind}_count"] = len(present), len(rows)
            setattr(self, name, np.concatenate([present, rows]))

    def _gather(self) -> None:
        """The table by which kernels find all rows of the world; the arrays change only when a body is added."""
        self.forces, self.values = np.zeros((len(self.thrusters), 3)), np.zeros((len(self.servos), 3))
        self._table = layout.addresses(layout.WORLD, vars(self))

    @property
    def currents(self) -> FloatArray:
        """View (n, 3) of the water velocity at each body in N, m/s; with a sea, of the instant for which it was needed last."""
        return self.flows[:, layout.FLOW_V : layout.FLOW_V + 3]

    @property
    def external(self) -> FloatArray:
        """View (n, 6) of the external wrench on each body in the coming tick: force (N) and moment about the body origin (N m), in B.

        Whoever acts on bodies from outside adds to it before the bodies move: ``hydro.external[row] += wrench``. It is constant within the tick,
        acts in free motion and in contact, and is zero again after it; `rates_of_change` shows it until the end of the next tick.
        """
        external: FloatArray = self.bodies["external"]
        return external

    def advance(self, t: float) -> int:
        """Carry all bodies from t to t + dt (s). Returns -1, or the row of the first body whose state is not finite."""
        if self.sea is not None:
            _sea_kernel().fill_flows(self.bodies, self.state, self.sea, t, 0.5 * self.dt, self.flows)
        if self.collider is not None:
            contacts = self.collider.find_contacts(self.state, self.dt)
            if len(contacts.gap):
                return self._advance_touching(contacts, t)
            if len(self.touched.impulse):
                self.touched = NO_IMPULSES
                self.contact_nu_dot[:] = 0.0
        return self._advance_free(t)

    def _advance_free(self, t: float) -> int:
        return int(_kernel().advance(self._table, t, self.dt))

    def _advance_touching(self, contacts: Contacts, t: float) -> int:
        """The stages are those of `contact.step`."""
        kernel, old = _contact_kernel(), self.touched
        struck = kernel.strike(self._table, contacts, old.contacts.key, old.impulse, t, self.dt)
        diverged = self._advance_free(t)
        if diverged < 0:
            self.touched = Impulses(contacts, np.empty((len(contacts.gap), 3)))
            kernel.settle(self._table, struck, contacts, self.dt, self.touched.impulse, self.contact_nu_dot)
        return diverged

    def rates_of_change(self, t: float) -> tuple[FloatArray, FloatArray]:
        """nu_dot (n, 6) in B, and the applied wrench (n, 6) about the origin in B, at the present state.

        nu_dot holds the mean of the last tick's contacts, as an accelerometer would, and its external wrench; the wrench is that of thrusters,
        prescribed rows and the external one.
        """
        nu_dot, tau = np.empty((len(self), 6)), np.empty((len(self), 6))
        if self.sea is not None:
            _sea_kernel().fill_flows(self.bodies, self.state, self.sea, t, 0.0, self.flows)
        _kernel().rates_of_change(self._table, t, nu_dot, tau)
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
        if self.sea is not None:
            nothing.sea = self.sea
            nothing.advance(0.0)

    def kinetic_energy(self) -> FloatArray:
        """(n) kinetic energy of bodies and water, J: (nu^T M_RB nu + nu_r^T M_A nu_r) / 2, fully submerged."""
        from uwserver.physics.dynamics.energy import kinetic_energy

        return kinetic_energy(self.bodies, self.state, self.currents)
