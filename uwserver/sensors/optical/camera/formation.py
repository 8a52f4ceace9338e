"""How light reaches the camera through water: revised image formation, pixel by pixel (compiled).

Each colour has an attenuation of its own along the line of sight and another one for daylight downwards, and the veil of the water before a
thing does not follow the attenuation of the thing's own light (D. Akkaynak and T. Treibitz, A revised underwater image formation model, CVPR
2018). Light of the sun falls with depth, keeps less and less of its direction, and is gathered by waves; light of lamps comes by cones, keeps
what is scattered forward on its way out, and loses it on its way to the lens, where it would be a blur. Surfaces are Lambert's. Illuminance is
in lux of daylight of each colour, radiance in lux/sr.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.environment.light import REFRACTION, Daylight, WaterLight
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.sensors.optical.camera.caustics import TEXELS, TILE_M
from uwserver.sensors.optical.camera.lamps import COARSE, SHADOW, intensity
from uwserver.sensors.optical.camera.patterns import paint_growth, paint_seabed, paint_tiles, sample

SEA = np.dtype(
    [
        ("attenuation", "f8", (3,)),  # of a beam, 1/m
        ("dimming", "f8", (3,)),  # of lamps on their way out, 1/m
        ("fading", "f8", (3,)),  # of daylight downwards, 1/m
        ("glow", "f8", (3,)),  # see `WaterLight.glow`
        ("spreading", "f8"),  # of the sun's light, of green as of all colours, 1/m
        ("surface", "f8"),  # z of the surface about the base, m: negative under water
        ("wet", "i8"),  # the camera is in the water
        ("above", "f8"),  # lux on the surface
        ("entered", "f8"),  # part of it that enters
        ("sky", "f8"),  # part of it that comes from all of the sky
        ("sun", "f8", (3,)),  # unit vector towards it as seen in the water, N
        ("high", "f8", (3,)),  # the same in air
        ("north", "f8"),  # of the base, m, modulo the tile of the waves
        ("east", "f8"),
        ("pixel", "f8"),  # rad
    ]
)
"""Light and water of a picture."""

_CAUSTICS_M = 10.0
_BACK = 0.08
"""Part of the light downwards that comes up again from below."""
_TILES, _GROWTH, _SEABED = 3, 2, 1
_SUN_WIDTH = 0.06
"""rad; of the sun's image in a ruffled surface."""
_WITHIN = ((-0.125, -0.375), (0.375, -0.125), (-0.375, 0.125), (0.125, 0.375))
"""Places in a pixel, parts of it, at which one looks through the surface: the edge of Snell's window is sharp and its waves are small."""
_SHARE = 1.0 / len(_WITHIN)
_LEVEL = 0.32
"""Sine of the elevation below which all is mirrored: no wave of `caustics.WAVES` is so steep that light comes in along such a ray."""
_NEVER = 1e6
_SURFACE = -2
_TURNED_AWAY = -0.2
"""Smooth normals may turn a little away at an outline; farther, and one is inside a wall, where it is dark."""
_LEAST_SEEN = 1e-4
"""Of the light of a thing; less is lost in the veil."""


def sea_row(water: WaterLight, day: Daylight, base: tuple[float, float, float], depth: float, pixel: float) -> Any:
    """SEA (1) of a picture.

    Args:
        water, day: light and water.
        base: of the picture, N.
        depth: of it under the surface, m; negative in air.
        pixel: angle of one, rad.
    """
    row: Any = np.zeros(1, SEA)
    sea = row[0]
    sea["attenuation"], sea["fading"], sea["glow"], sea["spreading"] = (
        water.attenuation,
        water.fading,
        water.glow(),
        water.spreading()[1],
    )
    sea["dimming"] = water.dimming()
    sea["surface"], sea["wet"], sea["above"], sea["sky"] = -depth, depth > 0.0, day.illuminance, day.sky
    sea["sun"], sea["entered"] = day.below()
    level = math.cos(day.elevation)
    sea["high"] = level * math.cos(day.azimuth), level * math.sin(day.azimuth), -math.sin(day.elevation)
    sea["north"], sea["east"], sea["pixel"] = base[0] % TILE_M, base[1] % TILE_M, pixel
    return row


