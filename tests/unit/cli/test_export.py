"""`uwserver export`."""

import pytest
from click.testing import CliRunner
from logs_rig import telemetry, tlog

from uwserver.cli.export import export
from uwserver.logfiles import open_log


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


def test_some_topics_of_it(dive, tmp_path):
    assert run(dive, "--to", "csv", "-o", tmp_path / "o", "--topics", "2/*/ATTITUDE").exit_code == 0
    assert sorted(f.name for f in (tmp_path / "o").iterdir()) == ["2_1_ATTITUDE.csv", "log.json"]
    result = run(
        dive, "--to", "tlog", "-o", tmp_path / "o.tlog", "--topics", "vehicle_2", "--topics", "vehicle_2/attitude"
    )
    assert result.exit_code == 0
    assert "no message fits, so left out: vehicle_2/attitude" in result.output
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
