"""Light in natural waters by the types of Jerlov, for cameras and pictures.

The types are defined by downward irradiance (Jerlov, Marine Optics, 2nd ed. 1976, table XXVII). The attenuation of a beam comes from measurements
for IB to 5C (Williamson and Hollins, Measured IOPs of Jerlov water types, Appl. Opt. 61 (2022) 9951), and for the others from models fitted to the
irradiance (Solonenko and Mobley, Inherent optical properties of Jerlov water types, Appl. Opt. 54 (2015) 5392, for three colours as in Droske et
al., Path tracing in production: the path of water, SIGGRAPH courses 2023). Values between the wavelengths of the tables are interpolated linearly.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

Colours = tuple[float, float, float]
"""Red, green and blue."""
WAVELENGTHS_NM: Colours = (620.0, 540.0, 450.0)
WaterType = Literal["I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C"]
"""I to III: the open sea, the clearest first; 1C to 9C: coasts."""
_VEIL_DEPTH_M = 3.0
ASYMMETRY = 0.924
"""Mean cosine of scattering in sea water as Petzold measured it, for Henyey and Greenstein's phase function (C. D. Mobley et al., Phase function
effects on oceanic light fields, Appl. Opt. 41 (2002) 1035)."""
_SIDEWAYS = 0.5
"""Ratio of the light seen horizontally to that of isotropic scattering. It was chosen to match a lake at 480 nm with b = 0.285 and c = 0.4 /m,
where the radiance is 0.03 /sr of the irradiance downwards (J. E. Tyler, Radiance distribution as a function of depth, Bull. Scripps Inst. Oceanogr.
7 (1960) 363; quoted from memory)."""


class WaterLight(NamedTuple):
    """Optical properties of a water type for three colours (`WAVELENGTHS_NM`), 1/m.

    Attributes:
        attenuation: attenuation of a beam by absorption and scattering, c.
        scattering: scattering of a beam, b; absorption is the difference.
        fading: attenuation of daylight downwards, K_d.
    """

    attenuation: Colours
    scattering: Colours
    fading: Colours

    def veil(self) -> Colours:
        """Return the colour of endless water, seen from a few metres deep; its greatest component is 1. The part of daylight that comes back is
        about proportional to b / K_d (Gordon, Brown and Jacobs, Appl. Opt. 14 (1975) 417), and daylight has faded on its way down."""
        parts = [b / k * math.exp(-k * _VEIL_DEPTH_M) for b, k in zip(self.scattering, self.fading, strict=True)]
        red, green, blue = (part / max(parts) for part in parts)
        return red, green, blue

    def glow(self) -> Colours:
        """Return the light that a metre of water scatters into a horizontal line of sight, 1/(m sr) of the irradiance downwards."""
        red, green, blue = (_SIDEWAYS * b / (4.0 * math.pi) for b in self.scattering)
        return red, green, blue

    def dimming(self) -> Colours:
        """Return the attenuation of a lamp's light, 1/m: a + b (1 - g), as most scattered light goes on forward and still arrives. It holds for
        lamps with wide cones: at 3 m it agrees within a tenth with a Monte Carlo simulation of photons, while c would give a third of it in
        type 1C."""
        red, green, blue = (c - b * ASYMMETRY for c, b in zip(self.attenuation, self.scattering, strict=True))
        return red, green, blue

    def spreading(self) -> Colours:
        """Return the rate at which sunlight loses its direction, 1/m: b (1 - g), by the similarity relation for many small deflections."""
        red, green, blue = (b * (1.0 - ASYMMETRY) for b in self.scattering)
        return red, green, blue


AIR = WaterLight((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""Air, for a camera out of the water."""


class Daylight(NamedTuple):
    """Light from above.

    Attributes:
        illuminance: on the surface, lux; 0 at night.
        elevation: elevation of the sun, rad.
        azimuth: azimuth of the sun, clockwise from north, rad.
        sky: part of the light that comes from the whole sky.
    """

    illuminance: float = 60_000.0
    elevation: float = 0.87
    azimuth: float = 0.0
    sky: float = 0.25

    def below(self) -> tuple[tuple[float, float, float], float]:
        """Return the unit vector (N) towards the sun as seen in still water, and the part of the light that enters. Sunlight is reflected by
        Fresnel's formulas; 6 % of the light of the sky is lost."""
        into, lost = math.cos(self.elevation) / REFRACTION, fresnel(math.sin(self.elevation), 1.0 / REFRACTION)
        entered = (1.0 - self.sky) * (1.0 - lost) + 0.94 * self.sky
        down = math.sqrt(1.0 - into * into)
        return (into * math.cos(self.azimuth), into * math.sin(self.azimuth), -down), entered


REFRACTION = 1.34
"""Refractive index of sea water relative to air (X. Quan and E. S. Fry, Appl. Opt. 34 (1995) 3477)."""


def fresnel(cosine: float, ratio: float) -> float:
    """Return the part of unpolarised light that a plane reflects.

    Args:
        cosine: cosine of the angle of incidence.
        ratio: refractive index before the plane over that behind it.
    """
    square = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    if square <= 0.0:
        return 1.0
    behind = math.sqrt(square)
    across = (ratio * cosine - behind) / (ratio * cosine + behind)
    along = (cosine - ratio * behind) / (cosine + ratio * behind)
    return 0.5 * (across * across + along * along)


WATER_TYPES: dict[WaterType, WaterLight] = {
    "I": WaterLight((0.310, 0.055, 0.013), (0.001, 0.002, 0.004), (0.291, 0.055, 0.019)),
    "IA": WaterLight((0.311, 0.058, 0.021), (0.002, 0.004, 0.007), (0.296, 0.059, 0.026)),
    "IB": WaterLight((0.400, 0.181, 0.175), (0.116, 0.123, 0.135), (0.301, 0.065, 0.036)),
    "II": WaterLight((0.454, 0.244, 0.258), (0.167, 0.178, 0.195), (0.320, 0.084, 0.068)),
    "III": WaterLight((0.574, 0.372, 0.421), (0.275, 0.289, 0.309), (0.359, 0.119, 0.136)),
    "1C": WaterLight((0.717, 0.526, 0.604), (0.411, 0.430, 0.455), (0.356, 0.124, 0.253)),
    "3C": WaterLight((0.948, 0.775, 0.888), (0.621, 0.648, 0.686), (0.386, 0.194, 0.395)),
    "5C": WaterLight((1.499, 1.363, 1.587), (1.151, 1.200, 1.270), (0.464, 0.304, 0.568)),
    "7C": WaterLight((2.123, 2.582, 3.950), (1.772, 2.394, 3.376), (0.528, 0.472, 0.890)),
    "9C": WaterLight((2.745, 3.529, 5.491), (2.347, 3.180, 4.496), (0.640, 0.690, 1.600)),
}
