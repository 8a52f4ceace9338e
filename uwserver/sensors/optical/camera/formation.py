"""How light reaches the camera through water, pixel by pixel: revised image formation (compiled).

Each colour has one attenuation along the line of sight and another one for daylight downwards, and the veil of water in front of a thing does not
follow the attenuation of the light of the thing itself (D. Akkaynak and T. Treibitz, A revised underwater image formation model, CVPR 2018).
Sunlight decreases with depth, loses its direction more and more, and is focused by waves. Light of lamps comes in cones. On its way out it keeps
what is scattered forward; on its way to the lens it loses that part, which would only blur the picture. Surfaces are Lambertian. Illuminance is in
lux of daylight of each colour, radiance in lux/sr.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.environment.light import REFRACTION, Colours, Daylight, WaterLight
from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import entry, inlined
from uwserver.sensors.optical.camera.exponential import exponential
from uwserver.sensors.optical.camera.faces import GROWTH, SEABED, TILES
from uwserver.sensors.optical.camera.lamps import COARSE, SHADOW, intensity
from uwserver.sensors.optical.camera.patterns import grown, sampled, seabed, tiles
from uwserver.sensors.optical.camera.surface import TEXELS, TILE_M, fill, from_above, from_below, sky_towards, waves_at

SEA = np.dtype(
    [
        ("attenuation", "f8", (3,)),  # beam attenuation, 1/m
        ("dimming", "f8", (3,)),  # attenuation of lamplight on its way out, 1/m
        ("fading", "f8", (3,)),  # attenuation of daylight downwards, 1/m
        ("glow", "f8", (3,)),  # light of the water itself at the base, lux/sr per metre, see `WaterLight.glow`
        ("mirrored", "f8", (3,)),  # what the surface mirrors from below: the water in a level view, lux/sr
        ("body", "f8", (3,)),  # colour of the water as seen from above, lux/sr
        ("spreading", "f8"),  # loss of direction of sunlight, 1/m; that of green for all colours
        ("surface", "f8"),  # z of the surface about the base, m: negative under water
        ("wet", "i8"),  # 1: the camera is in the water
        ("above", "f8"),  # illuminance of the surface, lux
        ("entered", "f8"),  # part of it that enters the water
        ("sky", "f8"),  # part of it that comes from the sky and not from the sun
        ("sun", "f8", (3,)),  # unit vector towards the sun as seen in the water, N
        ("high", "f8", (3,)),  # the same in air
        ("north", "f8"),  # position of the base modulo the tile of waves, m
        ("east", "f8"),
        ("pixel", "f8"),  # angle of a pixel, rad
        ("waves", "f4", (TEXELS, TEXELS, 3)),  # see `surface.fill`
    ]
)
"""Light and water of a picture. The waves are a field, because numba would count references to a separate array for each pixel."""

_CAUSTICS_M = 10.0
_BACK = 0.08
"""Part of the downward light that comes back up from below."""
_LAMBERT = 1.0 / math.pi
"""Radiance of a white face over its illuminance."""
_NEVER = 1e6
_SURFACE = -2
_TURNED_AWAY = -0.2
"""At an outline, smooth normals may point a little away from the camera. Beyond this the camera is inside a wall, where it is dark."""
_LEAST_SEEN = 1e-4
"""If less than this part of a thing's light arrives, the veil hides it."""


def sea_row(
    t: float, water: WaterLight, day: Daylight, base: tuple[float, float, float], depth: float, pixel: float
) -> Any:
    """Return SEA (1) of a picture.

    Args:
        t: simulation time, s.
        water, day: light and water.
        base: base of the picture, m in N.
        depth: depth of the base below the surface, m; negative in air.
        pixel: angle of a pixel, rad.
    """
    row: Any = np.zeros(1, SEA)
    sea = row[0]
    sea["attenuation"], sea["fading"], sea["spreading"] = water.attenuation, water.fading, water.spreading()[1]
    sea["dimming"] = water.dimming()
    sea["surface"], sea["wet"], sea["above"], sea["sky"] = -depth, depth > 0.0, day.illuminance, day.sky
    sea["sun"], sea["entered"] = day.below()
    glow = day.illuminance * float(sea["entered"]) * np.array(water.glow())
    sea["glow"] = glow * np.exp(-max(depth, 0.0) * np.array(water.fading))
    sea["mirrored"] = glow / np.maximum(water.attenuation, 1e-6)
    sea["body"] = glow / (np.add(water.attenuation, water.fading) + 1e-9)
    level = math.cos(day.elevation)
    sea["high"] = level * math.cos(day.azimuth), level * math.sin(day.azimuth), -math.sin(day.elevation)
    sea["north"], sea["east"], sea["pixel"] = base[0] % TILE_M, base[1] % TILE_M, pixel
    fill(t, sea["waves"])
    return row


