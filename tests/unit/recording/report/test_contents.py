"""The table at the top."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.ports import Field
from uwserver.recording.report.contents import Contents, Track, contents_of, distance_run, missing_samples
from uwserver.recording.report.reading import Recorded, Series


def test_a_circle_is_as_long_as_its_way() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 500)
    way = np.stack([3.0 * np.cos(turn), 3.0 * np.sin(turn), np.zeros(500)], axis=1)
    assert distance_run(way) == pytest.approx(6.0 * np.pi, rel=1e-4)


def test_trembling_is_no_way() -> None:
    assert distance_run(np.random.default_rng(0).normal(scale=5e-4, size=(1000, 3))) == 0.0


@pytest.mark.parametrize(
    ("seq", "missing"), [([0, 1, 2], 0), ([0, 3, 4, 9], 6), ([], 0), ([7], 0), ([0, 1, 2, 0, 1, 2], 0)]
)
def test_missing_numbers(seq: list[int], missing: int) -> None:
    assert missing_samples(np.array(seq, dtype=np.int64)) == missing


def test_an_order_is_no_estimate(recorded: Recorded) -> None:
    p = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    field = Field("p_N", "m", "", "N", (3,))

    def tracks(path: str, direction: str) -> list[Track]:
        ends = np.array([0.0, 1.0])
        told = Series(
            path,
            "autopilot",
            "Estimate" if direction == "sensor" else "",
            direction,
            {"p_N": field},
            ends,
            np.arange(2),
            np.ones(2, dtype=bool),
            {"p_N": p},
        )
        found = contents_of(type(recorded)(**{**vars(recorded), "series": {**recorded.series, path: told}}), ["rov"])
        return [track for track in found.tracks if track.is_estimate]

    assert tracks("rov/autopilot/position", "actuator") == []
    (track,) = tracks("rov/autopilot/other", "sensor")
    np.testing.assert_array_equal(track.p, p)


def test_what_a_run_did(contents: Contents) -> None:
    run = dict(contents.summary)
    assert run["scenario"] == "x"
    assert run["faults"] == "1"
    assert run["duration"].startswith("5.0 s simulated, 240 ticks")
    rov, other = contents.vehicles
    assert (rov.name, rov.model, other.name) == ("rov", "bluerov2_heavy", "other")
    rows = dict(rov.rows)
    assert rows["faults"] == "1 began"
    assert dict(other.rows)["faults"] == "none"
    truth = next(track for track in contents.tracks if track.vehicle == "rov")
    assert rows["largest depth"] == f"{truth.p[:, 2].max():.2f} m"
    assert float(rows["energy used"].split()[0]) > 0.0
    assert "missing by their numbers: 0" not in rows["samples"]  # one in ten depths is lost
    assert float(rows["errors within 3 sigma"].rstrip("%")) > 97.0
