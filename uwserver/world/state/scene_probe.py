"""The state of the scene (poses and actuators) for viewers. It is taken between two ticks on request, so it costs nothing without a viewer."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import ThrusterParams
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.layout import P, Q
from uwserver.ports import ACHIEVED_FULL, EntityList, Present, SceneState
from uwserver.world.bodies.members import Member
from uwserver.world.world import World


@runtime_checkable
class ExternalOutputs(Protocol):
    """A part of a body whose actuators are not simulated here: their outputs come from outside."""

    def achieved(self, t_ns: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int8]]:
        """Return the outputs of its actuators at a simulation time, each -127..127; always the same number of them."""


class Rows(NamedTuple):
    """Where the numbers of a scene state stand in the arrays of the kernel.

    Attributes:
        bodies: rows of vehicles, then of objects.
        thrusters, servos: rows of the vehicles' actuators.
        full: (m, 2) thrust of each thruster at full command ahead and astern, N, both positive.
        places, servo_places: places of their outputs in `SceneState.achieved`.
        external: parts with outputs from outside, and where their outputs begin.
        total: number of outputs.
    """

    bodies: IntArray
    thrusters: IntArray
    servos: IntArray
    full: FloatArray
    places: IntArray
    servo_places: IntArray
    external: tuple[tuple[ExternalOutputs, int], ...] = ()
    total: int = 0


class SceneProbe:
    """Takes the state of the scene of a world, between two ticks."""

    def __init__(self, world: World) -> None:
        """Take the world whose scene is shown."""
        self._world = world
        self._members: tuple[Member, ...] | None = None
        self._entities = EntityList(0, (), ())
        self._rows = rows_of(world.hydro, (), 0)
        self._current = world.water.current

    def state(self) -> SceneState:
        """Return where all bodies are now, and the outputs of their actuators."""
        world = self._world
        members = tuple(world.members.values())
        if members != self._members:
            self._follow(members)
        if world.water.current != self._current:
            # A service or a restored state has changed the current, so the description that viewers have is out of date.
            self._current = world.water.current
            self._entities = self._entities._replace(revision=self._entities.revision + 1)
        hydro, rows = world.hydro, self._rows
        poses = hydro.state[rows.bodies, P : Q + 4]
        return SceneState(self._entities, world.t_ns, poses, achieved(hydro, rows, world.t_ns), world.water.current)

    def _follow(self, members: tuple[Member, ...]) -> None:
        """Make the list of bodies and their rows again, after bodies were added or removed."""
        population = self._world.population
        likes = {} if population is None else population.likes()
        vehicles = [member for member in members if not member.is_object]
        objects = [member for member in members if member.is_object]
        here = [
            tuple(Present(m.vehicle.name, likes.get(m.vehicle.name, m.vehicle.name)) for m in group)
            for group in (vehicles, objects)
        ]
        self._members = members
        self._entities = EntityList(self._entities.revision + 1, here[0], here[1])
        self._rows = rows_of(self._world.hydro, (*vehicles, *objects), len(vehicles))


def rows_of(hydro: Hydrodynamics, members: tuple[Member, ...], vehicles: int) -> Rows:
    """Return the rows of some bodies, of which the first `vehicles` are vehicles."""
    bodies = np.array([member.vehicle.row for member in members], dtype=np.int64)
    thrusters: list[tuple[int, int]] = []
    servos: list[tuple[int, int]] = []
    full: list[tuple[float, float]] = []
    count = 0
    external: list[tuple[ExternalOutputs, int]] = []
    for member, row in zip(members[:vehicles], bodies[:vehicles].tolist(), strict=True):
        params, body = hydro.params[row], hydro.bodies[row]
        first, first_servo = int(body["thruster_first"]), int(body["servo_first"])
        for k, thruster in enumerate(params.thrusters):
            thrusters.append((first + k, count))
            full.append(full_thrust(thruster))
            count += 1
        for k in range(len(params.appendages.servos)):
            servos.append((first_servo + k, count))
            count += 1
        for part in member.others:
            if isinstance(part, ExternalOutputs):
                external.append((part, count))
                count += len(part.achieved(0))
    thruster_rows, places = np.array(thrusters, np.int64).reshape(-1, 2).T
    servo_rows, servo_places = np.array(servos, np.int64).reshape(-1, 2).T
    whole = np.array(full, np.float64).reshape(-1, 2)
    return Rows(bodies, thruster_rows, servo_rows, whole, places, servo_places, tuple(external), count)


def full_thrust(thruster: ThrusterParams) -> tuple[float, float]:
    """Return the thrust at full command and nominal supply, ahead and astern, N, both positive."""
    voltages, curves = thruster.table.voltages, thruster.table.curves
    ends = [np.interp(thruster.voltage, voltages, [curve[k][1] for curve in curves]) for k in (-1, 0)]
    ahead, astern = (max(abs(float(force)) * thruster.installed, 1e-9) for force in ends)
    return ahead, astern


def achieved(hydro: Hydrodynamics, rows: Rows, t_ns: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int8]]:
    """Return the outputs of all actuators, -127..127: for thrusters the thrust after the lag divided by that at full command, for servos
    the place within their range. Outputs from outside are those of the given time."""
    parts = np.zeros(rows.total)
    if len(rows.thrusters):
        thrusters = hydro.thrusters[rows.thrusters]
        lags = hydro.lags[thrusters["lag"]]
        thrust = (np.einsum("ij,ij->i", lags["C"], thrusters["x"]) + lags["D"] * thrusters["demand"]) * thrusters[
            "efficiency"
        ]
        parts[rows.places] = thrust / np.where(thrust < 0.0, rows.full[:, 1], rows.full[:, 0])
    if len(rows.servos):
        servos = hydro.servos[rows.servos]
        low, high = servos["low"], servos["high"]
        half = 0.5 * (high - low)
        parts[rows.servo_places] = (servos["value"] - low - half) / np.where(half > 0.0, half, 1.0)
    parts = np.nan_to_num(parts, nan=0.0)
    found = np.rint(ACHIEVED_FULL * np.clip(parts, -1.0, 1.0)).astype(np.int8)
    for part, place in rows.external:
        told = part.achieved(t_ns)
        found[place : place + len(told)] = told
    return found
