"""Colours of things without a `looks` file."""

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
"""Colours by the name of a material, as in `environment.materials`."""
COATS: dict[str, Colour] = {
    "tiles": (0.52, 0.77, 0.82),
    "paint": (0.87, 0.45, 0.02),
    "wood": (0.25, 0.13, 0.05),
    "rubber": (0.02, 0.02, 0.02),
    "zinc": (0.62, 0.65, 0.66),
    "rust": (0.30, 0.09, 0.03),
}
"""Colours of materials without acoustic properties, as in the web view."""
CLEAN = frozenset((*COATS, "steel", "plastic"))
"""Materials without sand or growth on them."""
SEABED: Colour = MATERIALS["sand"]
STRUCTURE: Colour = MATERIALS["concrete"]
VEHICLE: Colour = (0.85, 0.62, 0.08)
"""The yellow of most hulls."""
OBJECT: Colour = (0.45, 0.28, 0.12)


def colour_of(material: str, otherwise: Colour) -> Colour:
    """Return the colour of a material; `otherwise` if it has none."""
    return MATERIALS.get(material) or COATS.get(material, otherwise)


def grey() -> Colour:
    """Return the default colour of a shape."""
    return ShapeView("sphere").colour