@compiled
def _tile_at(tile: Array, north: float, east: float, channel: int) -> float:
    """A value of the tile of waves, between its texels."""
    x, y = north * (TEXELS / TILE_M), east * (TEXELS / TILE_M)
    a, b = math.floor(x), math.floor(y)
    p, q = x - a, y - b
    i, j = int(a) & (TEXELS - 1), int(b) & (TEXELS - 1)
    k, m = (i + 1) & (TEXELS - 1), (j + 1) & (TEXELS - 1)
    low = tile[i, j, channel] * (1.0 - q) + tile[i, m, channel] * q
    high = tile[k, j, channel] * (1.0 - q) + tile[k, m, channel] * q
    return float(low * (1.0 - p) + high * p)


@compiled
def _reflected(cosine: float, ratio: float) -> float:
    """As `environment.light.fresnel`."""
    square = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    if square <= 0.0:
        return 1.0
    behind = math.sqrt(square)
    across = (ratio * cosine - behind) / (ratio * cosine + behind)
    along = (cosine - ratio * behind) / (cosine + ratio * behind)
    return 0.5 * (across * across + along * along)


@compiled
def _sky(sea: Any, x: float, y: float, z: float) -> float:
    """Radiance of the sky towards (x, y, z), in lux/sr of white."""
    s = x * sea.high[0] + y * sea.high[1] + z * sea.high[2]
    width = _SUN_WIDTH * _SUN_WIDTH
    glare = (1.0 - sea.sky) / (2.0 * math.pi * width) * math.exp(-(1.0 - s) / width) if s > 0.8 else 0.0
    return float(sea.above * (sea.sky / math.pi * (1.3 + 0.6 * min(z, 0.0)) + glare))


@compiled
def _window(sea: Any, tile: Array, x: float, y: float, z: float, north: float, east: float) -> tuple[float, float]:
    """What a ray that goes up meets in the surface: radiance from above it, and the part of it that mirrors the water."""
    a, b = _tile_at(tile, north, east, 0), _tile_at(tile, north, east, 1)
    # The elevation is up: the normal that points down into the water.
    size = 1.0 / math.sqrt(1.0 + a * a + b * b)
    nx, ny, nz = a * size, b * size, size
    cosine = -(x * nx + y * ny + z * nz)
    if cosine <= 0.0:
        return 0.0, 1.0
    mirrored = _reflected(cosine, REFRACTION)
    square = 1.0 - REFRACTION * REFRACTION * (1.0 - cosine * cosine)
    if square <= 0.0:
        return 0.0, 1.0
    on = REFRACTION * cosine - math.sqrt(square)
    ux, uy, uz = REFRACTION * x + on * nx, REFRACTION * y + on * ny, REFRACTION * z + on * nz
    return (1.0 - mirrored) * REFRACTION * REFRACTION * _sky(sea, ux, uy, uz), mirrored


