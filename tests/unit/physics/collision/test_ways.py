"""Ways out of overlaps: an engine is opened when it is asked first, and equal shapes are one there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from engine_rig import at

from uwserver.physics.collision import ways as module
from uwserver.physics.collision.engine import Engine, missing_engine
from uwserver.physics.collision.solids import Solids
from uwserver.physics.collision.ways import WaysOut
from uwserver.physics.geometry.rows import part
from uwserver.physics.geometry.shapes import Box, Placed, Solid, Sphere

pytestmark = pytest.mark.skipif(missing_engine() is not None, reason="no engine for contacts is installed")

CRATE = Solid("crate", (Placed(Box((0.3, 0.2, 0.1))),))


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[list[Placed]]:
    """For each engine that is opened, the shapes that it was given."""
    engines: list[list[Placed]] = []
    plain = module.open_engine

    def watched(name: str) -> Engine:
        engine: Any = plain(name)
        shapes: list[Placed] = []
        engines.append(shapes)
        add = engine.add
        engine.add = lambda placed, rows: shapes.append(placed) or add(placed, rows)
        return engine  # type: ignore[no-any-return]

    monkeypatch.setattr(module, "open_engine", watched)
    return engines


def two(gap: float) -> Any:
    """States of two crates, one above the other and turned by some degrees."""
    state = np.zeros((2, 13))
    state[:, 3] = 1.0
    state[1, 2] = -0.2 - gap
    state[1, 3:7] = np.cos(0.2), np.sin(0.2), 0.0, 0.0
    return state


def test_no_engine_is_opened_for_what_overlaps_nothing(opened: list[list[Placed]]) -> None:
    """Its world takes 29 MB, and most worlds never ask."""
    with Solids() as solids:
        for row in range(2):
            solids.add_moving(CRATE, row)
        assert not len(solids.find_contacts(two(1.0), 1e-3).gap)
        assert not opened
        assert len(solids.find_contacts(two(-0.1), 1e-3).gap)
        assert len(opened) == 1


def test_equal_shapes_are_one_and_two_where_they_meet(opened: list[list[Placed]]) -> None:
    """A swarm costs the engine what two vehicles do, in however many worlds it is, and touches as shapes that are nobody else's."""
    ways, found = WaysOut(), []
    for other in (0.1, 0.1, 0.1 + 1e-12):
        solids = Solids(ways=ways)
        for row, z in enumerate((0.1, other)):
            solids.add_moving(Solid("crate", (Placed(Box((0.3, 0.2, z))),)), row)
        found.append(solids.find_contacts(two(-0.1), 1e-3))
    assert [len(shapes) for shapes in opened] == [3]
    same, again, different = found
    assert len(same.gap)
    for name in ("gap", "normal", "point"):
        assert getattr(same, name).tolist() == getattr(again, name).tolist()
        np.testing.assert_allclose(getattr(same, name), getattr(different, name), rtol=0.0, atol=1e-9)
    ways.close()


def test_after_its_end_another_engine_answers_the_same(opened: list[list[Placed]]) -> None:
    ways, ball, block = WaysOut(), Placed(Sphere(0.2)), Placed(Box((0.3, 0.2, 0.1)))
    question = ball, part(ball), at(ball, 0.45, 0.0, 0.0), block, part(block), at(block, 0.0, 0.0, 0.0)
    first = ways.way_out(*question)
    ways.close()
    ways.close()
    assert ways.way_out(*question).tolist() == first.tolist()
    assert first == pytest.approx([1.0, 0.0, 0.0], abs=1e-3)
    assert len(opened) == 2
    ways.close()


def test_an_engine_that_fails_ends_no_tick(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    """The way out is guessed then, which is told once."""

    def fail(name: str) -> Engine:
        raise RuntimeError("Bullet gives no further world")

    monkeypatch.setattr(module, "open_engine", fail)
    with Solids() as solids:
        for row in range(2):
            solids.add_moving(CRATE, row)
        for _ in range(3):
            contacts = solids.find_contacts(two(-0.1), 1e-3)
        assert len(contacts.gap)
        assert np.isfinite(contacts.normal).all()
    assert [record.message for record in caplog.records] == [
        "the way out of an overlap is guessed: Bullet gives no further world"
    ]


def test_an_engine_can_be_ready_before_a_run(opened: list[list[Placed]]) -> None:
    ways = WaysOut()
    ways.open()
    ways.open()
    assert len(opened) == 1
    ways.close()
