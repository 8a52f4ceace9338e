"""Light in natural waters, by the types of Jerlov: what cameras and pictures need of the sea.

Downward irradiance defines the types (Jerlov, Marine Optics, 2nd ed. 1976, table XXVII). How a beam fades is known for IB to 5C from measurements
(Williamson and Hollins, Measured IOPs of Jerlov water types, Appl. Opt. 61 (2022) 9951), and for the others from models fitted to the irradiance
(Solonenko and Mobley, Inherent optical properties of Jerlov water types, Appl. Opt. 54 (2015) 5392, by three colours as in Droske et al., Path
tracing in production: the path of water, SIGGRAPH courses 2023). Between wavelengths of the tables: straight lines.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

Colours = tuple[float, float, float]
"""Red, green and blue."""
WAVELENGTHS_NM: Colours = (620.0, 540.0, 450.0)
WaterType = Literal["I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C"]
"""I to III: the open sea, from the clearest; 1C to 9C: coasts."""
_VEIL_DEPTH_M = 3.0


class WaterLight(NamedTuple):
    """What a water does with light of three colours (`WAVELENGTHS_NM`), 1/m.

    Attributes:
        attenuation: of a beam, c: what is absorbed or scattered.
        scattering: of a beam, b; its absorption is the difference.
        fading: of daylight downwards, K_d.
    """

    attenuation: Colours
    scattering: Colours
    fading: Colours

    def veil(self) -> Colours:
        """Colour of water seen without end from a few metres deep, its greatest part 1: the share of daylight that comes back is about as
        b / K_d (Gordon, Brown and Jacobs, Appl. Opt. 14 (1975) 417), and daylight has faded on its way."""
        parts = [b / k * math.exp(-k * _VEIL_DEPTH_M) for b, k in zip(self.scattering, self.fading, strict=True)]
        red, green, blue = (part / max(parts) for part in parts)
        return red, green, blue


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
