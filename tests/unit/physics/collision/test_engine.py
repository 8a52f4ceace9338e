"""Which engine there is, and that all engines give the same contacts."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.packages import install_command
from uwserver.physics.collision import engine
from uwserver.physics.collision.engine import ENGINES, chosen_engine, missing_engine
from uwserver.physics.collision.solids import Solids
from uwserver.physics.collision.ways import WaysOut
from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, Placed, Shape, Solid, Sphere
from uwserver.physics.kernel.arrays import FloatArray


def install(monkeypatch: pytest.MonkeyPatch, names: Iterable[str]) -> None:
    there = set(names)
    monkeypatch.setattr(engine, "find_spec", lambda name: name if name in there else None)


def test_auto_is_the_first_that_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, ["pybullet", "coal"])
    assert [chosen_engine(), chosen_engine("coal")] == ["bullet", "coal"]
    install(monkeypatch, ["coal"])
    assert [chosen_engine(), chosen_engine("bullet")] == ["coal", "bullet"]
    install(monkeypatch, [])
    assert chosen_engine() == "auto"


def test_what_is_missing_is_named_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, ["coal"])
    assert missing_engine() is None
    assert missing_engine("coal") is None
    text = f'the engine "bullet" needs pybullet: {install_command("pybullet")}, or choose engine = "coal", which is installed'
    assert missing_engine("bullet") == text
    with pytest.raises(ImportError, match=text):
        WaysOut("bullet")
    install(monkeypatch, [])
    assert missing_engine() == f"neither pybullet nor coal is installed: {install_command('uwserver[solid]')}"
    assert missing_engine("coal") == f'the engine "coal" needs coal: {install_command("coal")}'


def test_a_name_that_is_none() -> None:
    with pytest.raises(ValueError, match='no engine is called "ode": choose auto, bullet or coal'):
        WaysOut("ode")


POINTS = np.random.default_rng(7).normal(size=(20, 3))
SHAPES: dict[str, Shape] = {
    "box": Box((0.3, 0.2, 0.1)),
    "sphere": Sphere(0.2),
    "capsule": Capsule(0.1, 0.3),
    "cylinder": Cylinder(0.15, 0.25),
    "hull": ConvexHull(0.25 * POINTS / np.linalg.norm(POINTS, axis=1)[:, None]),
}


def world_of(name: str, a: Shape, b: Shape) -> Solids:
    if missing_engine(name):
        pytest.skip(f"{name} is not installed")
    solids = Solids(ways=WaysOut(name))
    solids.add_moving(Solid("a", (Placed(a),)), 0)
    solids.add_moving(Solid("b", (Placed(b, (0.05, 0.0, 0.0), quat_from_rpy(0.3, 0.2, 0.1)),)), 1)
    return solids


def overlaps(reference: Solids, count: int) -> list[FloatArray]:
    """States (2, 13) in which the two overlap by up to 2 mm, or are as near: one goes out of the other until the gap is as drawn."""
    rng, found = np.random.default_rng(11), []
    while len(found) < count:
        state: Any = np.zeros((2, 13))
        state[:, 3:7] = [quat_from_rpy(*rng.uniform(-3, 3, 3)) for _ in range(2)]
        way, wanted = rng.normal(size=3), rng.uniform(-2e-3, 2e-3)
        way /= np.linalg.norm(way)
        near, far = 0.0, 1.0
        for _ in range(11):
            middle = (near + far) / 2
            state[0, :3] = middle * way
            contacts = reference.find_contacts(state, 1e-3)
            is_near = len(contacts.gap) and contacts.gap.min() < wanted
            near, far = (middle, far) if is_near else (near, middle)
        state[0, :3] = near * way
        contacts = reference.find_contacts(state, 1e-3)
        if len(contacts.gap) and -2e-3 < contacts.gap.min() < 2e-3:
            found.append(state)
    return found


@pytest.mark.parametrize("b", SHAPES)
@pytest.mark.parametrize("a", SHAPES)
def test_all_engines_give_the_same_contacts(a: str, b: str) -> None:
    """Keys, count, and to 1e-9 gaps and normals; but for ties of two ways out, of which there are at most 2 among 40."""
    first, second = (world_of(name, SHAPES[a], SHAPES[b]) for name in ENGINES)
    ties = 0
    with first, second:
        for state in overlaps(first, 40):
            ours, theirs = first.find_contacts(state, 1e-3), second.find_contacts(state, 1e-3)
            same = ours.key.tolist() == theirs.key.tolist()
            same = same and np.abs(ours.gap - theirs.gap).max() < 1e-9
            ties += not (same and np.abs(ours.normal - theirs.normal).max() < 1e-9)
    assert ties <= 2
