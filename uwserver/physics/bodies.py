"""All submerged bodies of a world: their arrays, and the calls into the compiled kernels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from typing import Any

import numpy as np

from uwserver.physics import entries
from uwserver.physics.collision.contacts import Collider, Contacts, Impulses
from uwserver.physics.contact.touching import Touching
from uwserver.physics.dynamics.body_rows import appended, rows_of, table_numbers
from uwserver.physics.dynamics.params import BodyParams, ForceTable, Lag, body_row, lag_row, table_row
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray, Records, joined
from uwserver.physics.kernel.team import ALONE
from uwserver.physics.saved_rows import check_rows

_RUNNING = ("state", "bodies", "thrusters", "wrenches", "servos", "contact_nu_dot")
"""Arrays that change in a run."""
HELD = 2
"""Value of `retired` in the row of a body that stays where it is; 1 is that of a removed body. The kernels skip all rows in which it is not 0."""
Saved = dict[str, bytes]
"""All arrays that change in a run, by name, including those of the contacts."""


class Hydrodynamics:
    """The state and parameters of all bodies, one row each. It is not thread-safe: the simulation thread owns it.

    Attributes:
        state: (n, 13) p_NB (m), q_NB (w x y z), nu (m/s, rad/s).
        flows: (n, FLOW_SIZE) the water at each body (`layout`); filled before each use if there is a sea.
        floor: depth of the level bottom, m, for bodies that are added from now on; inf for none.
        params: parameters of each body as it was added; `change` does not alter them.
        thrusters, wrenches, servos: (m) rows of the thrusters, of the prescribed wrenches, and of the servos of fins, shafts and ballast
            (`layout`).
        collider: finds the contacts; None in open water.
        touching: the contacts of the last tick and of the coming one; `touched` returns those of the last one with their impulses.
        contact_nu_dot: (n, 6) mean acceleration by contacts in the last tick, in B.
        forces, values, scratch: work space of the kernels.
        team: the threads that share the loops of the kernels (`set_team`).
        table: addresses of all these arrays, for the kernels.
    """

    table: IntArray

    def __init__(self, bodies: Sequence[BodyParams], dt: float) -> None:
        self.dt = dt
        self.collider: Collider | None = None
        self._sea: layout.SeaRows | None = None
        self._wave_number, self.floor = 0.0, np.inf
        self._rows_of, self._table_row = cache(rows_of), cache(table_row)
        self._lag_row = cache(partial(lag_row, dt=dt))
        self._loaded: tuple[bool, ...] = ()
        self.team, self._threads = ALONE, 1
        self.set_bodies(bodies)

    def _clear(self) -> None:
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
        self.strips: Records = np.zeros(0, layout.STRIP)
        self.scratch: Records = np.zeros(self._threads, layout.SCRATCH)
        self.state: FloatArray = np.zeros((0, layout.STATE_SIZE))
        self.touching = Touching()
        self.contact_nu_dot: FloatArray = np.zeros((0, 6))
        self.flows: FloatArray = np.zeros((0, layout.FLOW_SIZE))
        self._gather()

    def __len__(self) -> int:
        return len(self.params)

    def add(self, body: BodyParams) -> int:
        """Append a body at rest at the origin and return its row. The rows of the other bodies stay as they are."""
        self._append((body,))
        return len(self.params) - 1

    def _append(self, bodies: Sequence[BodyParams]) -> None:
        count, first = len(bodies), len(self.thrusters)
        for name, rows in appended(vars(self), [self._rows_of(body, self._wave_number) for body in bodies]).items():
            setattr(self, name, rows)
        self.bodies["floor"][len(self.params) :] = self.floor
        known = len(self._tables), len(self._lags)
        numbers = table_numbers(bodies, self._tables, self._lags)
        self.thrusters["table"][first:], self.thrusters["lag"][first:] = numbers.T
        if known != (len(self._tables), len(self._lags)):
            self.tables = joined(map(self._table_row, self._tables), layout.TABLE)
            self.lags = joined(map(self._lag_row, self._lags), layout.LAG)
        rest = np.zeros((count, layout.STATE_SIZE))
        rest[:, layout.Q] = 1.0
        self.state = np.concatenate([self.state, rest])
        self.flows = np.concatenate([self.flows, np.zeros((count, layout.FLOW_SIZE))])
        self.contact_nu_dot = np.concatenate([self.contact_nu_dot, np.zeros((count, 6))])
        self.params = (*self.params, *bodies)
        self._gather()

    def change(self, row: int, body: BodyParams) -> None:
        """Give a body other masses, damping, weight and buoyancy from now on. Its thrusters, appendages and shapes stay."""
        self._set_body(row, body_row(body))

    def _set_body(self, row: int, new: Records) -> None:
        places = (name for name in layout.BODY.names or () if name.endswith(("_first", "_count")))
        for name in ("floor", "fitted", "retired", "external", "acted", *places):
            new[name] = self.bodies[name][row]
        self.bodies[row] = new[0]

    def retire(self, row: int) -> None:
        """Take a body out of the world. Its rows stay, at rest, so that the other bodies keep their rows, until `revive` uses them again."""
        self.bodies["retired"][row] = 1
        self.state[row] = 0.0
        self.state[row, layout.Q] = 1.0
        self.contact_nu_dot[row] = 0.0
        self.bodies["external"][row] = self.bodies["acted"][row] = 0.0
        self._forget_contacts(row)

    def hold(self, row: int) -> None:
        """Keep a body, which is at rest, at its present pose until `let_go`, whatever acts on it."""
        self.bodies["retired"][row] = HELD

    def let_go(self, row: int) -> None:
        """Let a held body move from the next tick on, with the velocity that it has: zero, unless it was hit in the last tick."""
        self.bodies["retired"][row] = 0

    def is_held(self, row: int) -> bool:
        """Return whether `hold` keeps a body at its pose."""
        return bool(self.bodies["retired"][row] == HELD)

    def revive(self, row: int) -> None:
        """Put a new body, made of the same parts, into the rows of one that was taken out, as if it were added now.

        All that changes gets new arrays, as when a body is added, so that `go_back` can undo it.
        """
        fresh = self._rows_of(self.params[row], self._wave_number)
        for name in _RUNNING:
            setattr(self, name, getattr(self, name).copy())
        self._set_body(row, fresh.bodies.copy())
        self.bodies["retired"][row] = 0
        thrusters, first = fresh.thrusters.copy(), int(self.bodies["thruster_first"][row])
        for name in ("table", "lag"):
            thrusters[name] = self.thrusters[name][first : first + len(thrusters)]
        for kind, array, new in (
            ("thruster", self.thrusters, thrusters),
            ("wrench", self.wrenches, fresh.wrenches),
            ("servo", self.servos, fresh.servos),
        ):
            first = int(self.bodies[f"{kind}_first"][row])
            array[first : first + len(new)] = new
        self._gather()

    def set_bodies(self, params: Sequence[BodyParams]) -> None:
        """Replace all bodies by these, in this order, at rest at the origin. The rows are the same as if the bodies were added one by one."""
        self._clear()
        self._append(params)

    def arrays(self) -> dict[str, Any]:
        """Return all rows as they are, for `go_back`. Adding bodies makes new arrays and leaves these unchanged."""
        rows = ((name, value) for name, value in self.__dict__.items() if name not in ("collider", "_sea"))
        return {name: dict(value) if isinstance(value, dict) else value for name, value in rows}

    def go_back(self, arrays: dict[str, Any]) -> None:
        """Undo all that was added since `arrays` returned these."""
        self.__dict__.update(arrays)

    def save(self) -> Saved:
        """Return copies of all arrays that change in a run. The water at the bodies is not one of them."""
        return {name: array.tobytes() for name, array in self._running()}

    def check(self, saved: Saved) -> None:
        """Refuse saved arrays from outside that cannot belong to these bodies.

        Raises:
            ValueError: other names or lengths, a number that must be finite and is not, a quaternion that is no rotation, or rows of other
                bodies.
        """
        running = dict(self._running())
        if saved.keys() != running.keys():
            raise ValueError("other arrays than those of bodies and contacts")
        k, rest = divmod(len(saved["gap"]), 8)
        for name, array in running.items():
            count = k if name in _CONTACTS else len(array)
            size = count * array.dtype.itemsize * int(np.prod(array.shape[1:]))
            if rest or len(saved[name]) != size:
                raise ValueError(f'{len(saved[name])} bytes of "{name}", not {size}')
            check_rows(name, np.frombuffer(saved[name], array.dtype), array)
        q = np.frombuffer(saved["state"]).reshape(-1, layout.STATE_SIZE)[:, layout.Q : layout.Q + 4]
        # The bound comes first, as the square of a huge number would overflow.
        if (np.abs(q) > 2.0).any() or (np.abs(np.linalg.norm(q, axis=1) - 1.0) > 1e-6).any():
            raise ValueError("a quaternion that is no rotation")
        for name in ("body_a", "body_b"):
            rows = np.frombuffer(saved[name], np.int64)
            if ((rows < -1) | (rows >= len(self))).any():
                raise ValueError(f'a row in "{name}" that is no body\'s')

    @staticmethod
    def check_sizes(saved: Saved, bodies: Sequence[BodyParams]) -> None:
        """Refuse saved arrays with another number of rows than these bodies have, before any body is made.

        Raises:
            ValueError: another number of rows.
        """
        counts = {
            "state": (len(bodies), 8 * layout.STATE_SIZE),
            "bodies": (len(bodies), layout.BODY.itemsize),
            "thrusters": (sum(len(body.thrusters) for body in bodies), layout.THRUSTER.itemsize),
        }
        for name, (count, size) in counts.items():
            if len(saved.get(name, b"")) != count * size:
                raise ValueError(f'"{name}" has not {count} rows')

    def load(self, saved: Saved) -> None:
        """Put all saved arrays back, bit for bit. `check` must have accepted them."""
        for name in _RUNNING:
            # Copied as plain bytes, because numpy copies records field by field.
            getattr(self, name).reshape(-1).view(np.uint8)[:] = np.frombuffer(saved[name], np.uint8)
        found = {
            name: np.frombuffer(saved[name], array.dtype).reshape(-1, *array.shape[1:]).copy()
            for name, array in self._running()
            if name in _CONTACTS
        }
        impulses = [found.pop(name) for name in _IMPULSES]
        self.touching = self.touching.with_room(len(found["gap"]))
        self.touching.keep(Impulses(Contacts(**found), *impulses))

    def _running(self) -> Iterator[tuple[str, Any]]:
        for name in _RUNNING:
            yield name, getattr(self, name)
        yield from self.touched.contacts._asdict().items()
        yield from zip(_IMPULSES, self.touched[1:], strict=True)

    def _forget_contacts(self, row: int) -> None:
        """Drop the contacts of a body. This makes new arrays, so that `go_back` can undo it."""
        self.touching = self.touching.without(row)
        if not self.touching.is_kept:
            self.contact_nu_dot = np.zeros_like(self.contact_nu_dot)

    def set_team(self, team: IntArray, threads: int) -> None:
        """Let several threads share the loops over bodies; `team` is the array of numbers of a `Team`."""
        self.team, self._threads, self.scratch = team, threads, np.zeros(threads, layout.SCRATCH)
        self._gather()

    def move(self, place: Callable[[Any], Any]) -> None:
        """Move all arrays that a tick writes to other memory; `place` returns a copy of an array there."""
        for name in (*_RUNNING, "flows", "forces", "values"):
            setattr(self, name, place(getattr(self, name)))
        self._tabulate()
        self.table = place(self.table)

    def _gather(self) -> None:
        """Make the work arrays, and the table by which kernels find all rows. The arrays change only if a body is added."""
        self.forces, self.values = np.zeros((len(self.thrusters), 3)), np.zeros((len(self.servos), 3))
        self._tabulate()

    def _tabulate(self) -> None:
        self.table = layout.addresses(layout.WORLD, vars(self))
        self._fitted = any(len(getattr(self, name)) for name in layout.Fitted._fields if name != "values")

    @property
    def sea(self) -> layout.SeaRows | None:
        """Water that moves otherwise than uniformly and steadily; None for none. Its shortest wave decides the number of strips of long hulls."""
        return self._sea

    @sea.setter
    def sea(self, sea: layout.SeaRows | None) -> None:
        waves = np.zeros((0, layout.WAVE_SIZE)) if sea is None else sea.waves
        self._sea = sea
        self._wave_number = float(np.max(waves[:, layout.WAVE_K], initial=0.0))
        strips = [self._rows_of(body, self._wave_number).strips for body in self.params]
        counts = np.array([len(rows) for rows in strips], np.int64)
        self.strips = joined(strips, layout.STRIP)
        self.bodies["strip_count"], self.bodies["strip_first"] = counts, np.cumsum(counts) - counts
        self._gather()

    @property
    def currents(self) -> FloatArray:
        """View (n, 3) of the water velocity at each body in N, m/s. With a sea it holds for the instant for which the water was last found."""
        return self.flows[:, layout.FLOW_V : layout.FLOW_V + 3]

    @property
    def external(self) -> FloatArray:
        """View (n, 6) of the external wrench on each body in the coming tick: force (N) and moment about the body origin (N m), in B.

        To act on a body from outside, add to it before the bodies move: ``hydro.external[row] += wrench``. It is constant within the tick, acts in
        free motion and in contact, and is zero again afterwards; `rates_of_change` includes it until the end of the next tick.
        """
        external: FloatArray = self.bodies["external"]
        return external

    @property
    def is_fitted(self) -> bool:
        """Whether a body has appendages."""
        return self._fitted

    @property
    def touched(self) -> Impulses:
        """The contacts of the last tick and their impulses: views that are valid until the next tick."""
        return self.touching.kept

    def find_contacts(self) -> None:
        """Find with the collider all contacts that are closed or may close in the coming tick."""
        assert self.collider is not None
        contacts = self.collider.find_contacts(self.state, self.dt)
        self.touching = self.touching.with_room(len(contacts.gap))
        self.touching.find(contacts)

    def advance(self, t: float) -> int:
        """Move all bodies from t to t + dt (s). Return -1, or the row of the first body whose state is not finite."""
        self.fill_flows(t, 0.5 * self.dt)
        if self.collider is not None:
            self.find_contacts()
        lost: int = entries.carry()(*self._given(), t, self.dt)
        return lost

    def _given(self) -> tuple[layout.Codes, IntArray, IntArray, FloatArray]:
        """Return the arguments of the kernels that move bodies."""
        codes = entries.codes(self._fitted, self.collider is not None)
        return codes, self.table, self.touching.table, self.contact_nu_dot

    def rates_of_change(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Return nu_dot (n, 6) in B and the applied wrench (n, 6) about the origin in B, at the present state.

        nu_dot contains the mean acceleration by the contacts of the last tick, as an accelerometer measures it, and the effect of the external
        wrench. The wrench is that of thrusters, prescribed rows and the external one.
        """
        nu_dot, tau = np.empty((len(self), 6)), np.empty((len(self), 6))
        self.fill_flows(t)
        entries.find_rates()(*self._given(), t, nu_dot, tau)
        return nu_dot, tau

    def load_kernels(self) -> None:
        """Load or compile the kernels now instead of in the first tick. It is done once for all worlds of the same kind."""
        needed = (self._fitted, self.collider is not None, self.sea is not None)
        if needed == self._loaded:
            return
        self._loaded = needed
        entries.codes(self._fitted, self.collider is not None)
        if self.collider is not None:
            self.collider.find_contacts(self.state, self.dt)  # this also makes the arrays of the collider
        if self.sea is not None:
            entries.flow_code()

    def fill_flows(self, t: float, ahead: float = 0.0) -> None:
        """Find the water at each body, `ahead` seconds after t on its path. Do nothing without a sea."""
        if self._sea is not None:
            entries.sea().fill_flows(self.table, self._sea, t, ahead)

    def kinetic_energy(self) -> FloatArray:
        """Return the kinetic energy (n) of bodies and water, J: (nu^T M_RB nu + nu_r^T M_A nu_r) / 2, fully submerged."""
        from uwserver.physics.dynamics.energy import kinetic_energy

        return kinetic_energy(self.bodies, self.state, self.currents)


_IMPULSES = Impulses._fields[1:]
_CONTACTS = (*Contacts._fields, *_IMPULSES)
