"""`uwserver export`."""

import itertools
import re
import shlex
from pathlib import Path

import bin_rig
import pytest
from click.testing import CliRunner
from logs_rig import telemetry, tlog

from uwserver.cli import main
from uwserver.cli.recordings.export import export
from uwserver.logfiles import LogError, open_log
from uwserver.ports import Event, Field, Port, Sample
from uwserver.recording.format import StateHash
from uwserver.recording.writer import RecordingWriter

PAGE = Path(__file__).parents[4] / "docs" / "how-to" / "logs.md"


@pytest.fixture
def dive(tmp_path):
    file = tmp_path / "dive.tlog"
    file.write_bytes(tlog(telemetry(3.0) + telemetry(3.0, system=2)))
    return file


def run(*args):
    return CliRunner().invoke(export, [str(arg) for arg in args])


@pytest.mark.parametrize(
    ("kind", "made"),
    [
        ("csv", "dive_csv/log.json"), ("parquet", "dive_parquet/1_1_ATTITUDE.parquet"), ("netcdf", "dive.nc"), ("mat", "dive.mat"),
        ("rosbag2", "dive_rosbag2/metadata.yaml"), ("alog", "dive.alog"),
    ],
)  # fmt: skip
def test_every_format(dive, kind, made):
    result = run(dive, "--to", kind)
    assert result.exit_code == 0, result.output
    assert (dive.parent / made).is_file()
    again = run(dive, "--to", kind)
    assert again.exit_code == 1
    assert "is there already" in again.output


@pytest.mark.parametrize("kind", ["csv", "rosbag2", "alog", "tlog", "mat"])
def test_nothing_is_left_of_one_that_fails(dive, kind, monkeypatch):

    def breaks(self, *args, **more):
        yield from itertools.islice(whole(self, *args, **more), 20)
        raise LogError("the file is damaged here")

    kept = open_log(dive)
    whole = type(kept).read
    kept.close()
    monkeypatch.setattr(type(kept), "read", breaks)
    result = run(dive, "--to", kind, "-o", dive.parent / "made")
    assert result.exit_code == 1, result.output
    assert [file.name for file in dive.parent.iterdir()] == ["dive.tlog"]
    monkeypatch.undo()
    assert run(dive, "--to", kind, "-o", dive.parent / "made").exit_code == 0
    assert len(list(dive.parent.iterdir())) == 2


def test_some_topics_of_it(dive, tmp_path):
    assert run(dive, "--to", "csv", "-o", tmp_path / "o", "--topics", "2/*/ATTITUDE").exit_code == 0
    assert sorted(f.name for f in (tmp_path / "o").iterdir()) == ["2_1_ATTITUDE.csv", "log.json"]
    result = run(
        dive, "--to", "tlog", "-o", tmp_path / "o.tlog", "--topics", "vehicle_2", "--topics", "vehicle_2/attitude"
    )
    assert result.exit_code == 0
    assert "left out, because no message fits: vehicle_2/attitude" in result.output
    assert set(open_log(tmp_path / "o.tlog").topics) == {
        "1/1/HEARTBEAT",
        "1/1/ATTITUDE_QUATERNION",
        "1/1/LOCAL_POSITION_NED",
    }


@pytest.mark.parametrize(
    ("args", "told"),
    [
        (("--to", "csv", "--topics", "3/**"), 'no topic "3/**"'),
        (("--to", "alog", "--mapping", "gone.toml"), "gone.toml: No such file"),
    ],
)
def test_mistakes_are_told(dive, args, told):
    result = run(dive, *args)
    assert result.exit_code == 1
    assert told in result.output
    assert not (dive.parent / "dive_csv").exists()


def test_a_log_without_poses(tmp_path):
    (tmp_path / "a.csv").write_text("t_s,x\n0,1\n1,2\n")
    result = run(tmp_path / "a.csv", "--to", "alog")
    assert result.exit_code == 1
    assert "give a mapping" in result.output


def silent_dive(file: Path) -> Path:
    """A recording of ours whose altimeter never had the bottom, with topics that are for replay and viewers."""
    near = Port(
        "rov/altimeter", "sensor", "altimeter", (Field("range", "m", "Range."), Field("n", "1", "Pings.")), "", 1.0
    )
    odd = Port("rov/leak", "sensor", "leak", (Field("wet", "1", "Wet."),), "", 1.0)
    with file.open("wb") as out:
        writer = RecordingWriter(out, {"format": "x"}, {near.path: near, odd.path: odd})
        for k in range(3):
            writer.sample(Sample(near.path, k, k, k, False, (None, 1.0)), {near.path: near})
            writer.sample(Sample(odd.path, k, k, k, True, (1.0,)), {odd.path: odd})
        writer.event(Event("paused", 1, 2, "so"))
        writer.hash(StateHash(0, 1, "ab"), 2)
        writer.finish()
    return file


@pytest.mark.parametrize("kind", ["tlog", "rosbag2"])
def test_a_sensor_that_never_had_a_valid_sample_is_told_as_that(tmp_path, kind):
    result = run(silent_dive(tmp_path / "a.mcap"), "--to", kind)
    assert result.exit_code == 0, result.output
    assert "left out, because no sample was valid: rov/altimeter" in result.output
    assert "left out, because no message fits: rov/leak" in result.output


def test_topics_for_replay_and_viewers_are_written_on_request_alone(tmp_path):
    file = silent_dive(tmp_path / "a.mcap")
    result = run(file, "--to", "csv")
    assert "1 topics for replay, playback and viewers are left out: --topics '**' has them" in result.output
    plain = {"rov_altimeter.csv", "rov_leak.csv", "uwserver_events.csv", "log.json"}
    assert {made.name for made in (tmp_path / "a_csv").iterdir()} == plain
    assert run(file, "--to", "csv", "--topics", "**", "-o", tmp_path / "all").exit_code == 0
    assert {made.name for made in (tmp_path / "all").iterdir()} == plain | {"uwserver_hashes.csv"}


def test_every_command_of_the_how_to(dive, tmp_path, monkeypatch, capsys):
    port = Port("rov/depth", "sensor", "depth", (Field("depth", "m", "Depth."),), "Depth.", 1.0)
    with (tmp_path / "run.mcap").open("wb") as file:
        writer = RecordingWriter(file, {"format": "x"}, {port.path: port})
        for k in range(3):
            writer.sample(Sample(port.path, k, k, k, True, (1.5,)), {port.path: port})
        writer.finish()
    (tmp_path / "dive.bin").write_bytes(bin_rig.dive())
    monkeypatch.chdir(tmp_path)
    text = PAGE.read_text(encoding="utf-8")
    commands = re.findall(r"^uwserver ((?!run ).*)$", text, re.M)
    assert len(commands) == 6
    for command in commands:
        words, _, target = command.partition(" > ")
        result = CliRunner().invoke(main, shlex.split(words))
        assert result.exit_code == 0, (command, result.output)
        if target:
            (tmp_path / target).write_text(result.output)
    assert "[tracks.filter]" in (tmp_path / "dive.toml").read_text()
    assert (tmp_path / "dive_bag" / "metadata.yaml").is_file()
    exec(text.split("```python\n")[1].split("```")[0], {})
    assert capsys.readouterr().out.startswith("100000 ")