@entry
def form(
    sea: Array, origin: Array, direction: Array, distance: Array, met: Array, faces: Array, things: Array, shift: Array,
    texels: Array, levels: Array, lamps: Array, lit: Array, veil: Array, ranges: Array, width: int, first: int,
    radiance: Array,
) -> None:  # fmt: skip
    """Find the radiance of each pixel.

    Args:
        sea: SEA (1).
        origin, direction, distance, met: (n) rays and what they hit, see `rays.Buffers`.
        faces, things: FACE and THING.
        shift: (things, 3) origin of the faces in the frame of patterns, m.
        texels, levels: the atlas.
        lamps, lit: LAMP (m), and (m, cells) whether each lamp reaches what a cell sees, see `lamps.light_rays`.
        veil, ranges: the veil of lamps, see `lamps.fill_veil`.
        width: width of the picture, pixels.
        first: row of the picture in which these pixels begin.
        radiance: (n, 3) float32, receives the radiance.
    """
    s, wet = sea[0], sea[0].wet != 0
    cells = (width + SHADOW - 1) // SHADOW  # in a row
    steps = (len(ranges) - 1) / math.log(ranges[len(ranges) - 1] / ranges[0])
    for k in range(len(distance)):
        d = float(direction[k, 0]), float(direction[k, 1]), float(direction[k, 2])
        r, hit = min(distance[k], _NEVER), met[k]
        if (d[2] < 0.0) == wet and d[2] != 0.0:
            up = (s.surface - origin[k, 2]) / d[2]
            if 0.0 <= up < r:
                r, hit = up, _SURFACE
        x = origin[k, 0] + r * d[0], origin[k, 1] + r * d[1], origin[k, 2] + r * d[2]
        through, seen = _transmitted(s, wet, r), (0.0, 0.0, 0.0)
        if hit >= 0 and max(through[0], through[1], through[2]) > _LEAST_SEEN:
            face, pixel = faces[hit], s.pixel * r
            owner = things[face.thing]
            place = _in_frame_of(owner, x)
            normal, colour = _surface_at(face, owner, place, pixel, texels, levels)
            facing = -(normal[0] * d[0] + normal[1] * d[1] + normal[2] * d[2])
            if facing < 0.0 and face.sided == 0:
                normal, facing = (-normal[0], -normal[1], -normal[2]), -facing
            if facing > _TURNED_AWAY:
                lux = _daylight(s, x, normal)
                for m in range(len(lamps)):
                    if lit[m, (first + k // width) // SHADOW * cells + k % width // SHADOW] != 0:
                        lux = _lamplight(s, wet, lamps[m], x, normal, lux)
                moved = shift[face.thing, 0], shift[face.thing, 1], shift[face.thing, 2]
                colour = _with_pattern(face.pattern, place, moved, pixel, facing, normal, colour)
                seen = _LAMBERT * colour[0] * lux[0], _LAMBERT * colour[1] * lux[1], _LAMBERT * colour[2] * lux[2]
        elif hit == _SURFACE and wet:
            seen = from_below(s, d, x, r)
        elif hit == _SURFACE:
            seen = from_above(s, d, x)
        elif hit < 0 and not wet and r > 0.0:
            bright = sky_towards(s, d[0], d[1], d[2])
            seen = bright, bright, bright
        for i in range(3):
            radiance[k, i] = seen[i] * through[i] + (_water_light(s, i, d[2], r) if wet else 0.0)
        if veil.shape[0] > 0 and wet:
            _add_veil(veil, ranges, steps, (first + k // width, k % width), r, radiance[k])


@inlined
def _transmitted(s: Any, wet: bool, r: float) -> Colours:
    """Return the part of the light that gets through r m of water."""
    if not wet:
        return 1.0, 1.0, 1.0
    red, green, blue = s.attenuation[0], s.attenuation[1], s.attenuation[2]
    return exponential(-red * r), exponential(-green * r), exponential(-blue * r)


@inlined
def _water_light(s: Any, i: int, dz: float, r: float) -> float:
    """Return the light of a colour that the water adds along r m of a ray."""
    rate = s.attenuation[i] + s.fading[i] * dz
    # (1 - exp(-rate r)) / rate, or its series where the difference would lose its digits.
    column = (1.0 - exponential(-rate * r)) / rate if abs(rate * r) > 1e-4 else r * (1.0 - 0.5 * rate * r)
    return float(s.glow[i] * column)


@inlined
def _in_frame_of(owner: Any, x: Vec3) -> Vec3:
    """Return the point x (about the base, N) in the frame of the faces of a THING."""
    R, p = owner.R, owner.p
    a, b, c = x[0] - p[0], x[1] - p[1], x[2] - p[2]
    return (
        R[0, 0] * a + R[1, 0] * b + R[2, 0] * c,
        R[0, 1] * a + R[1, 1] * b + R[2, 1] * c,
        R[0, 2] * a + R[1, 2] * b + R[2, 2] * c,
    )


@inlined
def _surface_at(face: Any, owner: Any, place: Vec3, pixel: float, texels: Array, levels: Array) -> tuple[Vec3, Colours]:
    """Return normal (N) and colour of a face.

    Args:
        face: a row of FACE.
        owner: a row of THING.
        place: point on the face, in its frame.
        pixel: length that a pixel covers there, m.
        texels, levels: the atlas.
    """
    # Barycentric coordinates (Ericson, Real-Time Collision Detection, 3.4).
    d00 = d01 = d11 = d20 = d21 = 0.0
    for i in range(3):
        a, b = face.corners[1, i] - face.corners[0, i], face.corners[2, i] - face.corners[0, i]
        c = place[i] - face.corners[0, i]
        d00, d01, d11, d20, d21 = d00 + a * a, d01 + a * b, d11 + b * b, d20 + c * a, d21 + c * b
    whole = d00 * d11 - d01 * d01
    part = 1.0 / whole if whole > 0.0 else 0.0
    v = min(max((d11 * d20 - d01 * d21) * part, 0.0), 1.0)
    w = min(max((d00 * d21 - d01 * d20) * part, 0.0), 1.0)
    u = 1.0 - v - w
    nx = u * face.normals[0, 0] + v * face.normals[1, 0] + w * face.normals[2, 0]
    ny = u * face.normals[0, 1] + v * face.normals[1, 1] + w * face.normals[2, 1]
    nz = u * face.normals[0, 2] + v * face.normals[1, 2] + w * face.normals[2, 2]
    size = math.sqrt(nx * nx + ny * ny + nz * nz)
    size = 1.0 / size if size > 0.0 else 0.0
    R = owner.R
    normal = (
        (R[0, 0] * nx + R[0, 1] * ny + R[0, 2] * nz) * size,
        (R[1, 0] * nx + R[1, 1] * ny + R[1, 2] * nz) * size,
        (R[2, 0] * nx + R[2, 1] * ny + R[2, 2] * nz) * size,
    )
    colour = float(face.colour[0]), float(face.colour[1]), float(face.colour[2])
    if face.texture >= 0:
        s = u * face.uv[0, 0] + v * face.uv[1, 0] + w * face.uv[2, 0]
        t = u * face.uv[0, 1] + v * face.uv[1, 1] + w * face.uv[2, 1]
        colour = sampled(texels, levels, face.texture, s, t, pixel / max(face.texel, 1e-6), colour)
    return normal, colour


@inlined
def _with_pattern(
    pattern: int, place: Vec3, shift: Vec3, pixel: float, facing: float, normal: Vec3, colour: Colours
) -> Colours:
    """Return a colour with the pattern of its face."""
    x, y, z = place[0] + shift[0], place[1] + shift[1], place[2] + shift[2]
    if pattern == SEABED:
        colour = seabed(x, y, pixel / math.sqrt(max(facing, 0.05)), colour)
    elif pattern == GROWTH:
        colour = grown(x, y, z, -normal[2], pixel, colour)
    elif pattern == TILES:
        colour = tiles((x, y, z), normal, pixel / math.sqrt(max(facing, 0.05)), colour)
    return colour


@inlined
def _lamplight(s: Any, wet: bool, lamp: Any, x: Vec3, normal: Vec3, lux: Colours) -> Colours:
    """Return the illuminance `lux` of a face at x plus that of a lamp."""
    lx, ly, lz = x[0] - lamp.p[0], x[1] - lamp.p[1], x[2] - lamp.p[2]
    far = max(math.sqrt(lx * lx + ly * ly + lz * lz), 0.01)
    cosine = -(normal[0] * lx + normal[1] * ly + normal[2] * lz) / far
    if cosine <= 0.0:
        return lux
    bright = intensity(lamp, lx, ly, lz, far) / (far * far) * cosine
    if bright <= 0.0:
        return lux
    if not wet:
        return lux[0] + bright, lux[1] + bright, lux[2] + bright
    return (
        lux[0] + bright * exponential(-s.dimming[0] * far),
        lux[1] + bright * exponential(-s.dimming[1] * far),
        lux[2] + bright * exponential(-s.dimming[2] * far),
    )


@inlined
def _daylight(s: Any, x: Vec3, normal: Vec3) -> Colours:
    """Return the illuminance (lux) by daylight of a face at x (about the base) with this normal (N)."""
    depth = x[2] - s.surface
    up = -normal[2]
    if depth <= 0.0:  # in air
        straight = max(0.0, normal[0] * s.high[0] + normal[1] * s.high[1] + normal[2] * s.high[2])
        lux = s.above * ((1.0 - s.sky) * straight / max(-s.high[2], 0.05) + s.sky * (0.5 + 0.5 * up))
        return lux, lux, lux
    straight = max(0.0, normal[0] * s.sun[0] + normal[1] * s.sun[1] + normal[2] * s.sun[2]) / max(-s.sun[2], 0.05)
    gain = 1.0
    if straight > 0.0 and depth < _CAUSTICS_M:
        slant = depth / max(-s.sun[2], 0.3)
        _, _, bend = waves_at(s, s.north + x[0] + slant * s.sun[0], s.east + x[1] + slant * s.sun[1])
        gather = depth * exponential(-depth / 3.0) * (1.0 - depth / _CAUSTICS_M)
        gain = 1.0 / max(1.0 + (1.0 - 1.0 / REFRACTION) * gather * bend, 0.3)
    diffuse = 0.5 + 0.5 * up + _BACK * (0.5 - 0.5 * up)
    direct = (1.0 - s.sky) * exponential(-s.spreading * depth)
    lux = s.above * s.entered * (direct * straight * gain + (1.0 - direct) * diffuse)
    return (
        lux * exponential(-s.fading[0] * depth),
        lux * exponential(-s.fading[1] * depth),
        lux * exponential(-s.fading[2] * depth),
    )


@inlined
def _add_veil(veil: Array, ranges: Array, steps: float, pixel: tuple[int, int], r: float, out: Array) -> None:
    """Add the veil of lamps up to range r (m) to a pixel (row, column). It is interpolated between the cells of the table, whose ranges have `steps`
    entries per unit of their natural logarithm."""
    y, z = pixel[0] * (1.0 / COARSE), pixel[1] * (1.0 / COARSE)
    a, b = int(y), int(z)
    p, q = y - a, z - b
    step = math.log(r / ranges[0]) * steps if r > ranges[0] else 0.0
    m = min(int(step), len(ranges) - 2)
    w = min(step - m, 1.0)
    near = min(r / ranges[0], 1.0)
    for i in range(3):
        low = (veil[a, b, m, i] * (1.0 - q) + veil[a, b + 1, m, i] * q) * (1.0 - p) + (
            veil[a + 1, b, m, i] * (1.0 - q) + veil[a + 1, b + 1, m, i] * q
        ) * p
        high = (veil[a, b, m + 1, i] * (1.0 - q) + veil[a, b + 1, m + 1, i] * q) * (1.0 - p) + (
            veil[a + 1, b, m + 1, i] * (1.0 - q) + veil[a + 1, b + 1, m + 1, i] * q
        ) * p
        out[i] += near * (low * (1.0 - w) + high * w)
