"""Logs are opened by their first bytes; recordings in parts are one log."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from playback_rig import Dive, recorded

from uwserver.cli.recordings.export import export
from uwserver.cli.recordings.log import log_command
from uwserver.logfiles import LogError, open_log
from uwserver.logfiles.log import foreign
from uwserver.logfiles.readers.opening import open_parts
from uwserver.packages import install_command
from uwserver.recording.parts import Rotation
from uwserver.recording.player.importing import import_log
from uwserver.recording.player.track import Track
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.tracks import read_track
from uwserver.sensors.truth import Truth


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(LogError, match=r"gone\.mcap: it cannot be opened as a log: No such file"):
        open_log(tmp_path / "gone.mcap")


@pytest.mark.parametrize("content", [b"", b"\x00" * 100, b"PK\x03\x04" + b"\xff" * 500])
def test_what_is_no_log_is_told(tmp_path, content):
    file = tmp_path / "some.zip"
    file.write_bytes(content)
    with pytest.raises(LogError, match=r"some\.zip"):
        open_log(file)


@pytest.mark.parametrize(
    ("begin", "name", "module", "package"),
    [
        (b"#ROSBAG V2.0\n", "a.bag", "rosbags.rosbag1", "rosbags"),
        (b"ULog\x01\x12\x35", "a.ulg", "pyulog", "pyulog"),
        (b"PAR1", "a.parquet", "pyarrow", "pyarrow"),
    ],
)
def test_a_missing_package_is_told_with_what_brings_it(tmp_path, monkeypatch, begin, name, module, package):
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(begin)
    with pytest.raises(
        LogError, match=re.escape(f"the package {package} is missing: {install_command('uwserver[logs]')}")
    ):
        open_log(tmp_path / name)


def test_errors_of_foreign_parsers_are_one_kind(tmp_path):
    class Strange(Exception):
        pass

    for error, told in (
        (Strange("a\nb"), "a b"),
        (MemoryError(), "damaged"),
        (ImportError("x", name="google.protobuf"), "protobuf"),
    ):
        with pytest.raises(LogError, match=told), foreign(tmp_path, "it"):
            raise error
    with pytest.raises(KeyboardInterrupt), foreign(tmp_path, "it"):
        raise KeyboardInterrupt


def script(dive: Dive) -> None:
    dive.go(500)
    dive.call("world/reset")
    dive.go(500)


def test_parts_are_one_log(tmp_path: Path) -> None:
    recorded(tmp_path / "one.mcap", 600)
    recorded(tmp_path / "run.mcap", 600, rotation=Rotation(most_s=1.0))
    one, log = open_log(tmp_path / "one.mcap"), open_parts(tmp_path / "run.mcap")
    name = "rov/pressure"
    assert [(d.t_ns, d.value) for d in log.read([name])] == [(d.t_ns, d.value) for d in one.read([name])]
    assert log.topics[name].count == one.topics[name].count
    assert (log.start_ns, log.end_ns, log.epoch_ns) == (one.start_ns, one.end_ns, one.epoch_ns)
    span = (900_000_000, 1_100_000_000)
    assert [d.t_ns for d in log.read([name], *span)] == [d.t_ns for d in one.read([name], *span)]
    one.close()
    log.close()
    told = CliRunner().invoke(log_command, [str(tmp_path / "run.mcap")]).output
    assert "recording of uwserver, 2.5" in told
    for stem in ("one", "run"):
        arguments = [str(tmp_path / f"{stem}.mcap"), "--to", "csv", "--topics", name]
        assert CliRunner().invoke(export, arguments).exit_code == 0
    (table,) = (tmp_path / "run_csv").rglob("*pressure*.csv")
    (same,) = (tmp_path / "one_csv").rglob("*pressure*.csv")
    assert table.read_text() == same.read_text()


def test_after_a_reset_times_go_on_and_a_missing_part_is_told(tmp_path: Path) -> None:
    dive = recorded(tmp_path / "run.mcap", script=script, rotation=Rotation(most_s=1.0))
    log = open_parts(tmp_path / "run.mcap")
    times = [d.t_ns for d in log.read(["rov/pressure"])]
    assert times == sorted(times)
    assert len(times) == len([s for run in dive.samples for s in run if s.port == "rov/pressure"])
    log.close()
    (tmp_path / "run.0002.mcap").unlink()
    with pytest.raises(LogError, match="is missing"):
        open_parts(tmp_path / "run.mcap")


def test_a_track_of_an_external_vehicle_goes_through_all_parts(tmp_path: Path) -> None:
    told = {"rov": VehicleEntry(model="bluerov2", truth=Truth(rate_hz=20))}
    with Dive(
        tmp_path / "run.mcap", load(Scenario(schema=1, vehicles=told), adapters={}), 0, Rotation(most_s=1.0)
    ) as dive:
        dive.go(700)
    entry = VehicleEntry(model="bluerov2", kind="external", log="run.mcap", track="rov/truth/pose", start=0.0)
    track, _ = read_track(entry, tmp_path)
    assert (tmp_path / "run.0003.mcap").is_file()
    assert track.t_ns[-1] > 2_800_000_000


def test_what_is_played_by_a_mapping_goes_through_all_parts(tmp_path: Path) -> None:
    recorded(tmp_path / "run.mcap", 700, rotation=Rotation(most_s=1.0))
    (tmp_path / "map.toml").write_text(
        'format = "uwserver-log-mapping-1"\n[ports."a/depth"]\ntopic = "rov/depth"\nfields.depth = "value.depth"\n'
    )
    import_log(tmp_path / "run.mcap", tmp_path / "map.toml", tmp_path / "made.mcap")
    track = Track(tmp_path / "made.mcap")
    track.close()
    assert track.runs[0].to_ns > 2_800_000_000
