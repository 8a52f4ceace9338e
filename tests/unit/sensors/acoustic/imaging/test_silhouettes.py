"""Where a fan's rays meet thin things: which cells are cut, and what the new ones hold."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.raycast import NOTHING, Hits, no_hits
from uwserver.sensors.acoustic.imaging.fan import CELL, Fan
from uwserver.sensors.acoustic.imaging.silhouettes import CUT, room_for, sharpen
from uwserver.testing import FakeGeometry
from uwserver.testing.fake_geometry import Plane, Sphere

COLUMNS, ROWS = 13, 71
FAN = Fan(math.pi / 60.0, math.pi / 6.0, COLUMNS, ROWS, 2.0)
MANY = Fan(math.pi / 60.0, math.pi / 6.0, 400, 300, 2.0)
ORIGIN = np.zeros(FAN.direction.shape)


def bar(direction: FloatArray, middle: float, width: float, turned: float = 0.0, r: float = 20.0) -> Hits:
    """An endless bar at a range, so many rad wide; upright, or turned about the axis of the fan."""
    az, el = np.arctan2(direction[:, 1], direction[:, 0]), np.arcsin(direction[:, 2])
    met = np.abs(az * math.cos(turned) - el * math.sin(turned) - middle) < 0.5 * width
    hits = no_hits(len(direction))
    hits.distance[met], hits.body[met], hits.material[met], hits.normal[met] = r, 3, 0, -direction[met]
    return hits


class Lit(NamedTuple):
    """A fan, as `sharpen` takes it."""

    cells: Any
    place: FloatArray
    area: FloatArray
    across_power: FloatArray
    along_power: FloatArray


class Finer(NamedTuple):
    """Rays in place of some of a fan, and their cells."""

    direction: FloatArray
    cells: Any


class Silhouettes:
    """What cuts cells of one fan, with its work space."""

    def __init__(self, fan: Fan) -> None:
        n, room = len(fan.cells), room_for(len(fan.cells))
        self.fan, self.cuts, self.finer = fan, np.zeros(n, CUT), Finer(np.zeros((room, 3)), np.zeros(room, CELL))

    def refine(self, hits: Hits, direction: FloatArray) -> Finer | None:
        fan = self.fan
        lit = Lit(fan.cells, fan.place, fan.area, fan.across_power, fan.along_power)
        count = sharpen(fan.columns, fan.rows, lit, direction, hits, self.cuts, *self.finer)
        return Finer(self.finer.direction[:count], self.finer.cells[:count]) if count else None


def refined(hits: Hits, fan: Fan = FAN) -> tuple[FloatArray, Finer | None]:
    """Which cells are cut, and the new ones."""
    before = hits.body.copy()
    finer = Silhouettes(fan).refine(hits, fan.direction)
    return (before != hits.body), finer


def share(middle: float, width: float, turned: float = 0.0) -> float:
    """Part of the emitted energy that the rays, new and old, find on a bar."""
    hits = bar(FAN.direction, middle, width, turned)
    _, finer = refined(hits)
    found = FAN.cells["emitted"][hits.body != NOTHING].sum()
    if finer is not None:
        found += finer.cells["emitted"][bar(finer.direction, middle, width, turned).body != NOTHING].sum()
    return float(found / FAN.cells["emitted"].sum())


def expected(middle: float, width: float, turned: float = 0.0) -> float:
    """The same of a fan of very many rays."""
    met = bar(MANY.direction, middle, width, turned).body != NOTHING
    return float(MANY.cells["emitted"][met].sum() / MANY.cells["emitted"].sum())


@pytest.mark.parametrize("width", [0.00125, 0.0025, 0.005])
def test_an_upright_bar_as_thin_as_a_pile_of_5_cm_at_40_m_brings_its_energy_from_anywhere(width: float) -> None:
    """In each tenth of a cell; rays of the fan alone are wrong by decibels, or miss it."""
    cell = FAN.size[0]
    for middle in np.linspace(-1.0, 1.0, 21) * cell:
        assert 10.0 * math.log10(share(middle, width) / expected(middle, width)) == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize("width", [0.0025, 0.005])
def test_so_does_a_level_one(width: float) -> None:
    for middle in np.linspace(-0.9, 0.9, 10) * FAN.size[1]:
        found = share(middle, width, 0.5 * math.pi) / expected(middle, width, 0.5 * math.pi)
        assert 10.0 * math.log10(found) == pytest.approx(0.0, abs=0.6)


def test_new_cells_fill_those_that_were_cut() -> None:
    """Solid angle, each in its own; and rays are in their cells."""
    hits, behind = bar(FAN.direction, 0.001, 0.002), FAN.direction
    empty = hits.body == NOTHING
    hits.distance[empty], hits.body[empty], hits.normal[empty] = 40.0, 9, -behind[empty]
    cut, finer = refined(hits)
    assert finer is not None
    area = np.linalg.norm(np.cross(finer.cells["across"], finer.cells["along"]), axis=1)[finer.cells["emitted"] > 0.0]
    whole = np.linalg.norm(np.cross(FAN.cells["across"], FAN.cells["along"]), axis=1)[cut].sum()
    assert area.sum() == pytest.approx(whole, rel=1e-4)
    off = np.abs(np.einsum("ij,ij->i", finer.cells["across"], finer.direction - finer.cells["direction"]))
    assert (off <= 0.5001 * np.square(finer.cells["across"]).sum(axis=1)).all()
    assert np.linalg.norm(finer.direction, axis=1) == pytest.approx(1.0)


def test_the_same_rays_give_the_same_answer_whatever_was_before() -> None:
    work = Silhouettes(FAN)
    first = work.refine(bar(FAN.direction, 0.002, 0.002), FAN.direction)
    assert first is not None
    kept = Finer(first.direction.copy(), first.cells.copy())
    work.refine(bar(FAN.direction, -0.01, 0.003, 0.3), FAN.direction)
    again = work.refine(bar(FAN.direction, 0.002, 0.002), FAN.direction)
    assert again is not None
    assert np.array_equal(again.direction, kept.direction)
    assert np.array_equal(again.cells, kept.cells)


@pytest.mark.parametrize(
    "shapes",
    [
        [],
        [Plane((0.0, 0.0, 4.0), (0.0, 0.0, -1.0))],
        [Plane((0.0, 0.0, 4.0), (0.0, 0.0, -1.0)), Plane((21.0, 0.0, 0.0), (-1.0, 0.2, 0.0))],
        [Plane((0.0, 0.0, 4.0), (0.0, 0.0, -1.0)), Sphere((15.0, 0.0, 0.0), 1.5)],
    ],
)
def test_nothing_is_cut_where_nothing_is_thin(shapes: Any) -> None:
    hits = FakeGeometry(shapes).raycast(ORIGIN, FAN.direction, 50.0)
    _, finer = refined(hits)
    assert finer is None


def test_over_ground_without_order_there_are_rays_enough() -> None:
    """Every ray its own surface: nothing is cut, as everything is thin; and one in ten: no more new rays than two for one."""
    rng = np.random.Generator(np.random.Philox(key=3))
    n = len(FAN.cells)
    for part, many in ((1.0, False), (0.1, True)):
        hits = no_hits(n)
        met = rng.random(n) < part
        hits.distance[met], hits.body[met], hits.normal[met] = rng.uniform(5.0, 6.0, met.sum()), 1, (-1.0, 0.0, 0.0)
        hits.distance[met] *= np.where(rng.random(met.sum()) < 0.5, 1.0, 3.0) if part == 1.0 else 1.0
        hits.body[met] = rng.integers(0, 1000, met.sum()) if part == 1.0 else 1
        _, finer = refined(hits)
        assert (finer is not None) == many
        if finer is not None:
            assert len(finer.cells) <= 2.1 * n


@pytest.mark.parametrize(("columns", "rows"), [(1, 1), (1, 9), (2, 2), (3, 3), (40, 3)])
def test_fans_of_few_rays_do_no_harm(columns: int, rows: int) -> None:
    fan = Fan(0.05, 0.5, columns, rows, 2.0)
    for middle in (0.0, 0.01):
        refined(bar(fan.direction, middle, 0.01), fan)
