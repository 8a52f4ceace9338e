"""Compiled steps of sounding: beams of few columns are those of all, and the echo of a beam is where its energy is."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.sensors.acoustic.imaging import columns, soundings

RNG = np.random.default_rng(1)


def found(line: np.ndarray, least: float = 0.5, loss: float = 0.0, first: bool = False) -> tuple[float, float, int]:
    sound = np.asarray(line, np.float32)[None, None]
    place, level, hits, half = np.empty(1), np.empty(1), np.empty(1, np.int64), np.empty(1)
    soundings.find(sound, len(line), least, loss, first, place, level, hits, half)
    assert (half[0] > 0.0) == (hits[0] > 0)
    return float(place[0]), float(level[0]), int(hits[0])


def test_beams_of_their_columns_are_those_of_all_but_for_what_they_hardly_hear() -> None:
    x = np.arange(40)[None, :] - np.linspace(5.0, 35.0, 12)[:, None]
    pattern = np.exp(-0.5 * (x / 1.5) ** 2).astype(np.float32)
    sound = RNG.standard_normal((40, 64)).astype(np.float32)
    sound[:, :10] = 0.0
    exact, fast = np.empty((12, 64), np.float32), np.empty((12, 64), np.float32)
    columns.form_beams(pattern, sound, exact)
    bands = soundings.bands(pattern)
    soundings.form_bands(pattern, bands, sound, np.array([[0, 64]] * 12), 0, fast)
    assert (bands[:, 1] - bands[:, 0]).max() < 12
    assert np.abs(fast - exact).max() < 0.03 * np.abs(exact).max()
    spans, some = np.array([[k + 2, 3 * k + 5] for k in range(12)]), np.empty((12, 60), np.float32)
    soundings.form_bands(pattern, bands, sound, spans, 2, some)
    gates = np.arange(2, 62)
    assert np.array_equal(some, np.where((gates >= spans[:, :1]) & (gates < spans[:, 1:]), fast[:, 2:62], 0.0))


def test_bands_begin_and_end_where_a_beam_hears_something() -> None:
    pattern = np.array([[0.0, 1.0, 0.0, 0.5, 0.0], [1.0, 0.005, 0.0, 0.0, 0.0]], np.float32)
    assert soundings.bands(pattern).tolist() == [[1, 4], [0, 1]]


def test_an_echo_stands_at_the_centre_of_its_energy() -> None:
    gate = np.arange(200) + 0.5
    for width in (1.0, 5.0, 15.0):
        line = 100.0 * np.exp(-0.5 * ((gate - 90.3) / width) ** 2)
        place, level, hits = found(line * (90.3 / gate) ** 2)
        assert place == pytest.approx(90.3, abs=0.1)
        assert hits >= 2 * width
        assert 0.0 < level <= 100.0


def test_what_is_lost_by_absorption_does_not_pull_it_nearer() -> None:
    gate, loss = np.arange(200) + 0.5, 0.05
    line = 1e6 * np.exp(-0.5 * ((gate - 100.0) / 10.0) ** 2 - loss * (gate - 100.0)) * (100.0 / gate) ** 2
    assert found(line, loss=loss)[0] == pytest.approx(100.0, abs=0.2)
    assert found(line)[0] < 97.0


def test_the_strongest_or_the_first() -> None:
    line = np.zeros(100)
    line[20], line[70] = 2.0, 10.0
    assert found(line)[0] == pytest.approx(70.5)
    assert found(line, first=True)[0] == pytest.approx(20.5)


def test_nothing_above_the_noise_is_nothing() -> None:
    place, level, hits = found(np.full(50, 0.4))
    assert np.isnan(place)
    assert (level, hits) == (0.0, 0)


def crossed(
    zero: float, slope: float, place: float, half: float, seed: int | None = 0, noise: float = 0.0
) -> tuple[float, int]:
    """Place and method of an echo of gates 60 to 140, whose phase is 0 at a place and grows by a slope (rad) a gate."""
    gate = np.arange(200) + 0.5
    rng = np.random.default_rng(seed)
    bright = np.ones(200) if seed is None else np.abs(rng.standard_normal(200))
    in_the_beam = (np.abs(gate - 100.0) < 40.0) & (np.abs(slope * (gate - zero)) < 3.0)
    echo = np.where(in_the_beam, bright, 0.0)
    turn = 0.5 * slope * (gate - zero) + noise * rng.standard_normal(200)
    any_phase = np.exp(1j * rng.uniform(-3.0, 3.0, 200))
    sound, apart = (
        np.stack([w.real, w.imag])[:, None].astype(np.float32)
        for w in (echo * np.cos(turn) * any_phase, echo * np.sin(turn) * any_phase)
    )
    places, method = np.array([place]), np.zeros(1, np.uint8)
    spans = soundings.phase_gates(places, np.array([half]), 200)
    start = int(spans[0, 0])
    soundings.cross(sound, apart[:, :, start:].copy(), spans, start, 1e-6, np.array([half]), places, method)
    return float(places[0]), int(method[0])


@pytest.mark.parametrize("slope", [0.05, -0.05, 0.15])
@pytest.mark.parametrize("zero", [92.3, 104.8])
def test_the_zero_of_the_phase_is_found_from_any_part_of_the_echo(slope: float, zero: float) -> None:
    """However speckled it is, and though the window is of one bright part of it."""
    for phase, half in ((0.5, 40.0), (-1.0, 6.0), (1.0, 2.0)):
        place = zero + phase / abs(slope)
        assert crossed(zero, slope, place, half) == (pytest.approx(zero, abs=1e-3), soundings.BY_PHASE)


def test_phases_that_tell_nothing_leave_the_place() -> None:
    """Phases by chance; too few gates; no echo at all."""
    assert crossed(100.0, 0.05, 99.0, 10.0, noise=3.0) == (99.0, soundings.BY_AMPLITUDE)
    assert crossed(100.0, 0.0, 99.0, 10.0) == (99.0, soundings.BY_AMPLITUDE)
    place, method = crossed(100.0, 0.05, float("nan"), 0.0)
    assert np.isnan(place)
    assert method == soundings.NOTHING_FOUND


def test_a_zero_beside_the_echo_does_not_count() -> None:
    assert crossed(155.0, 0.05, 100.0, 2.0)[0] == 100.0
