"""The bodies and the water of a world as parts with a state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from uwserver.environment.water import Water
from uwserver.frames import Vec3
from uwserver.physics.bodies import Hydrodynamics
from uwserver.world.parts.part import Part, RandomStream, State


class BodiesState(State, frozen=True):
    """The arrays of all bodies that change in a run."""

    arrays: Annotated[dict[str, bytes], Meta(max_length=64)]


class Bodies(Part):
    """The arrays of the kernel, which moves the bodies."""

    path = "world/bodies"
    state_type = BodiesState

    def __init__(self, hydro: Hydrodynamics) -> None:
        self._hydro = hydro

    def save(self) -> BodiesState:
        """Return copies of the arrays."""
        return BodiesState(self._hydro.save())

    def check(self, state: Any) -> None:
        """Raise ValueError if the arrays do not fit: see `Hydrodynamics.check`."""
        self._hydro.check(state.arrays)

    def load(self, state: BodiesState) -> None:
        """Take over a checked state."""
        self._hydro.load(state.arrays)


class WaterState(State, frozen=True):
    """The steady current (m/s, N), and for each drifting current its random stream and its velocities at both ends of the present interval."""

    current: Vec3
    drifts: Annotated[tuple[tuple[bytes, Annotated[tuple[float, ...], Meta(max_length=6)]], ...], Meta(max_length=1024)]


class WaterPart(Part):
    """The water, whose uniform part drifts."""

    path = "world/water"
    state_type = WaterState

    def __init__(self, water: Water, set_current: Callable[[Vec3], None]) -> None:
        """Take the water. `set_current` is the method of the world."""
        self._water = water
        self._set_current = set_current
        self._drifts = [(RandomStream(drift.rng), drift.ends) for drift in (water.sea.drifts if water.sea else ())]

    def save(self) -> WaterState:
        """Return the currents."""
        drifts = tuple((stream.save(), tuple(ends.ravel().tolist())) for stream, ends in self._drifts)
        return WaterState(self._water.current, drifts)

    def check(self, state: Any) -> None:
        """Raise ValueError for another number of drifting currents, or velocities that no water has."""
        if len(state.drifts) != len(self._drifts):
            raise ValueError(f"{len(state.drifts)} drifting currents, not {len(self._drifts)}")
        for (stream, ends), (data, given) in zip(self._drifts, state.drifts, strict=True):
            stream.check(data)
            if len(given) != ends.size:
                raise ValueError("a drifting current has two velocities")
        speeds = [*state.current, *(end for _, ends in state.drifts for end in ends)]
        if not all(abs(speed) < 1e3 for speed in speeds):
            raise ValueError("a current faster than any water")

    def load(self, state: WaterState) -> None:
        """Take over a checked state. The world is at its tick already."""
        for (stream, ends), (data, given) in zip(self._drifts, state.drifts, strict=True):
            stream.load(data)
            ends[...] = np.reshape(given, ends.shape)
        self._set_current(state.current)
