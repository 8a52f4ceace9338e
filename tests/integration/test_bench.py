"""`uwserver bench --quick` runs physics, real servers and their clients to the end: one part by day, all of them in the slow tests.

Speed is never judged here.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

PATIENCE_S = 1800  # some six minutes where nothing else runs
MAY_BE_ZERO = {
    "640 x 480 at 30/s in H.264 beside a vehicle at 240 Hz: added share of a core",
    "20 vehicles, a page at 30 states/s: added share of a core",
    "20 vehicles, no page: tick lateness p99",
    "what the clients add to it",
    "what the second thread adds to it",
    "20 idle modems, a tick",
    "a packet, each of 19 modems that hear it",
    "4 ground stations at the rates of QGroundControl: added share of a core",
    "other work on this machine meanwhile (none: idle)",
    *(f"server processor time a sample, {count} client(s)" for count in (1, 10, 50)),
    "frames repeated or lost meanwhile",
    "10 readers stopped for 0.5 s: samples dropped for them",
    "of the pictures of that camera arrive in time",
    "of the pictures of that multibeam arrive in time",
}

MAY_BE_ZERO_OF_A_FLOOD = ("for want of a processor", "what work of ours can delay a tick")

GROUPS = [
    "physics",
    "solids",
    "contact",
    "sensors",
    "swarm",
    "server",
    "start",
    "net",
    "moos",
    "mavlink",
    "ros",
    "sil",
    "web",
    "video",
    "logs",
    "decode",
    "flood",
]


def measured(folder: Path, *parts: str) -> tuple[dict, str]:
    """The report and what is printed."""
    file = folder / "bench.json"
    command = [sys.executable, "-m", "uwserver", "bench", *parts, "--quick", "--json", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(file.read_text()), done.stdout


def check(report: dict, printed: str) -> None:
    """Groups in their order, values above zero, and a line for each row."""
    assert report["format"] == "uwserver-bench-1"
    assert report["quick"] is True
    assert [row["group"] for row in report["rows"]] == sorted(
        (row["group"] for row in report["rows"]),
        key=GROUPS.index,
    )
    for row in report["rows"]:
        if row["verdict"] == "absent":
            assert row["note"]
        elif row["name"] not in MAY_BE_ZERO and not row["name"].endswith(MAY_BE_ZERO_OF_A_FLOOD):
            assert max(row["values"]) > 0.0 <= min(row["values"]), row["name"]
        assert any(line.startswith(row["name"]) for line in printed.splitlines())


def test_one_part_runs_to_its_end(tmp_path: Path) -> None:
    """That of pages: a server and its clients, in processes of their own."""
    report, printed = measured(tmp_path, "web")
    check(report, printed)
    assert {row["group"] for row in report["rows"]} == {"web"}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, str]:
    return measured(tmp_path_factory.mktemp("bench"))


@pytest.mark.slow
def test_every_part_is_there_and_every_value_is_positive(run: tuple[dict, str]) -> None:
    check(*run)
    assert {row["group"] for row in run[0]["rows"]} == set(GROUPS)


@pytest.mark.slow
def test_each_bar_of_the_specification_is_judged(run: tuple[dict, str]) -> None:
    report, _ = run
    bars = {row["name"]: row["at_least"] or row["at_most"] for row in report["rows"]}
    assert bars["uwserver, physics + thrusters: 1 vehicle"] == 200.0
    assert bars["uwserver, physics + thrusters + sensors: 1 vehicle"] == 100.0
    assert bars["uwserver, physics + thrusters: 10 vehicles"] == 80.0
    assert bars["uwserver, physics + thrusters: 100 vehicles"] == 10.0
    assert bars["Micron DST ping, 13 x 71 rays, 400 bins over 20 m"] == 700.0
    assert bars["DVL1000 sample, bottom and water track"] == 50.0
    assert bars["IMU sample, full error model"] == 10.0
    assert bars["BlueROV2 Heavy: imu 120, depth 48, dvl 8, gps 5, altimeter 10, sonar 20 Hz"] == 40.0
    assert bars["1 vehicle, sensors and autopilot, one core"] == 400.0
    assert bars["10 vehicles, sensors and autopilot, one core"] == 60.0
    assert bars["100 vehicles, sensors and autopilot, one core"] == 6.0
    assert bars["server of 10 vehicles: what the client leaves of the rate"] == 0.7
    assert bars["white noise on a 3-vector, a sample"] == 0.3
    assert bars["IMU sample with all errors, of 100 at once"] == 0.7
    assert bars["memory of a vehicle with sensors and autopilot"] == 200.0
    assert bars["what the clients add to it"] == 0.3
    assert bars["command, 10 connections: p99"] == 6.0
    assert bars["zenoh: command sent to its force, p99"] == 5.0
    assert bars["TCP msgpack: end of the tick to the client, p50"] == 0.5
    assert bars["TCP msgpack: samples received, free-running, 10 clients"] == 50_000.0
    assert bars["doubles through the embedded MOOSDB, both ends here"] == 20_000.0
    assert bars["NAV_*: end of the tick to the client, p99"] == 20.0
    assert bars["ArduPilot JSON, free-running: frames, each a tick"] == 4000.0
    assert (
        bars[
            "250 Hz beside a 10 Hz camera (640 x 480) and a 16.7 Hz multibeam (256 x 512), both computed: tick lateness p99"
        ]
        == 1.0
    )
    assert bars["`uwserver run` to the first sample at a client"] == 3.0


@pytest.mark.slow
def test_no_sample_or_command_is_counted_twice(run: tuple[dict, str]) -> None:
    report, _ = run
    medians = {row["name"]: row["median"] for row in report["rows"]}
    assert medians["samples received by the 10"] < 1.5 * 10 * (125 + 50 + 50)
    assert medians["their commands, 10 x 50 Hz"] < 1.1 * 10 * 50


@pytest.mark.slow
def test_peers_have_ratios_or_a_reason(run: tuple[dict, str]) -> None:
    report, _ = run
    names = [row["name"] for row in report["rows"] if row["unit"] == "ratio"]
    absent = {row["name"] for row in report["rows"] if row["verdict"] == "absent"}
    for peer in ("pybullet, bare step", "pybullet + numpy a vehicle", "MuJoCo ellipsoid fluid + 8 thrusters"):
        assert peer in absent or sum(peer in name for name in names) == 3
