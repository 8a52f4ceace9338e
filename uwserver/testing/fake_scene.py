"""The scene of a `FakeContext`: bodies without shapes in open water."""

from __future__ import annotations

import numpy as np

from uwserver.adapter import WorldFacts
from uwserver.ports import BodyView, EntityList, SceneState, SceneView, WaterView

NOBODY = SceneState(EntityList(1, (), ()), 0, np.zeros((0, 7)), np.zeros(0, np.int8), (0.0, 0.0, 0.0))
"""A world without bodies."""
_WATER = WaterView(1025.0, 1500.0, (), 0.0, (0.0, 0.0, 0.0), (), "II", (0.4, 0.2, 0.2), (0.0, 0.1, 0.2))


def bare_scene(entities: EntityList, facts: WorldFacts) -> SceneView:
    """Return a scene with these bodies."""
    vehicles, objects = (
        tuple(BodyView(body.name, "", body.like, ()) for body in group)
        for group in (entities.vehicles, entities.objects)
    )
    return SceneView(
        schema=1, revision=entities.revision, scenario=facts.scenario, title="", epoch=facts.epoch_utc, rate_hz=facts.rate_hz,
        origin=None, water=_WATER, seabed=None, structures=(), vehicles=vehicles, objects=objects, beacons=(), meshes={},
    )  # fmt: skip
