"""Colours of things that nobody gave a look."""

from __future__ import annotations

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
COATS: dict[str, Colour] = {
    "tiles": (0.52, 0.77, 0.82),
    "paint": (0.87, 0.45, 0.02),
    "wood": (0.25, 0.13, 0.05),
    "rubber": (0.02, 0.02, 0.02),
    "zinc": (0.62, 0.65, 0.66),
    "rust": (0.30, 0.09, 0.03),
}
"""Of materials that sound knows nothing of; as the page paints them."""
CLEAN = frozenset((*COATS, "steel", "plastic"))
"""On which neither sand lies nor anything grows."""
SEABED: Colour = MATERIALS["sand"]
STRUCTURE: Colour = MATERIALS["concrete"]
VEHICLE: Colour = (0.85, 0.62, 0.08)
"""The yellow of most hulls: seen farthest under water."""
OBJECT: Colour = (0.45, 0.28, 0.12)


def colour_of(material: str, otherwise: Colour) -> Colour:
    """Of a material; `otherwise` for one that has none."""
    return MATERIALS.get(material) or COATS.get(material, otherwise)


def grey() -> Colour:
    """Of a shape that nobody says anything of."""
    return ShapeView("sphere").colour
