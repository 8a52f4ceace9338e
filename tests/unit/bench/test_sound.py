"""Both ways of looking are measured in each water, against their bars; and the hard one has more than one ray to find."""

from __future__ import annotations

from uwserver_bench import cli, sound

from uwserver.environment.acoustics.boundaries import Boundaries
from uwserver.environment.acoustics.channel import channel_of
from uwserver.environment.column import WaterColumn


def test_a_row_for_the_first_and_one_for_all() -> None:
    rows = sound.bench_sound(quick=True, say=lambda line: None)
    assert len(rows) == 2 * len(sound.CASES)
    assert {row.at_most for row in rows} == {60.0, 1000.0}
    assert all(len(row.values) == 2 and min(row.values) > 0.0 for row in rows)
    assert "sound" in cli._MODULES["sensors"]


def test_what_is_measured_finds_rays() -> None:
    counts = []
    for water, x, a, b in sound.CASES.values():
        channel = channel_of(WaterColumn(water, 9.81, 1025.0), sound.FREQUENCY_HZ)
        counts.append(len(channel.paths(x, a, b, Boundaries(sound.BOTTOM_M))))
        assert channel.earliest(x, a, b, Boundaries(sound.BOTTOM_M)) is not None
    assert min(counts) >= 5
    assert counts[1] > 10
