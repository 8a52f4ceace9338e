"""How exact a sensor is, by its table: what a consumer of its samples may put into a covariance."""

from __future__ import annotations

import math
from collections.abc import Iterator

from uwserver.modifiers import Bias, GaussMarkov, WhiteNoise
from uwserver.sensors import (
    AltimeterConfig,
    AttitudeConfig,
    CtdConfig,
    ImuConfig,
    MagnetometerConfig,
    SensorConfig,
    SoundSpeedConfig,
)
from uwserver.sensors.motion.triad import TriadErrors
from uwserver.units import rad

Sigma = tuple[float, ...]

FLOOR = 0.618
"""Part of a first-order Gauss-Markov bias that is the floor of its Allan deviation, as `TriadErrors` has it."""


def sigmas(config: SensorConfig) -> dict[str, Sigma]:
    """Field -> 1-sigma of a sample, in the field's unit: of each axis, or one number for all components.

    White noise, slowly changing biases and those that are drawn once a run, summed in variance; scale errors, drifts without end and what
    modifiers of other kinds do are not in it. Fields whose errors are nowhere configured are not there, nor are those of a sensor that is `ideal`.
    """
    variances: dict[str, Sigma] = {}
    if not getattr(config, "ideal", False):
        for field, sigma in _own(config):
            variances[field] = tuple(part * part for part in sigma)
    for field, variance in _modified(config):
        before = variances.get(field, (0.0,))
        variances[field] = tuple(part + variance for part in before)
    return {field: tuple(map(math.sqrt, parts)) for field, parts in variances.items() if any(parts)}


def _own(config: SensorConfig) -> Iterator[tuple[str, Sigma]]:
    if isinstance(config, ImuConfig):
        yield "f_S", _triad(config.accelerometer, config.rate_hz)
        yield "w_S", _triad(config.gyroscope, config.rate_hz)
    elif isinstance(config, MagnetometerConfig):
        yield "field_S", _triad(config.errors, config.rate_hz)
    elif isinstance(config, AttitudeConfig):
        noise = config.noise_deg
        tilt = rad(math.hypot(config.tilt_sigma_deg, noise))
        yield "q_NS", (tilt, tilt, rad(math.hypot(config.heading_sigma_deg, config.heading_turn_on_deg, noise)))
    elif isinstance(config, AltimeterConfig):
        yield "range", (config.range_sigma_m,)
    elif isinstance(config, SoundSpeedConfig):
        yield "sound_speed", (math.hypot(config.sigma_mps, config.accuracy_mps),)
    elif isinstance(config, CtdConfig):
        yield "temperature", (math.hypot(config.temperature_sigma_degc, config.temperature_accuracy_degc),)
        yield "conductivity", (math.hypot(config.conductivity_sigma_Spm, config.conductivity_accuracy_Spm),)
        yield "pressure", (math.hypot(config.pressure_sigma_Pa, config.pressure_accuracy_Pa),)


def _triad(errors: TriadErrors, rate_hz: float) -> Sigma:
    white = errors.noise_density * math.sqrt(rate_hz)
    return (math.hypot(white, errors.instability / FLOOR, errors.turn_on),)


def _modified(config: SensorConfig) -> Iterator[tuple[str, float]]:
    for modifier in config.modifiers.values():
        if isinstance(modifier, WhiteNoise):
            yield modifier.field, modifier.sigma**2 + modifier.density**2 * config.rate_hz
        elif isinstance(modifier, GaussMarkov | Bias):
            yield modifier.field, modifier.sigma**2
