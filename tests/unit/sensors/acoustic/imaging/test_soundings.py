"""Compiled steps of sounding: beams of few columns are those of all, and the echo of a beam is where its energy is."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.sensors.acoustic.imaging import columns, soundings

RNG = np.random.default_rng(1)


def found(line: np.ndarray, least: float = 0.5, loss: float = 0.0, first: bool = False) -> tuple[float, float, int]:
    sound = np.asarray(line, np.float32)[None, None]
    place, level, hits = np.empty(1), np.empty(1), np.empty(1, np.int64)
    soundings.find(sound, len(line), least, loss, first, place, level, hits)
    return float(place[0]), float(level[0]), int(hits[0])


def test_beams_of_their_columns_are_those_of_all_but_for_what_they_hardly_hear() -> None:
    x = np.arange(40)[None, :] - np.linspace(5.0, 35.0, 12)[:, None]
    pattern = np.exp(-0.5 * (x / 1.5) ** 2).astype(np.float32)
    sound = RNG.standard_normal((40, 64)).astype(np.float32)
    sound[:, :10] = 0.0
    exact, fast = np.empty((12, 64), np.float32), np.empty((12, 64), np.float32)
    columns.form_beams(pattern, sound, exact)
    bands = soundings.bands(pattern)
    soundings.form_bands(pattern, bands, sound, fast)
    assert (bands[:, 1] - bands[:, 0]).max() < 12
    assert np.abs(fast - exact).max() < 0.03 * np.abs(exact).max()


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
