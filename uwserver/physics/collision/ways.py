"""The shortest ways out of overlaps, asked of an engine."""

from __future__ import annotations

from uwserver.physics.collision.engine import AUTO, ENGINES, Engine, Pose, chosen_engine, missing_engine
from uwserver.physics.geometry.rows import Part
from uwserver.physics.geometry.shapes import Placed
from uwserver.physics.kernel.arrays import FloatArray


class WaysOut:
    """Of the shapes of a world, or of several that are stepped in one thread: what an engine answers depends on its question alone.

    The engine is opened for the first question, as its world takes 29 MB and what rests asks none. Shapes that are equal are one there, each moved to
    where it is asked about, and a second where two of them have met: a swarm costs it no more than two vehicles.

    Args:
        engine: a name of `engine.ENGINES`, or "auto" for the first of them that is installed.

    Attributes:
        name: of the engine.

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

    def close(self) -> None:
        """Give back the engine's world; the next question opens another."""
        if self._engine is not None:
            self._engine.close()
        self._engine = None
        self._handles.clear()

    def way_out(self, a: Placed, rows_a: Part, pose_a: Pose, b: Placed, rows_b: Part, pose_b: Pose) -> FloatArray:
        """The direction (3) in N in which convex shape a comes out of b soonest; NaN if the engine knows none.

        Args:
            a, b: the shapes, as they are in their solids.
            rows_a, rows_b: the same as rows.
            pose_a, pose_b: where they are.

        Raises:
            BadSolid: the engine cannot hold one of them.
            RuntimeError: it gives no further world.
        """
        if self._engine is None:
            self._engine = open_engine(self.name)
        engine = self._engine
        one = self._handle(engine, a, rows_a, 0)
        return engine.way_out(one, pose_a, self._handle(engine, b, rows_b, 1 if a == b else 0), pose_b)

    def _handle(self, engine: Engine, placed: Placed, rows: Part, k: int) -> int:
        handles = self._handles.setdefault(placed, [])
        while len(handles) <= k:
            handles.append(engine.add(placed, rows))
        return handles[k]


def open_engine(name: str) -> Engine:
    """An empty world of an engine that is installed. Raises RuntimeError if it gives none."""
    if name == "bullet":
        from uwserver.physics.collision.bullet import BulletEngine

        return BulletEngine()
    from uwserver.physics.collision.coal_engine import CoalEngine

    return CoalEngine()
