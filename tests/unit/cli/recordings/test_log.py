"""`uwserver log`."""

import json

import pytest
from click.testing import CliRunner
from logs_rig import telemetry, tlog

from uwserver.cli.recordings.log import log_command, printable
from uwserver.logfiles.mapping import parse_mapping


@pytest.fixture
def dive(tmp_path):
    file = tmp_path / "dive.tlog"
    frames = telemetry(5.0)
    file.write_bytes(tlog(frames + [(t + 30_000_000, frame) for t, frame in telemetry(5.0)]))
    return str(file)


def told(*args):
    result = CliRunner().invoke(log_command, args)
    assert result.exit_code == 0, result.output
    return result.output


def test_what_is_in_a_log(dive):
    text = told(dive)
    assert "MAVLink telemetry, 34.900 s, 5 topics" in text
    assert "from 2025-10-09T08:53:20.000Z to 2025-10-09T08:53:54.900Z" in text
    assert "! 1/1/ATTITUDE: no data for 25.100 s from 4.900 s" in text
    assert "1/1/ATTITUDE" in text
    assert "roll [rad]" in text
    assert "tracks (--mapping): vehicle_1, vehicle_1_odometry" in text


def test_as_json(dive):
    found = json.loads(told(dive, "--json"))
    assert found["kind"] == "tlog"
    topic = next(t for t in found["topics"] if t["name"] == "1/1/ATTITUDE")
    assert topic["count"] == 100
    assert topic["rate_hz"] == pytest.approx(99 / 34.9, rel=1e-3)
    assert {"name": "roll", "type": "float", "unit": "rad", "frame": ""} in topic["fields"]


def test_the_mapping_can_be_read(dive):
    mapping = parse_mapping(told(dive, "--mapping"))
    assert mapping.tracks["vehicle_1"].position.topic == "1/1/LOCAL_POSITION_NED"


def test_what_is_no_log_ends_with_a_text(tmp_path):
    (tmp_path / "x.log").write_bytes(b"hello")
    result = CliRunner().invoke(log_command, [str(tmp_path / "x.log")])
    assert result.exit_code == 1
    assert "unknown format, the file begins with" in result.output


def test_names_in_a_log_cannot_command_a_terminal(tmp_path):
    file = tmp_path / "a.alog"
    file.write_bytes(b"0.1 \x1b[2J\x1b]0;x\x07 p 1\n0.2 B\xc2\x9b31m p 1\n")
    assert not set("\x1b\x07\x9b") & set(told(str(file)))
    assert printable("a\nb\x1b") == "a\ufffdb\ufffd"
