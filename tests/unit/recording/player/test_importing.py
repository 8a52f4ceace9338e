"""Logs of other origins as recordings: bodies where their poses say, ports in SI, and texts that say why not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from uwserver.logfiles import Datum, Log, open_log
from uwserver.ports import Sample
from uwserver.recording.player import importing
from uwserver.recording.player.chunks import NotPlayable
from uwserver.recording.player.importing import import_log
from uwserver.recording.player.track import Track
from uwserver.world.external.track import PoseTrack

MAPPING = """
format = "uwserver-log-mapping-1"
[tracks."my sub"]
position = { topic = "dive", north = "north_m", east = "east_m", depth = "depth_m" }
attitude = { topic = "dive", unit = "deg", yaw = "yaw_deg" }
[ports."rov/battery"]
topic = "dive"
kind = "battery"
fields.voltage = { field = "battery_mV", unit = "mV" }
fields.place = ["north_m", "east_m"]
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    lines = ["t_s,north_m,east_m,depth_m,yaw_deg,battery_mV"]
    lines += [f"{0.1 * k:.1f},{0.5 * k:.1f},{-k},{2 + 0.1 * k:.1f},90.0,{16000 - k}" for k in range(51)]
    path = tmp_path / "dive.csv"
    path.write_text("\n".join(lines))
    return path


def played(track: Track) -> list[Sample]:
    found = []
    while track.head_item is not None:
        item = track.pop()
        sample = track.messages.sample(item.message, track.scenes[0].ports) if item.type == "sample" else None
        if sample is not None:
            found.append(sample)
    return found


def test_rules_find_poses_and_bodies_follow_them(log: Path, tmp_path: Path) -> None:
    assert import_log(log, None, tmp_path / "x.mcap") == ()
    track = Track(tmp_path / "x.mcap")
    (body,) = track.scenes[0].bodies
    assert (track.runs[0].from_ns, track.runs[0].to_ns) == (0, 5_000_000_000)
    track.seek(0, 2_000_000_000)
    assert track.state is not None
    np.testing.assert_allclose(track.state.poses[0, :3], [10.0, -20.0, 4.0], atol=0.4)
    half = math.sqrt(0.5)
    np.testing.assert_allclose(track.state.poses[0, 3:], [half, 0.0, 0.0, half], atol=1e-6)
    ports = track.scenes[0].ports
    assert ports[f"{body.name}/pose"].rate_hz == pytest.approx(10.0)
    assert track.head.resolved.objects[body.like].name == body.name
    track.close()


def test_a_mapping_gives_names_and_ports_in_si(log: Path, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(MAPPING)
    import_log(log, tmp_path / "map.toml", tmp_path / "x.mcap")
    track = Track(tmp_path / "x.mcap")
    port = track.scenes[0].ports["rov/battery"]
    assert [(field.name, field.unit, field.shape) for field in port.fields] == [
        ("voltage", "V", ()), ("place", "1", (2,))]  # fmt: skip
    assert (port.kind, port.rate_hz) == ("battery", pytest.approx(10.0))
    samples = played(track)
    battery = [sample for sample in samples if sample.port == "rov/battery"]
    assert len(battery) == 51
    assert (battery[10].t_ns, battery[10].seq) == (1_000_000_000, 10)
    assert battery[10].value == (pytest.approx(15.99), (5.0, -10.0))
    assert len([sample for sample in samples if sample.port == "my_sub/pose"]) == 51
    assert [sample.t_ns for sample in samples] == sorted(sample.t_ns for sample in samples)
    track.close()


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"\0\1\2\3", "unknown format"),
        (b"", "empty"),
        (b"\x89MCAP0\r\n", "log"),
        (b"t_s,colour\n0,1\n1,2\n", "no mapping finds a pose or a port"),
    ],
)
def test_what_is_no_log_or_says_nothing_is_told(tmp_path: Path, data: bytes, text: str) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(data)
    with pytest.raises(NotPlayable, match=text):
        import_log(path, None, tmp_path / "x.mcap")
    assert not (tmp_path / "x.mcap").exists()


def test_a_mapping_that_does_not_fit_is_told(log: Path, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(MAPPING.replace('"mV"', '"bushel"'))
    with pytest.raises(NotPlayable, match=r"map\.toml.*bushel"):
        import_log(log, tmp_path / "map.toml", tmp_path / "x.mcap")


class Early:
    """A log whose times begin a second before 0."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self.start_ns, self.end_ns = log.start_ns - 1_000_000_000, log.end_ns - 1_000_000_000

    def __getattr__(self, name: str) -> object:
        return getattr(self._log, name)

    def read(self, *args: object, **more: object) -> Iterator[Datum]:
        for t_ns, topic, value in self._log.read(*args, **more):  # type: ignore[arg-type]
            yield Datum(t_ns - 1_000_000_000, topic, value)


def test_a_log_that_begins_before_0_is_played_from_0(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importing, "open_parts", lambda path: Early(open_log(path)))
    import_log(log, None, tmp_path / "x.mcap")
    track = Track(tmp_path / "x.mcap")
    assert (track.runs[0].from_ns, track.runs[0].to_ns) == (0, 5_000_000_000)
    times = [sample.t_ns for sample in played(track)]
    assert (min(times), max(times)) == (0, 5_000_000_000)
    track.seek(0, 2_000_000_000)
    assert track.state is not None
    np.testing.assert_allclose(track.state.poses[0, :3], [10.0, -20.0, 4.0], atol=0.4)
    track.close()


def test_a_leap_of_years_has_states_only_where_poses_are() -> None:
    leap = 60 * 365 * 86400 * 10**9
    t_ns = np.array([0, 500_000_000, leap, leap + 10**9], dtype=np.int64)
    poses = PoseTrack(t_ns, np.zeros((4, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (4, 1)))
    times = np.array(importing._times({"rov": poses}, 0, leap + 10**9))
    assert len(times) < 100
    assert (times[0], times[-1]) == (0, leap + 10**9)
    for begin, end in ((0, 500_000_000), (leap, leap + 10**9)):
        within = times[(times >= begin) & (times <= end)]
        assert np.diff(np.concatenate(([begin], within, [end]))).max() <= 34_000_000


def test_dense_logs_of_many_days_get_fewer_states(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importing, "MOST_STATES", 1000)
    t_ns = np.arange(0, 1000 * 10**9, 10**8, dtype=np.int64)
    poses = PoseTrack(t_ns, np.zeros((len(t_ns), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(t_ns), 1)))
    times = importing._times({"rov": poses}, 0, int(t_ns[-1]))
    assert 400 <= len(times) <= 1010
    assert (times[0], times[-1]) == (0, t_ns[-1])
