"""Additional rays where the rays of a fan hit something thinner than its cells: a pile, a strut, a cable (compiled).

A ray that hits what few of its neighbours hit has found something thin. Such a ray is joined by lines to the nearest other rays that hit the same
thing. The cells along these lines, and as far beyond, are cut so finely that each row of new cells shows how much of it the thing covers. All this
follows from what the rays of one pose hit, so a sonar at rest hears the same in each ping.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.rays.raycast import NOTHING, Hits
from uwserver.sensors.acoustic.imaging.fan import FINEST, GOLDEN

_NEAR, _FLAT = 0.03, 0.05
"""Relative difference of range within which two rays hit the same surface; and within which one ray hits the plane of the other's surface."""
_FAINT = 0.01
"""Cells with less than this part of the strongest one's power are not cut."""
_MOST_THIN = 0.15
"""Largest part of all rays that may hit something thin. If it is more, as over rough ground, these rays are enough, and none are added."""
_ALIKE = 0.3
"""Largest relative difference of range between two ends of one thing."""
_FARTHEST_LINK = 12.0
_ALONE = 6.0
"""Distances in cells: largest one between two rays that hit the same thing, and the one searched around a ray that is alone."""
_OTHER, _UPRIGHT, _LEVEL = 0, 1, 2
_SLENDER = 4.0
"""A thing is upright (level) if the sum of squared distances is so many times larger along (across) than the other way."""
_COARSE = 4
"""Least number of parts that a cell is cut into."""
_MORE = 2
"""Largest number of added rays for each ray of the fan."""
_LEAST = 64

CUT = np.dtype([("across", "i8"), ("along", "i8"), ("low", "f8"), ("high", "f8")])
"""How a cell is cut: numbers of parts across and along, 0 if it is not cut. It is cut finely between the places `low` and `high`, from 0 to 1 of its
width (or height, if only that is cut), and into four parts elsewhere."""


def room_for(rays: int) -> int:
    """Return the largest number of new cells of a fan with so many rays: twice as many, rounded up to one of a few sizes."""
    wanted, size = max(_MORE * rays, _LEAST), _LEAST
    while size < wanted:
        size = size * 3 // 2 if size & (size - 1) == 0 else size // 3 * 4
    return size


@compiled
def sharpen(
    columns: int, rows: int, fan: Any, towards: Array, hits: Hits, cuts: Array, direction: Array, finer: Any
) -> int:  # fmt: skip
    """Find the rays that replace those rays of a fan that hit, or nearly hit, something thin.

    Args:
        columns, rows: those of the fan.
        fan: has `cells`, `place`, `area`, `across_power` and `along_power`, as `Fan`.
        towards: (n, 3) directions of its rays in the frame of the hits.
        hits: hits of these rays; the hits of cells that are cut are removed.
        cuts: (n) of CUT, receives how each cell is cut.
        direction: (m, 3) receives the directions of the new rays, in the frame of the fan.
        finer: (m) of CELL receives the new cells; m is `room_for` the rays of the fan.

    Returns:
        The number of new rays; 0 if there is nothing thin.
    """
    cells = fan.cells
    found = find_thin(
        columns, rows, fan.place, cells.emitted, towards, hits.distance, hits.normal, hits.body, cuts, len(finer)
    )
    if found == 0:
        return 0
    for i in range(len(cuts)):
        if cuts[i].across > 0:
            hits.body[i] = NOTHING
    return int(cut(columns, cells, cuts, fan.area, fan.across_power, fan.along_power, direction, finer))


@compiled
def _same(a: int, b: int, direction: Array, distance: Array, normal: Array, bodies: Array) -> bool:
    """Return whether two rays hit the same surface: at about the same range, or in one plane."""
    if bodies[a] != bodies[b]:
        return False
    p, q = distance[a], distance[b]
    if abs(p - q) <= _NEAR * min(p, q):
        return True
    for i, j in ((a, b), (b, a)):
        height = there = 0.0
        for m in range(3):
            height += normal[i, m] * direction[i, m]
            there += normal[i, m] * direction[j, m]
        # Both products are equal if the second ray hits the plane of the first one's surface.
        if height * there > 0.0 and abs(distance[i] * height - distance[j] * there) <= _FLAT * distance[j] * abs(there):
            return True
    return False


@compiled
def _is_thin(i: int, columns: int, direction: Array, distance: Array, normal: Array, bodies: Array) -> bool:
    """Return whether a ray has found something thin: on none of its four sides do all three neighbours hit the surface that it hits."""
    for step, side in ((columns, 1), (1, columns)):
        for sense in (-1, 1):
            there = i + sense * side
            if (
                _same(i, there, direction, distance, normal, bodies)
                and _same(i, there - step, direction, distance, normal, bodies)
                and _same(i, there + step, direction, distance, normal, bodies)
            ):
                return False
    return True


