"""Seeded errors that a scenario adds to a sensor's stream; one file a family, one line here each. Frames are never modifiers."""

from __future__ import annotations

from uwserver.modifiers.base import Measurement, Modifier, Stream
from uwserver.modifiers.bias import Bias
from uwserver.modifiers.delivery import Delay, Dropout
from uwserver.modifiers.noise import GaussMarkov, RandomWalk, WhiteNoise
from uwserver.modifiers.quantise import Quantise

ModifierConfig = WhiteNoise | GaussMarkov | RandomWalk | Bias | Quantise | Delay | Dropout

__all__ = [
    "Bias", "Delay", "Dropout", "GaussMarkov", "Measurement", "Modifier", "ModifierConfig", "Quantise", "RandomWalk", "Stream", "WhiteNoise",
]  # fmt: skip
