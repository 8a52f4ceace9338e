"""Node reports lead external vehicles."""

from __future__ import annotations

import math

import pytest
from uwserver_adapters.moos.bridge.bridge import ERROR, Bridge
from uwserver_adapters.moos.bridge.report import LONGEST, pose_command, read_report
from uwserver_adapters.moos.config import BridgeTable

from uwserver.frames import quat_from_rpy
from uwserver.ports import Port
from uwserver.testing import FakeContext
from uwserver.world.external.pose_source import LivePoses

REPORT = (
    "NAME=henry,TYPE=kayak,TIME=1252348077.59,X=51.71,Y=-35.50,LAT=43.824981,LON=-70.329755,SPD=2.00,HDG=118.85,DEP=0.50,"
    'LENGTH=3.8,MODE="DRIVE,NOW",TRAJECTORY={X=1,Y=2}'
)
POSE = Port("boat/pose", "actuator", "pose", LivePoses.fields, LivePoses.doc, message="FollowedPose")


class Bench:
    def __init__(self, **table: object) -> None:
        self.context = FakeContext(ports={POSE.path: POSE})
        self.posts: list[tuple[str, float | str]] = []
        self.bridge = Bridge(
            BridgeTable(**table), self.context, self.posts.extend, lambda names: None, "moos", lambda: 0.0
        )

    def write(self, name: str, value: float | str) -> None:
        self.bridge.take([(name, value, "pShare", 10.0)], 0.0)

    @property
    def poses(self) -> list[dict[str, tuple[float, ...]]]:
        names = [field.name for field in POSE.fields]
        found = [dict(zip(names, c.value, strict=True)) for c in self.context.commands if c.port == POSE.path]
        return [{name: value for name, value in each.items() if value is not None} for each in found]


def test_a_report_says_place_heading_and_speed():
    name, numbers = read_report(REPORT)
    assert name == "henry"
    value = pose_command(name, numbers)
    assert value["p_NB"] == [-35.50, 51.71, 0.5]
    assert value["q_NB"] == pytest.approx(quat_from_rpy(0.0, 0.0, math.radians(118.85)))
    assert value["v_NB_B"] == [2.0, 0.0, 0.0]


def test_what_is_left_out_is_left_out():
    assert pose_command(*read_report("NAME=a,X=1,Y=2")) == {"p_NB": [2.0, 1.0, 0.0]}


@pytest.mark.parametrize(
    "text", ["", "NAME=a", "NAME=a,X=nan,Y=1", "NAME=a,X=,Y=1", "X" * 50, "=,=,=", "NAME=a,X=1e999,Y=1"]
)
def test_a_report_without_a_place_is_refused(text):
    with pytest.raises(ValueError, match="has no"):
        pose_command(*read_report(text))


def test_a_long_text_is_not_searched():
    with pytest.raises(ValueError, match="characters"):
        read_report("X=1," * LONGEST)


async def test_the_vehicle_that_follows_is_led():
    bench = Bench(externals={"boat": "Henry"})
    assert {"NODE_REPORT", "NODE_REPORT_LOCAL"} <= set(bench.bridge.listens_to)
    bench.write("NODE_REPORT", REPORT)
    bench.write("NODE_REPORT", REPORT.replace("henry", "gilda"))
    (value,) = bench.poses
    assert value["p_NB"] == (-35.5, 51.71, 0.5)


def test_nobody_listens_who_follows_nobody():
    assert "NODE_REPORT" not in Bench().bridge.listens_to


def test_a_fault_is_told():
    bench = Bench(externals={"boat": "henry"})
    bench.write("NODE_REPORT", "NAME=henry,X=1")
    bench.bridge.attend()
    assert any(name == ERROR and "has no Y" in str(text) for name, text in bench.posts)
    assert bench.poses == []


async def test_variables_lead_when_both_halves_of_a_place_are_new():
    bench = Bench(externals={"boat": "NAV_*"})
    assert "NODE_REPORT" not in bench.bridge.listens_to
    for name, value in (("NAV_HEADING", 90.0), ("NAV_DEPTH", 5.0), ("NAV_X", 1.0), ("NAV_X", 2.0)):
        bench.write(name, value)
    assert bench.poses == []
    bench.write("NAV_Y", 3.0)
    (value,) = bench.poses
    assert value["p_NB"] == (3.0, 2.0, 5.0)
    assert value["q_NB"] == pytest.approx(quat_from_rpy(0.0, 0.0, math.pi / 2))
    bench.write("NAV_Y", 4.0)
    assert len(bench.poses) == 1
    bench.write("NAV_X", "here")
    bench.bridge.attend()
    assert any(name == ERROR and "is no number" in str(text) for name, text in bench.posts)