@compiled
def _mark(column: int, row: int, across: int, along: int, low: float, high: float, frame: Any, cuts: Array) -> None:
    """Mark a cell to be cut into at least so many parts, and finely at least between two places of its width or height."""
    columns, rows, emitted, faint = frame
    if (
        high > 0.0
        and low < 1.0
        and 0 <= column < columns
        and 0 <= row < rows
        and emitted[row * columns + column] >= faint
    ):
        cell = cuts[row * columns + column]
        if cell.across == 0:
            cell.low, cell.high = 1.0, 0.0
        cell.across, cell.along = max(cell.across, across), max(cell.along, along)
        cell.low, cell.high = max(min(cell.low, low), 0.0), min(max(cell.high, high), 1.0)
        if min(cell.across, cell.along) > 1:
            cell.across = cell.along = _COARSE


@compiled
def _join(at_x: float, at_y: float, dx: float, dy: float, form: int, frame: Any, cuts: Array) -> None:
    """Mark the cells along the line from one ray to another, and as far beyond the first, to be cut.

    Args:
        at_x, at_y: place of the first ray, cells.
        dx, dy: from there to the other ray, cells.
        form: form of the thing.
        frame: columns and rows of the fan, power of its cells, and least power of a cell that is cut.
        cuts: (n) of CUT.
    """
    length = max(abs(dx), abs(dy), 1.0)
    finest = _COARSE
    while finest < min(4.0 * length, float(FINEST)):
        finest *= 2
    # One ray in `length` rows hits the thing, so it covers about this part of the width of a cell.
    width = 1.0 / length
    steps = math.ceil(4.0 * length)
    for k in range(-steps, steps + 1):
        x, y = at_x + dx * k / steps, at_y + dy * k / steps
        column, row = math.floor(x), math.floor(y)
        for side in range(-1, 2):
            if form == _UPRIGHT:
                _mark(column + side, row, finest, 1, x - width - column - side, x + width - column - side, frame, cuts)
            elif form == _LEVEL:
                _mark(column, row + side, 1, finest, y - width - row - side, y + width - row - side, frame, cuts)
            else:
                _mark(math.floor(x + side * width), row, _COARSE, _COARSE, 0.0, 1.0, frame, cuts)
                _mark(column, math.floor(y + side * width), _COARSE, _COARSE, 0.0, 1.0, frame, cuts)


@compiled
def find_thin(
    columns: int, rows: int, place: Array, emitted: Array, direction: Array, distance: Array, normal: Array, bodies: Array,
    cuts: Array, most: int,
) -> int:  # fmt: skip
    """Find which cells are cut, and how.

    Args:
        columns, rows: those of the fan.
        place: (n, 2) as in `Fan`.
        emitted: (n) of its cells.
        direction: (n, 3) of the rays, in the frame of the normals.
        distance, normal, bodies: what each ray hits, as `Hits`.
        cuts: (n) of CUT, receives how each cell is cut.
        most: largest number of new cells.

    Returns:
        The number of new cells.
    """
    n = len(emitted)
    thin, count, faint = np.empty(n, np.int64), 0, 0.0
    for i in range(n):
        cuts[i].across = cuts[i].along = 0
        faint = max(faint, _FAINT * emitted[i])
    # Rays at the border of the fan lack neighbours, so they are not judged.
    for row in range(1, rows - 1):
        for i in range(row * columns + 1, (row + 1) * columns - 1):
            seen = bodies[i] != NOTHING and emitted[i] >= faint
            if seen and _is_thin(i, columns, direction, distance, normal, bodies):
                thin[count] = i
                count += 1
    if count == 0 or count > _MOST_THIN * n + 8:
        return 0
    frame = (columns, rows, emitted, faint)
    for m in range(count):
        i = thin[m]
        first, second, form = _neighbours(i, thin[:count], place, distance, bodies)
        x, y = place[i]
        if first < 0:
            # A single ray does not show in which direction the thing extends.
            _join(x, y, 0.0, _ALONE, _UPRIGHT, frame, cuts)
            _join(x, y, _ALONE, 0.0, _LEVEL, frame, cuts)
        for j in (first, second):
            if j >= 0:
                _join(x, y, place[j, 0] - x, place[j, 1] - y, form, frame, cuts)
    return int(_fit(cuts, most))


