"""A description crosses walls as it is: to JSON and back nothing is lost, and every key is always there."""

from __future__ import annotations

import msgspec

from uwserver.ports import ActuatorView, BodyView, EntityList, Present, SceneView, ShapeView
from uwserver.testing import FakeContext


def test_every_key_is_always_there() -> None:
    told = msgspec.to_builtins(ShapeView("sphere", radius=0.5))
    assert set(told) == set(ShapeView.__struct_fields__)
    assert told["size"] is None


def test_a_description_survives_json() -> None:
    scene = FakeContext().scene(EntityList(7, (Present("rov", "rov"),), ()))
    thruster = ActuatorView(
        "t1", "thruster", (1.0, 2.0, 3.0), (1.0, 0.0, 0.0), low=-2.0, high=3.0, port="rov/t", index=0
    )
    body = BodyView("rov", "fake", "rov", (ShapeView("box", size=(1.0, 2.0, 3.0)),), actuators=(thruster,))
    scene = msgspec.structs.replace(scene, vehicles=(body,))
    assert msgspec.json.decode(msgspec.json.encode(scene), type=SceneView) == scene
