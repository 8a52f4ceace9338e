"""Seeded errors that a scenario adds to the stream of a sensor: one file for each family, one line here for each kind.

A modifier never changes frames.
"""

from __future__ import annotations

from uwserver.modifiers.base import Measurement, Memory, Modifier, ModifierTable, Stream
from uwserver.modifiers.bias import Bias, Scale
from uwserver.modifiers.delivery import ClockDrift, Delay, Dropout, Reorder
from uwserver.modifiers.drift import Drift, RandomWalk
from uwserver.modifiers.misalignment import Misalignment
from uwserver.modifiers.noise import GaussMarkov, Outlier, WhiteNoise
from uwserver.modifiers.quantise import Quantise, Saturate

ModifierConfig = (
    WhiteNoise
    | GaussMarkov
    | RandomWalk
    | Drift
    | Bias
    | Scale
    | Misalignment
    | Outlier
    | Quantise
    | Saturate
    | Delay
    | Dropout
    | Reorder
    | ClockDrift
)

__all__ = [
    "Bias", "ClockDrift", "Delay", "Drift", "Dropout", "GaussMarkov", "Measurement", "Memory", "Misalignment", "Modifier", "ModifierConfig",
    "ModifierTable", "Outlier", "Quantise", "RandomWalk", "Reorder", "Saturate", "Scale", "Stream", "WhiteNoise",
]  # fmt: skip
