"""Configured errors as standard deviations: what a sensor's samples then show."""

from __future__ import annotations

import math

import pytest

from uwserver.modifiers import Bias, GaussMarkov, Quantise, WhiteNoise
from uwserver.scenario.scene.errors import sigmas
from uwserver.sensors import (
    AltimeterConfig,
    AttitudeConfig,
    CtdConfig,
    ImuConfig,
    MagnetometerConfig,
    PressureConfig,
    SoundSpeedConfig,
)
from uwserver.sensors.motion.triad import TriadErrors


def test_white_noise_grows_with_the_rate():
    errors = TriadErrors(noise_density=0.01)
    assert sigmas(ImuConfig(rate_hz=100, gyroscope=errors)) == {"w_S": (pytest.approx(0.1),)}
    assert sigmas(ImuConfig(rate_hz=400, gyroscope=errors)) == {"w_S": (pytest.approx(0.2),)}


def test_errors_add_in_variance():
    errors = TriadErrors(noise_density=0.03, instability=0.618 * 0.4, turn_on=1.2)
    assert sigmas(MagnetometerConfig(rate_hz=1, errors=errors))["field_S"] == (
        pytest.approx(math.sqrt(0.0009 + 0.16 + 1.44)),
    )


def test_modifiers_count():
    modifiers = {
        "a": WhiteNoise(field="pressure", sigma=3.0), "b": GaussMarkov(field="pressure", sigma=4.0, tau_s=10),
        "c": Bias(field="pressure", sigma=12.0), "d": Quantise(field="pressure", step=1.0), "e": WhiteNoise(field="temperature", density=0.1),
    }  # fmt: skip
    found = sigmas(PressureConfig(rate_hz=4, modifiers=modifiers))
    assert found == {"pressure": (pytest.approx(13.0),), "temperature": (pytest.approx(0.2),)}


def test_kinds_with_errors_of_their_own():
    attitude = sigmas(
        AttitudeConfig(rate_hz=10, tilt_sigma_deg=3.0, heading_sigma_deg=12.0, heading_turn_on_deg=3.0, noise_deg=4.0)
    )
    assert [math.degrees(part) for part in attitude["q_NS"]] == pytest.approx([5.0, 5.0, 13.0])
    assert sigmas(AltimeterConfig(rate_hz=10, range_sigma_m=0.02)) == {"range": (0.02,)}
    assert sigmas(SoundSpeedConfig(rate_hz=1, sigma_mps=0.3, accuracy_mps=0.4)) == {
        "sound_speed": (pytest.approx(0.5),)
    }
    assert sigmas(CtdConfig(rate_hz=1, pressure_sigma_Pa=30, pressure_accuracy_Pa=40)) == {
        "pressure": (pytest.approx(50),)
    }


def test_what_is_exact_or_unknown_is_not_told():
    assert sigmas(ImuConfig(rate_hz=100)) == {}
    assert sigmas(ImuConfig(rate_hz=100, ideal=True, gyroscope=TriadErrors(noise_density=0.01))) == {}
    assert sigmas(PressureConfig(rate_hz=100)) == {}