@compiled
def _albedo(
    face: Any, owner: Any, x: Array, pixel: float, place: Array, texels: Array, levels: Array, light: Array, normal: Array, colour: Array
) -> None:  # fmt: skip
    """Colour and normal (N) of a face where a ray meets it.

    Args:
        face: of FACE.
        owner: of THING.
        x: (3) where, about the base.
        pixel: m that one covers there.
        place: (3) receives the same in the frame of the faces.
        texels, levels, light: of the atlas.
        normal, colour: (3) receive them.
    """
    R = owner.R
    for i in range(3):
        place[i] = R[0, i] * (x[0] - owner.p[0]) + R[1, i] * (x[1] - owner.p[1]) + R[2, i] * (x[2] - owner.p[2])
        colour[i] = face.colour[i]
    # Barycentric coordinates (Ericson, Real-Time Collision Detection, 3.4).
    d00 = d01 = d11 = d20 = d21 = 0.0
    for i in range(3):
        a, b = face.corners[1, i] - face.corners[0, i], face.corners[2, i] - face.corners[0, i]
        c = place[i] - face.corners[0, i]
        d00, d01, d11, d20, d21 = d00 + a * a, d01 + a * b, d11 + b * b, d20 + c * a, d21 + c * b
    whole = d00 * d11 - d01 * d01
    v = w = 0.0
    if whole > 0.0:
        v = min(max((d11 * d20 - d01 * d21) / whole, 0.0), 1.0)
        w = min(max((d00 * d21 - d01 * d20) / whole, 0.0), 1.0)
    u = 1.0 - v - w
    nx = u * face.normals[0, 0] + v * face.normals[1, 0] + w * face.normals[2, 0]
    ny = u * face.normals[0, 1] + v * face.normals[1, 1] + w * face.normals[2, 1]
    nz = u * face.normals[0, 2] + v * face.normals[1, 2] + w * face.normals[2, 2]
    size = math.sqrt(nx * nx + ny * ny + nz * nz)
    size = 1.0 / size if size > 0.0 else 0.0
    for i in range(3):
        normal[i] = (R[i, 0] * nx + R[i, 1] * ny + R[i, 2] * nz) * size
    if face.texture >= 0:
        s = u * face.uv[0, 0] + v * face.uv[1, 0] + w * face.uv[2, 0]
        t = u * face.uv[0, 1] + v * face.uv[1, 1] + w * face.uv[2, 1]
        sample(texels, levels, face.texture, s, t, pixel / max(face.texel, 1e-6), light, colour)


