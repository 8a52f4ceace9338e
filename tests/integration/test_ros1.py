"""The how-to of ROS 1 with Debian's own rosmaster, rostopic, rosservice, rosnode and rosbag, where they are installed."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from nursery import python

pytest.importorskip("rosbags", reason="rosbags is not installed")
TOOLS = ("rosmaster", "rostopic", "rosservice", "rosnode", "rosbag")
MISSING = [tool for tool in TOOLS if not Path("/usr/bin", tool).exists()]
pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"{', '.join(MISSING)} not installed (Debian: python3-rospy and the python3-ros* packages)"
)

ROOT = Path(__file__).parents[2]
PATIENCE_S = 60


class Graph:
    """A master, a server that runs the page's scenario, and ROS' tools."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.folder = folder
        self.env = {
            "PATH": "/usr/bin:/bin", "HOME": str(folder), "ROS_HOME": str(folder), "ROS_IP": "127.0.0.1",
            "ROS_MASTER_URI": f"http://127.0.0.1:{self.port}", "PYTHONUNBUFFERED": "1",
        }  # fmt: skip
        self.master = self.start_master()
        page = (ROOT / "docs/how-to/ros1.md").read_text()
        (scenario,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
        (folder / "sea.toml").write_text(scenario + "[server]\nweb = false\nmetrics_port = 0\n")
        self.server = subprocess.Popen(
            [python(), "-m", "uwserver", "run", str(folder / "sea.toml")],
            env={**os.environ, "ROS_MASTER_URI": self.env["ROS_MASTER_URI"]},
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def start_master(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            ["/usr/bin/python3", "/usr/bin/rosmaster", "--core", "-p", str(self.port)],
            env=self.env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def tool(self, *words: str, timeout_s: float = PATIENCE_S) -> str:
        """What a tool prints; that of one which was stopped as far as it came."""
        command = ["/usr/bin/python3", f"/usr/bin/{words[0]}", *words[1:]]
        try:
            done = subprocess.run(
                command, env=self.env, cwd=self.folder, capture_output=True, text=True, timeout=timeout_s
            )
        except subprocess.TimeoutExpired as late:
            return (late.stdout or b"").decode() if isinstance(late.stdout, bytes) else (late.stdout or "")
        return done.stdout + done.stderr

    def wait_for(self, text: str, *words: str) -> str:
        end = time.monotonic() + PATIENCE_S
        while text not in (said := self.tool(*words)):
            assert time.monotonic() < end, said
            time.sleep(0.2)
        return said

    def close(self) -> None:
        for process in (self.server, self.master):
            process.terminate()
            process.wait(timeout=PATIENCE_S)


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    found = Graph(tmp_path_factory.mktemp("ros1"))
    try:
        found.wait_for("/world/step", "rosservice", "list")
        yield found
    finally:
        found.close()


def test_topics(graph: Graph) -> None:
    assert {"/heavy/imu", "/clock", "/tf_static", "/heavy/thrusters/cmd"} <= set(graph.tool("rostopic", "list").split())
    assert "Type: sensor_msgs/Imu" in graph.tool("rostopic", "info", "/heavy/imu")
    imu = graph.tool("rostopic", "echo", "-n", "1", "/heavy/imu")
    z = re.search(r"linear_acceleration:.*?z: ([-\d.]+)", imu, re.DOTALL)
    assert z is not None, imu
    assert float(z[1]) == pytest.approx(9.81, abs=0.5)


@pytest.mark.skipif(not Path("/usr/lib/python3/dist-packages/tf2_msgs").exists(), reason="no python3-tf2-msgs")
def test_late_subscribers_hear_what_is_latched(graph: Graph) -> None:
    assert "heavy/imu" in graph.tool("rostopic", "echo", "-n", "1", "/tf_static")


def test_services_and_the_node(graph: Graph) -> None:
    assert "success: True" in graph.tool("rosservice", "call", "/world/pause")
    assert "success: True" in graph.tool("rosservice", "call", "/world/resume")
    assert "std_srvs/Trigger" in graph.tool("rosservice", "type", "/world/pause")
    said = graph.tool("rosnode", "info", "/uwserver")
    assert "Pid:" in said
    assert "/heavy/imu [sensor_msgs/Imu]" in said


def test_a_publisher_moves_the_thrusters(graph: Graph) -> None:
    thrust = "{data: [0, 0, 0, 0, 0.5, 0.5, 0.5, 0.5]}"
    command = [
        "/usr/bin/python3",
        "/usr/bin/rostopic",
        "pub",
        "-r",
        "10",
        "/heavy/thrusters/cmd",
        "std_msgs/Float64MultiArray",
        thrust,
    ]
    with subprocess.Popen(command, env=graph.env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as publisher:
        try:
            end = time.monotonic() + PATIENCE_S
            speed = 0.0
            while abs(speed) < 0.2:
                assert time.monotonic() < end, "it does not move"
                said = graph.tool("rostopic", "echo", "-n", "1", "/heavy/truth/odom/twist/twist/linear")
                found = re.search(r"z: ([-\d.e]+)", said)
                speed = float(found[1]) if found else 0.0
        finally:
            publisher.terminate()


@pytest.mark.skipif(shutil.which("rosbag", path="/usr/bin") is None, reason="no rosbag")
def test_a_bag_is_recorded(graph: Graph) -> None:
    from rosbags.highlevel import AnyReader

    command = ["/usr/bin/python3", "/usr/bin/rosbag", "record", "-O", "dive.bag", "-l", "50", "/heavy/imu", "/clock"]
    done = subprocess.run(command, env=graph.env, cwd=graph.folder, capture_output=True, text=True, timeout=PATIENCE_S)
    bag = graph.folder / "dive.bag"
    if "rosbag/record" in done.stdout + done.stderr and not bag.exists():
        pytest.skip("rosbag's recorder itself is not installed (Debian: rosbag)")
    with AnyReader([bag]) as reader:
        assert {connection.topic for connection in reader.connections} >= {"/heavy/imu"}
        stamps = [stamp for _, stamp, _ in reader.messages()]
    assert stamps


def test_it_comes_back_when_the_master_does(graph: Graph) -> None:
    graph.master.terminate()
    graph.master.wait(timeout=PATIENCE_S)
    graph.master = graph.start_master()
    graph.wait_for("/uwserver", "rosnode", "list")
    graph.wait_for("/world/step", "rosservice", "list")
    assert "data:" in graph.tool("rostopic", "echo", "-n", "1", "/heavy/depth/depth")
