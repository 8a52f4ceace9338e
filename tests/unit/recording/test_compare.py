"""Two recordings side by side, from the same run, a changed one, one of another rate, and files that end early."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from recording_rig import recorded

from uwserver.ports import Call, Command
from uwserver.recording import compare as compare_module
from uwserver.recording.changes import Changes, setting
from uwserver.recording.compare import compare
from uwserver.recording.reading import NotReplayable
from uwserver.recording.replay import replay

PUSH = Command("rov/thrusters", ((0.3,) * 8,), "me")
SECOND = 240


@pytest.fixture(scope="module")
def run(resolved_with_truth, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(
        tmp_path_factory.mktemp("run") / "a.mcap", resolved_with_truth, 3 * SECOND, {100: [PUSH], 500: [PUSH]}
    )


@pytest.fixture(scope="module")
def resolved_with_truth():
    from uwserver.scenario.load.scenario import load
    from uwserver.scenario.load.tables import Scenario

    vehicle = {"model": "bluerov2_heavy", "position_ned_m": [0.0, 0.0, 2.0], "truth": {}}
    return load(msgspec.convert({"schema": 1, "vehicles": {"rov": vehicle}}, Scenario), adapters={})


def changed(run: Path, new: Path, *given: str, from_s: float = 0.0) -> Path:
    replay(run, changes=Changes(tuple(map(setting, given)), (), from_s), record=new)
    return new


def test_a_recording_is_the_same_as_itself(run: Path):
    found = compare(run, run)
    assert found.is_same
    assert (found.only, found.first, found.states.equal, found.states.first_ns) == (((), ()), None, 4, None)
    assert found.ports["rov/truth/pose"].pairs == [60, 0]
    assert "rov/thrusters" in found.ports


def test_a_change_is_found_with_its_time(run: Path, tmp_path: Path):
    new = changed(run, tmp_path / "b.mcap", "environment.current.velocity_ned_mps=[0.3,0,0]", from_s=1.5)
    found = compare(run, new)
    assert not found.is_same
    assert found.first is not None
    assert 1_500_000_000 < found.first[2] < 1_520_000_000
    assert (found.states.equal, found.states.last_equal_ns, found.states.first_ns) == (1, 10**9, 2 * 10**9)
    pose = found.ports["rov/truth/pose"].fields["p_NB"]
    assert 0.01 < pose.rms < pose.largest < 0.45
    assert pose.largest_ns == 3 * 10**9
    assert found.ports["rov/thrusters"].fields["u"].is_same
    before = compare(run, new, end_ns=1_500_000_000)
    assert before.first is None
    assert all(each.is_same for pair in before.ports.values() for each in pair.fields.values())
    assert before.ports["rov/truth/pose"].samples == [30, 30]


def test_ports_of_one_side_alone_are_named(run: Path, tmp_path: Path):
    new = changed(run, tmp_path / "b.mcap", "vehicles.rov.sensors.imu.enabled=false")
    found = compare(run, new)
    assert found.only[0] == ("rov/imu",)
    assert found.only[1] == ()
    assert not found.is_same
    assert not compare(run, new, lambda port: port == "rov/imu").ports


def test_another_rate_is_interpolated(run: Path, tmp_path: Path):
    new = changed(run, tmp_path / "b.mcap", "vehicles.rov.truth.rate_hz=12")
    pair = compare(run, new).ports["rov/truth/pose"]
    assert pair.samples == [60, 36]
    assert pair.pairs[0] == 12, "every 250 ms both have a sample"
    assert pair.pairs[1] + pair.alone == 24
    assert 0.0 < pair.fields["p_NB"].largest < 1e-3


def test_one_without_its_end_is_compared_as_far_as_it_goes(run: Path, tmp_path: Path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(run.read_bytes()[:-30])
    found = compare(run, cut)
    assert found.states.equal == 4
    assert any("has no end" in text for text in found.remarks)


def test_behind_a_reset_nothing_is_compared(resolved_with_truth, tmp_path: Path):
    reset = Call("world/reset", {}, "me")
    path = recorded(tmp_path / "a.mcap", resolved_with_truth, SECOND, {SECOND // 2: [reset]})
    found = compare(path, path)
    assert found.is_same
    assert found.ports["rov/truth/pose"].samples == [10, 10]
    assert any("compared to 0.5 s, where a reset" in text for text in found.remarks)


def test_files_that_are_none_are_refused(run: Path, tmp_path: Path):
    (tmp_path / "b.mcap").write_bytes(b"hello")
    with pytest.raises(NotReplayable, match="not an MCAP file"):
        compare(run, tmp_path / "b.mcap")
    with pytest.raises(OSError, match="No such file"):
        compare(tmp_path / "c.mcap", run)


def test_long_files_are_streamed(run: Path, monkeypatch: pytest.MonkeyPatch):
    """No list of all samples is ever there."""
    most = 0
    pair = compare_module.Pairing.pair

    def counted(self, reached):
        nonlocal most
        pair(self, reached)
        most = max(most, *map(len, self._waiting))

    monkeypatch.setattr(compare_module, "PAIR_EVERY", 16)
    monkeypatch.setattr(compare_module.Pairing, "pair", counted)
    compare(run, run)
    assert 0 < most < 40


def test_states_of_runs_of_other_rates_are_compared_by_their_time(run: Path, tmp_path: Path):
    """A hash names its tick, which is another time there."""
    new = changed(run, tmp_path / "b.mcap", "world.rate_hz=480")
    assert compare(run, new).states.first_ns == 10**9