@compiled
def _neighbours(i: int, thin: Array, place: Array, distance: Array, bodies: Array) -> tuple[int, int, int]:
    """Return the two nearest rays that hit the same thing (-1 for none), and its form as all rays on it within reach show."""
    first = second = -1
    nearest = after = _FARTHEST_LINK
    wide = tall = 0.0
    for j in thin:
        alike = abs(distance[i] - distance[j]) <= _ALIKE * min(distance[i], distance[j])
        dx, dy = place[j, 0] - place[i, 0], place[j, 1] - place[i, 1]
        away = math.hypot(dx, dy)
        if j == i or bodies[i] != bodies[j] or not alike or away > _FARTHEST_LINK:
            continue
        wide, tall = wide + dx * dx, tall + dy * dy
        if away < nearest:
            first, second, nearest, after = j, first, away, nearest
        elif away < after:
            second, after = j, away
    form = _UPRIGHT if tall > _SLENDER * wide else _LEVEL if wide > _SLENDER * tall else _OTHER
    return first, second, form


@compiled
def _block(cell: Any, place: int, count: int) -> int:
    """Return how many of the `count` parts of a cell's width or height one new cell holds, from part `place` on.

    That is all parts of a block that is not cut finely, else one.
    """
    block = count // _COARSE
    if block <= 1 or place % block != 0:
        return 1
    low, high = place / count, (place + block) / count
    return 1 if high > cell.low and low < cell.high else block


@compiled
def _pieces(cell: Any) -> int:
    """Return the number of new cells of a cell."""
    across = along = place = 0
    while place < cell.across:
        place += _block(cell, place, cell.across)
        across += 1
    place = 0
    while place < cell.along:
        place += _block(cell, place, cell.along)
        along += 1
    return across * along


@compiled
def _fit(cuts: Array, most: int) -> int:
    """Halve the largest cuts until there are not too many new cells. Returns their number."""
    while True:
        total, largest = 0, 1
        for i in range(len(cuts)):
            total += _pieces(cuts[i])
            largest = max(largest, cuts[i].across, cuts[i].along)
        if total <= most:
            return int(total)
        for i in range(len(cuts)):
            cell = cuts[i]
            if largest == 1:
                cell.across = cell.along = 0
            elif max(cell.across, cell.along) == largest:
                cell.across, cell.along = max(cell.across // 2, 1), max(cell.along // 2, 1)


@compiled
def cut(
    columns: int, cells: Array, cuts: Array, area: Array, across_power: Array, along_power: Array, direction: Array, finer: Any
) -> int:  # fmt: skip
    """Make the new cells.

    Args:
        columns: columns of the fan.
        cells: (n) its cells, as CELL.
        cuts: (n) of CUT, as `find_thin` writes them.
        area, across_power, along_power: those of the fan.
        direction: (most, 3) receives unit directions of the rays.
        finer: (most) receives the cells.

    Returns:
        The number of new cells.
    """
    count = 0
    for i in range(len(cells)):
        how = cuts[i]
        column, row, u = i % columns, i // columns, 0
        while u < how.across:
            wide, v = _block(how, u, how.across), 0
            while v < how.along:
                tall = _block(how, v, how.along)
                new = finer[count]
                # Middle and size of the new cell, as parts of the old one.
                x, y = (u + 0.5 * wide) / how.across, (v + 0.5 * tall) / how.along
                part_x, part_y = wide / how.across, tall / how.along
                _place(cells[i], new, direction[count], row + v * GOLDEN, column + u * GOLDEN, x, y, part_x, part_y)
                pattern = across_power[2 * FINEST * column + int(2 * FINEST * x + 0.5)]
                pattern *= along_power[2 * FINEST * row + int(2 * FINEST * y + 0.5)]
                new.emitted = area[row] * pattern * part_x * part_y
                count += 1
                v += tall
            u += wide
    return count


@compiled
def _place(
    old: Any, new: Any, ray: Array, row: float, column: float, x: float, y: float, part_x: float, part_y: float
) -> None:  # fmt: skip
    """Write a part of a cell and its ray, which is staggered as in a fan: the shift across depends on the row, the shift along on the column."""
    off_x, off_y = part_x * (row * GOLDEN % 1.0 - 0.5), part_y * (column * GOLDEN % 1.0 - 0.5)
    long = far = 0.0
    for j in range(3):
        new.across[j], new.along[j] = part_x * old.across[j], part_y * old.along[j]
        new.direction[j] = old.direction[j] + (x - 0.5) * old.across[j] + (y - 0.5) * old.along[j]
        ray[j] = new.direction[j] + off_x * old.across[j] + off_y * old.along[j]
        long += ray[j] * ray[j]
        far += new.direction[j] * new.direction[j]
    for j in range(3):
        ray[j] /= math.sqrt(long)
        new.direction[j] /= math.sqrt(far)