@entry
def form(
    sea: Array, origin: Array, direction: Array, distance: Array, met: Array, faces: Array, things: Array, shift: Array,
    texels: Array, levels: Array, light: Array, lamps: Array, lit: Array, veil: Array, ranges: Array, tile: Array, width: int,
    radiance: Array,
) -> None:  # fmt: skip
    """Radiance of each pixel.

    Args:
        sea: SEA (1).
        origin, direction, distance, met: (n) rays and what they met, see `rays.Buffers`.
        faces, things: FACE and THING.
        shift: (things, 3) of the origin of faces in the frame of patterns, m.
        texels, levels, light: of the atlas, and the light of its values.
        lamps, lit: LAMP (m), and (m, cells) whether each reaches what is seen, see `lamps.light_rays`.
        veil, ranges: of lamps, see `lamps.fill_veil`.
        tile: of waves.
        width: of the picture.
        radiance: (n, 3) float32 receives it.
    """
    s, wet = sea[0], sea[0].wet != 0
    colour, normal, x, place, fresh = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    through, deeper, back, arrived, seen = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):  # daylight at the base
        fresh[i] = s.above * s.entered * math.exp(s.fading[i] * min(s.surface, 0.0))
    for k in range(len(distance)):
        dx, dy, dz = float(direction[k, 0]), float(direction[k, 1]), float(direction[k, 2])
        r, hit = min(distance[k], _NEVER), met[k]
        if (dz < 0.0) == wet and dz != 0.0:
            surface = (s.surface - origin[k, 2]) / dz
            if 0.0 <= surface < r:
                r, hit = surface, _SURFACE
        x[0], x[1], x[2] = origin[k, 0] + r * dx, origin[k, 1] + r * dy, origin[k, 2] + r * dz
        _between(s, wet, dz, r, fresh, through, deeper, back)
        seen[0] = seen[1] = seen[2] = 0.0
        if hit >= 0 and max(through[0], through[1], through[2]) > _LEAST_SEEN:
            face, pixel = faces[hit], s.pixel * r
            _albedo(face, things[face.thing], x, pixel, place, texels, levels, light, normal, colour)
            facing = -(normal[0] * dx + normal[1] * dy + normal[2] * dz)
            if facing < 0.0 and face.sided == 0:
                normal[0], normal[1], normal[2], facing = -normal[0], -normal[1], -normal[2], -facing
            _paint(face, shift[face.thing], place, pixel, facing, normal, colour)
            _daylight(s, tile, x, normal, deeper, fresh, arrived)
            cell = (k // width // SHADOW) * ((width + SHADOW - 1) // SHADOW) + k % width // SHADOW
            for m in range(len(lamps)):
                if lit[m, cell] != 0:
                    _lamplight(s, wet, lamps[m], x, normal, arrived)
            if facing > _TURNED_AWAY:
                for i in range(3):
                    seen[i] = colour[i] * arrived[i] / math.pi
        elif hit == _SURFACE and wet:
            _from_below(s, tile, dx, dy, dz, x, r, seen)
        elif hit == _SURFACE:
            _from_above(s, tile, dx, dy, dz, x, seen)
        elif hit < 0 and not wet and r > 0.0:
            seen[0] = seen[1] = seen[2] = _sky(s, dx, dy, dz)
        for i in range(3):
            radiance[k, i] = seen[i] * through[i] + back[i]
        if veil.shape[0] > 0 and wet:
            _add_veil(veil, ranges, k // width, k % width, r, radiance[k])


@compiled
def _between(s: Any, wet: bool, dz: float, r: float, fresh: Array, through: Array, deeper: Array, back: Array) -> None:
    """What the water does along r m of a ray: the part of light that comes through, how daylight changes to its end, and what it adds."""
    for i in range(3):
        through[i], deeper[i], back[i] = 1.0, 1.0, 0.0
        if wet:
            through[i] = math.exp(-s.attenuation[i] * r)
            deeper[i] = math.exp(-s.fading[i] * r * dz) if abs(dz) * r < 400.0 else 0.0
            rate = s.attenuation[i] + s.fading[i] * dz
            # (1 - exp(-rate r)) / rate, and its series where that would be a small difference.
            column = (1.0 - through[i] * deeper[i]) / rate if abs(rate * r) > 1e-4 else r * (1.0 - 0.5 * rate * r)
            back[i] = s.glow[i] * fresh[i] * column


@compiled
def _paint(face: Any, shift: Array, place: Array, pixel: float, facing: float, normal: Array, colour: Array) -> None:
    """Put the pattern of a face on its colour."""
    x, y, z = place[0] + shift[0], place[1] + shift[1], place[2] + shift[2]
    if face.pattern == _SEABED:
        paint_seabed(x, y, pixel / math.sqrt(max(facing, 0.05)), colour)
    elif face.pattern == _GROWTH:
        paint_growth(x, y, z, -normal[2], pixel, colour)
    elif face.pattern == _TILES:
        paint_tiles(x, y, z, normal, pixel / math.sqrt(max(facing, 0.05)), colour)


@compiled
def _lamplight(s: Any, wet: bool, lamp: Any, x: Array, normal: Array, arrived: Array) -> None:
    """Add what a lamp brings to a face at x."""
    lx, ly, lz = x[0] - lamp.p[0], x[1] - lamp.p[1], x[2] - lamp.p[2]
    far = max(math.sqrt(lx * lx + ly * ly + lz * lz), 0.01)
    cosine = -(normal[0] * lx + normal[1] * ly + normal[2] * lz) / far
    if cosine > 0.0:
        lux = intensity(lamp, lx, ly, lz, far) / (far * far) * cosine
        for i in range(3):
            arrived[i] += lux * (math.exp(-s.dimming[i] * far) if wet else 1.0)


@compiled
def _from_below(s: Any, tile: Array, dx: float, dy: float, dz: float, x: Array, r: float, seen: Array) -> None:
    """The surface as one sees it at x, r m away, from the water. What it mirrors is water, as one sees it level just below."""
    above = mirrored = 0.0
    if -dz < _LEVEL:
        for i in range(3):
            seen[i] = s.glow[i] / max(s.attenuation[i], 1e-6) * s.above * s.entered
        return
    level = math.hypot(dx, dy)
    ux, uy = (-dy / level, dx / level) if level > 1e-9 else (1.0, 0.0)
    for across, along in _WITHIN:
        p, q = across * s.pixel, along * s.pixel
        # (ux, uy, 0) and its product with the ray are both across it.
        ex, ey, ez = dx + p * ux + q * uy * dz, dy + p * uy - q * ux * dz, dz + q * (ux * dy - uy * dx)
        if ez >= 0.5 * dz:  # nearly level, where all is mirrored
            mirrored += _SHARE
            continue
        far, size = r * dz / ez, 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
        north, east = s.north + x[0] - r * dx + far * ex, s.east + x[1] - r * dy + far * ey
        light, part = _window(s, tile, ex * size, ey * size, ez * size, north, east)
        above, mirrored = above + _SHARE * light, mirrored + _SHARE * part
    for i in range(3):
        seen[i] = above + mirrored * s.glow[i] / max(s.attenuation[i], 1e-6) * s.above * s.entered


@compiled
def _from_above(s: Any, tile: Array, dx: float, dy: float, dz: float, x: Array, seen: Array) -> None:
    """The surface as one sees it at x from the air: the sky mirrored, and the colour of the water."""
    a, b = _tile_at(tile, s.north + x[0], s.east + x[1], 0), _tile_at(tile, s.north + x[0], s.east + x[1], 1)
    size = 1.0 / math.sqrt(1.0 + a * a + b * b)
    cosine = max((dx * a + dy * b + dz) * size, 0.02)
    mirrored = _reflected(cosine, 1.0 / REFRACTION)
    ux, uy, uz = dx - 2.0 * cosine * a * size, dy - 2.0 * cosine * b * size, dz - 2.0 * cosine * size
    bright = mirrored * _sky(s, ux, uy, min(uz, -0.01))
    for i in range(3):
        seen[i] = bright + (1.0 - mirrored) * s.glow[i] / (s.attenuation[i] + s.fading[i] + 1e-9) * s.above * s.entered


@compiled
def _daylight(s: Any, tile: Array, x: Array, normal: Array, deeper: Array, fresh: Array, arrived: Array) -> None:
    """Illuminance (lux) that daylight brings to a face at x (about the base) with this normal (N)."""
    depth = x[2] - s.surface
    up = -normal[2]
    if depth <= 0.0:  # in air
        straight = max(0.0, normal[0] * s.high[0] + normal[1] * s.high[1] + normal[2] * s.high[2])
        lux = s.above * ((1.0 - s.sky) * straight / max(-s.high[2], 0.05) + s.sky * (0.5 + 0.5 * up))
        for i in range(3):
            arrived[i] = lux
        return
    straight = max(0.0, normal[0] * s.sun[0] + normal[1] * s.sun[1] + normal[2] * s.sun[2]) / max(-s.sun[2], 0.05)
    gain = 1.0
    if straight > 0.0 and depth < _CAUSTICS_M:
        slant = depth / max(-s.sun[2], 0.3)
        bend = _tile_at(tile, s.north + x[0] + slant * s.sun[0], s.east + x[1] + slant * s.sun[1], 2)
        gather = depth * math.exp(-depth / 3.0) * (1.0 - depth / _CAUSTICS_M)
        gain = 1.0 / max(1.0 + (1.0 - 1.0 / REFRACTION) * gather * bend, 0.3)
    diffuse = 0.5 + 0.5 * up + _BACK * (0.5 - 0.5 * up)
    direct = (1.0 - s.sky) * math.exp(-s.spreading * depth)
    for i in range(3):
        arrived[i] = fresh[i] * deeper[i] * (direct * straight * gain + (1.0 - direct) * diffuse)


@compiled
def _add_veil(veil: Array, ranges: Array, row: int, column: int, r: float, out: Array) -> None:
    """Add the veil of lamps up to range r (m), between the cells of its table."""
    y, z = row / COARSE, column / COARSE
    a, b = int(y), int(z)
    p, q = y - a, z - b
    last = len(ranges) - 1
    step = math.log(r / ranges[0]) / math.log(ranges[last] / ranges[0]) * last if r > ranges[0] else 0.0
    m = min(int(step), last - 1)
    w = min(step - m, 1.0)
    near = min(r / ranges[0], 1.0)
    for i in range(3):
        low = (veil[a, b, m, i] * (1.0 - q) + veil[a, b + 1, m, i] * q) * (1.0 - p) + (
            veil[a + 1, b, m, i] * (1.0 - q) + veil[a + 1, b + 1, m, i] * q
        ) * p
        m += 1
        high = (veil[a, b, m, i] * (1.0 - q) + veil[a, b + 1, m, i] * q) * (1.0 - p) + (
            veil[a + 1, b, m, i] * (1.0 - q) + veil[a + 1, b + 1, m, i] * q
        ) * p
        m -= 1
        out[i] += near * (low * (1.0 - w) + high * w)
