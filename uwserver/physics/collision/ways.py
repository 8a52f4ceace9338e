"""The shortest ways out of overlaps, which an engine finds."""

from __future__ import annotations

import logging

import numpy as np

from uwserver.physics.collision.engine import AUTO, ENGINES, Engine, Pose, chosen_engine, missing_engine
from uwserver.physics.geometry.rows import Part
from uwserver.physics.geometry.shapes import BadSolid, Placed
from uwserver.physics.kernel.arrays import FloatArray

log = logging.getLogger(__name__)


class WaysOut:
    """Ways out of overlaps, for one world or for several that are stepped in one thread, as an answer depends on its question alone.

    The engine is opened at the first question: its world takes 29 MB, and resting bodies ask none. Equal shapes share one shape there, which is
    moved to the place of each question, and a second one if two of them meet. So a swarm costs no more than two vehicles. No shape is freed before
    the end, as later bodies usually have the same shapes.

    Args:
        engine: a name of `engine.ENGINES`, or "auto" for the first of them that is installed.

    Attributes:
        name: name of the engine.

    Raises:
        ImportError: it is not installed.
        ValueError: no engine has this name.
    """

    def __init__(self, engine: str = AUTO) -> None:
        if engine != AUTO and engine not in ENGINES:
            raise ValueError(f'no engine is called "{engine}": choose {AUTO}, {" or ".join(ENGINES)}')
        missing = missing_engine(engine)
        if missing is not None:
            raise ImportError(missing)
        self.name = chosen_engine(engine)
        self._engine: Engine | None = None
        self._handles: dict[Placed, list[int]] = {}
        self._has_failed = False

    def close(self) -> None:
        """Free the world of the engine. The next question opens another one."""
        if self._engine is not None:
            self._engine.close()
        self._engine = None
        self._handles.clear()

    def open(self) -> None:
        """Open the engine, which takes some 20 ms, before a run that the clock paces. Raise RuntimeError if it has no further world."""
        self._opened()

    def _opened(self) -> Engine:
        if self._engine is None:
            self._engine = open_engine(self.name)
        return self._engine

    def way_out(self, a: Placed, rows_a: Part, pose_a: Pose, b: Placed, rows_b: Part, pose_b: Pose) -> FloatArray:
        """Return the direction (3) in N in which convex shape a leaves b by the shortest way. Return NaN if the engine knows none or fails; a
        failure is logged, as it must not end a tick.

        Args:
            a, b: the shapes, as they are in their solids.
            rows_a, rows_b: the same as rows.
            pose_a, pose_b: where they are.
        """
        try:
            engine = self._opened()
            one, other = self._handle(engine, a, rows_a, 0), self._handle(engine, b, rows_b, 1 if a == b else 0)
        except (BadSolid, RuntimeError) as error:
            if not self._has_failed:
                log.warning("the way out of an overlap is guessed: %s", error)
            self._has_failed = True
            return np.full(3, np.nan)
        return engine.way_out(one, pose_a, other, pose_b)

    def _handle(self, engine: Engine, placed: Placed, rows: Part, k: int) -> int:
        handles = self._handles.setdefault(placed, [])
        while len(handles) <= k:
            handles.append(engine.add(placed, rows))
        return handles[k]


def open_engine(name: str) -> Engine:
    """Return an empty world of an engine that is installed. Raise RuntimeError if it has none."""
    if name == "bullet":
        from uwserver.physics.collision.bullet import BulletEngine

        return BulletEngine()
    from uwserver.physics.collision.coal_engine import CoalEngine

    return CoalEngine()
