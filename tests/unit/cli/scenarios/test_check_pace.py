"""What check tells of readings that come late, and of sonars that are asked for too many pings."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

import uwserver.cli.scenarios.check as commands
from uwserver.cli.scenarios.check import hasty, late
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load

BOTH = """schema = 1
[vehicles.rov]
model = "bluerov2_heavy"
[vehicles.rov.sensors.front]
kind = "camera"
rate_hz = 10
width = 640
height = 480
exposure_s = 0.01
read_out_s = {read_out_s}
latency_s = {latency_s}
[vehicles.rov.sensors.sonar]
kind = "multibeam"
rate_hz = {rate_hz}
beams = 256
bins = 512
range_m = {range_m}
processing_s = {processing_s}
"""
ENOUGH = {"read_out_s": 0.02, "latency_s": 0.15, "rate_hz": 10, "range_m": 30, "processing_s": 0.1}


@pytest.fixture
def loaded(tmp_path: Path) -> Resolved:
    """Of BOTH, with time for all."""
    return both(tmp_path)


def both(folder: Path, **changed: float) -> Resolved:
    path = folder / "both.toml"
    path.write_text(BOTH.format(**{**ENOUGH, **changed}), encoding="utf-8")
    return load(path, adapters={})


def test_what_has_time_is_not_told(loaded: Resolved) -> None:
    assert late(loaded) == []
    assert hasty(loaded) == []


def test_a_camera_that_must_wait_for_a_sonar_may_be_late(tmp_path: Path) -> None:
    """0.5 x 10 ms and 20 ms and 55 ms are enough for the 71 ms of its own, but not for those of the sonar too."""
    resolved = both(tmp_path, latency_s=0.055, range_m=3, processing_s=0.07)
    sensors = resolved.vehicles["rov"].vehicle.sensors
    camera, sonar = sensors["front"].computing_s, sensors["sonar"].computing_s
    assert camera == pytest.approx(0.0707, abs=1e-3)
    assert camera < 0.080 < camera + sonar
    line = late(resolved)[0]
    assert line.startswith(
        f"in time: rov/front has 80 ms from the start of a reading to its delivery, and may need {1e3 * (camera + sonar):.3g} ms: "
    )
    assert (
        f"{1e3 * camera:.3g} ms for itself and {1e3 * sonar:.3g} ms for rov/sonar, which may be computed before it"
        in line
    )
    for key in ("read_out_s", "latency_s", "width", "rate_hz"):
        assert key in line


def test_a_sonar_waits_for_a_piece_of_a_picture_that_is_due_later_but_for_all_of_one_that_is_due_before(
    tmp_path: Path,
) -> None:
    """3 m take 4 ms, and with processing_s = 0.06 that is less than the camera's picture alone."""
    given = {"range_m": 3, "processing_s": 0.06}
    assert late(both(tmp_path, **given)) == []
    front, line = late(both(tmp_path, **given, read_out_s=0.0, latency_s=0.05))
    assert front.startswith("in time: rov/front has 55 ms ")
    assert line.startswith("in time: rov/sonar has 64 ms ")
    assert "and 70.7 ms for rov/front, which may be computed before it" in line
    for key in ("processing_s", "latency_s", "beams", "rate_hz"):
        assert key in line


def test_of_a_picture_that_is_due_a_little_later_some_may_be_left(tmp_path: Path) -> None:
    """It has 80 ms and the ping 64: 16 of its 70.7 ms are done when a ping begins that is due before it."""
    resolved = both(tmp_path, range_m=3, processing_s=0.06, latency_s=0.055)
    line = late(resolved)[-1]
    assert line.startswith("in time: rov/sonar has 64 ms ")
    assert "and 54.7 ms for rov/front" in line


def test_alone_it_need_not_wait(tmp_path: Path) -> None:
    path = tmp_path / "alone.toml"
    text = BOTH.format(**{**ENOUGH, "latency_s": 0.055})
    path.write_text(text[: text.index("[vehicles.rov.sensors.sonar]")], encoding="utf-8")
    assert late(load(path, adapters={})) == []
    path.write_text(path.read_text(encoding="utf-8").replace("0.055", "0.035"), encoding="utf-8")
    (line,) = late(load(path, adapters={}))
    assert "may need 70.7 ms: 70.7 ms for itself. In real time" in line


LOOKING_DOWN = """schema = 1
[vehicles.rov]
model = "bluerov2_heavy"
[vehicles.rov.sensors.port_and_starboard]
kind = "side_scan"
rate_hz = 10
range_m = 5
processing_s = 0.0
[vehicles.rov.sensors.swath]
kind = "bathymetry"
rate_hz = 10
range_m = 1
processing_s = {processing_s}
[vehicles.rov.sensors.pencil]
kind = "profiler"
rate_hz = 20
range_m = 1
"""


@pytest.mark.parametrize("processing_s", [0.02, 0.0])
def test_sonars_that_look_down_cost_something_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, processing_s: float
) -> None:
    """4.4 ms of a swath and 0.6 ms of both sides do not fit into the 1.3 ms of a metre; a profiler reads within the tick and waits for nobody."""
    monkeypatch.setattr(commands, "installed_adapters", dict)
    path = tmp_path / "down.toml"
    path.write_text(LOOKING_DOWN.format(processing_s=processing_s), encoding="utf-8")
    lines = late(load(path, adapters={}))
    told = CliRunner().invoke(commands.check, [str(path)]).stderr
    assert "of a core while all of them are read (rov/swath 4 %, rov/port_and_starboard 1 %)" in told
    if processing_s:
        assert lines == []
        return
    (line,) = lines
    assert line.startswith("in time: rov/swath has 1.33 ms from the start of a reading to its delivery")
    assert "ms for rov/port_and_starboard, which may be computed before it" in line


def test_a_sonar_cannot_ping_more_often_than_its_echoes_come_back(tmp_path: Path) -> None:
    (line,) = hasty(both(tmp_path, rate_hz=60, range_m=100))
    assert line == (
        "rate: rov/sonar cannot ping rate_hz = 60 times a second: with range_m = 100 and overhead_s = 0.005 about 7.23 a second"
    )


def test_many_are_not_all_named(tmp_path: Path) -> None:
    path = tmp_path / "many.toml"
    text = BOTH.format(**{**ENOUGH, "rate_hz": 60, "range_m": 100})
    path.write_text(
        text.replace("[vehicles.rov.sensors.front]", "copies = { count = 10 }\n[vehicles.rov.sensors.front]"),
        encoding="utf-8",
    )
    lines = hasty(load(path, adapters={}))
    assert len(lines) == 5
    assert lines[-1] == "and 6 more cannot either"


def test_check_prints_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "installed_adapters", dict)
    both(tmp_path, rate_hz=60, range_m=100, latency_s=0.055)
    result = CliRunner().invoke(commands.check, [str(tmp_path / "both.toml")])
    assert result.exit_code == 0
    assert "\nin time: rov/front has 80 ms " in result.stderr
    assert "\nrate: rov/sonar cannot ping rate_hz = 60 " in result.stderr
