"""The parts of a world, and the Python side of its tick."""

from __future__ import annotations

from uwserver.world.state import snapshot
from uwserver.world.world import Diverged, World

__all__ = ["Diverged", "World", "snapshot"]
