"""What lives in a world, and the tick."""

from __future__ import annotations

from uwserver.world.world import Diverged, World

__all__ = ["Diverged", "World"]
