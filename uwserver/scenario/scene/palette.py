"""Colours of things that nobody gave a look, and of the water."""

from __future__ import annotations

from typing import NamedTuple

from uwserver.ports import ShapeView

Colour = tuple[float, float, float]
"""Red, green, blue, linear, 0..1."""

MATERIALS: dict[str, Colour] = {
    "sediment": (0.36, 0.31, 0.22),
    "mud": (0.19, 0.16, 0.12),
    "sand": (0.55, 0.47, 0.31),
    "gravel": (0.30, 0.29, 0.27),
    "rock": (0.22, 0.21, 0.20),
    "concrete": (0.42, 0.41, 0.38),
    "steel": (0.33, 0.36, 0.39),
    "plastic": (0.75, 0.45, 0.08),
}
"""By the name of a material, as `environment.materials` has them."""
SEABED: Colour = MATERIALS["sand"]
STRUCTURE: Colour = MATERIALS["concrete"]
VEHICLE: Colour = (0.85, 0.62, 0.08)
"""The yellow of most hulls: seen farthest under water."""
OBJECT: Colour = (0.45, 0.28, 0.12)


class WaterLooks(NamedTuple):
    """Attributes:
    attenuation: of a beam of light, red, green, blue, 1/m.
    colour: of water seen without end.
    """

    attenuation: Colour
    colour: Colour


JERLOV = "II"
WATERS: dict[str, WaterLooks] = {
    "I": WaterLooks((0.31, 0.09, 0.05), (0.010, 0.09, 0.24)),
    "II": WaterLooks((0.42, 0.19, 0.19), (0.014, 0.15, 0.21)),
    "III": WaterLooks((0.55, 0.31, 0.36), (0.025, 0.17, 0.16)),
    "3C": WaterLooks((0.72, 0.48, 0.62), (0.045, 0.19, 0.12)),
    "7C": WaterLooks((1.60, 1.50, 2.10), (0.080, 0.13, 0.05)),
}
"""By Jerlov's types of water (guess: representative of published curves at 620, 540 and 450 nm; nothing but pictures follows from them)."""


def colour_of(material: str, otherwise: Colour) -> Colour:
    """Of a material; `otherwise` for one that has none."""
    return MATERIALS.get(material, otherwise)


def grey() -> Colour:
    """Of a shape that nobody says anything of."""
    return ShapeView("sphere").colour
