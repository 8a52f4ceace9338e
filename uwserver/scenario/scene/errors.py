"""How exact a sensor is, by its table: what a consumer of its samples may put into a covariance."""

from __future__ import annotations

import math
from collections.abc import Iterator

from uwserver.modifiers import Bias, GaussMarkov, WhiteNoise
from uwserver.sensors import SensorTable
from uwserver.sensors.traits import Sigma


def sigmas(config: SensorTable) -> dict[str, Sigma]:
    """Field -> 1-sigma of a sample, in the field's unit: of each axis, or one number for all components.

    White noise, slowly changing biases and those that are drawn once a run, summed in variance; scale errors, drifts without end and what
    modifiers of other kinds do are not in it. Fields whose errors are nowhere configured are not there, nor are those of a sensor that is `ideal`.
    """
    variances: dict[str, Sigma] = {}
    if not getattr(config, "ideal", False):
        for field, sigma in config.traits().sigmas.items():
            variances[field] = tuple(part * part for part in sigma)
    for field, variance in _modified(config):
        before = variances.get(field, (0.0,))
        variances[field] = tuple(part + variance for part in before)
    return {field: tuple(map(math.sqrt, parts)) for field, parts in variances.items() if any(parts)}


def _modified(config: SensorTable) -> Iterator[tuple[str, float]]:
    for modifier in config.modifiers.values():
        if isinstance(modifier, WhiteNoise):
            yield modifier.field, modifier.sigma**2 + modifier.density**2 * config.rate_hz
        elif isinstance(modifier, GaussMarkov | Bias):
            yield modifier.field, modifier.sigma**2
