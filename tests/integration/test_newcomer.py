"""A newcomer follows CONTRIBUTING.md to the letter, in a copy of the tree: which files it takes, and that the new kinds do all that others do."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
PATHS = ("", "adapters", "scenarios", "clients/python", "bench")
CHANGED = ("uwserver/sensors", "uwserver/actuators", "scenarios/uwserver_scenarios", "tests/unit/sensors")
"""Folders in which something changes; of others the copy has links."""


class Block(NamedTuple):
    """A listing of the page: the file of which it is, by the last one that stands before it, its language and its text."""

    file: str
    language: str
    text: str


def blocks(section: str) -> list[Block]:
    """All listings of a section of CONTRIBUTING.md."""
    page = (ROOT / "CONTRIBUTING.md").read_text()
    (text,) = re.findall(rf"^## {section}\n(.*?)(?=^## )", page, re.S | re.M)
    found = []
    for match in re.finditer(r"^```(\w+)\n(.*?)^```", text, re.S | re.M):
        file = re.findall(r"`([\w/]+/\w+\.(?:py|toml))`", text[: match.start()])[-1]
        found.append(Block(file, match[1], match[2]))
    return found


def applied(old: str, diff: str) -> str:
    """A text in which the lines with + stand behind the lines that stand before them in a diff."""
    lines, at = old.splitlines(keepends=True), 0
    for line in diff.splitlines(keepends=True):
        if line.startswith(" "):
            at = lines.index(line[1:], at) + 1
        elif line.startswith("+"):
            lines.insert(at, line[1:])
            at += 1
    return "".join(lines)


def follow(section: str, tree: Path) -> set[str]:
    """Do what a section says; the files that it took."""
    for file, language, text in blocks(section):
        path = tree / file
        if language == "diff":
            path.write_text(applied(path.read_text(), text))
        elif language == "toml":
            path.write_text(f"{path.read_text()}\n{text}")
        else:
            assert not path.exists(), file
            path.write_text(text)
    return {file for file, _, _ in blocks(section)}


def copy(source: Path, target: Path) -> None:
    """Links to what stays, and files of its own where something changes."""
    target.mkdir()
    for path in source.iterdir():
        name, new = path.relative_to(ROOT).as_posix(), target / path.name
        if name in CHANGED:
            shutil.copytree(path, new, ignore=shutil.ignore_patterns("__pycache__"))
        elif any(each.startswith(f"{name}/") for each in CHANGED):
            copy(path, new)
        elif path.name != "__pycache__":
            new.symlink_to(path)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("newcomer") / "tree"
    copy(ROOT, target)
    return target


def differing(tree: Path) -> set[str]:
    """Files of a copy that are not as in the tree, or not there at all."""
    found = set()
    for path in (path for folder in CHANGED for path in (tree / folder).rglob("*.*") if path.suffix != ".pyc"):
        old = ROOT / path.relative_to(tree)
        if not old.exists() or old.read_bytes() != path.read_bytes():
            found.add(str(path.relative_to(tree)))
    return found


def run(tree: Path, *arguments: str) -> str:
    """What a Python prints that takes uwserver from a copy."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(str(tree / path) for path in PATHS)}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=tree, env=environment, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


TRIAL = """
import json, sys
from pathlib import Path

from uwserver_adapters.ros.messages.catalogue import topics_of
from uwserver_adapters.ros.messages.commands import command_topics
from uwserver_adapters.ros.messages.ros_port import Facts, mounts_of
from uwserver_adapters.ros.messages.types import Types

from uwserver.recording.recorder import Recorder
from uwserver.recording.report.reading import read_recording
from uwserver.scenario.authoring.catalogue import sensor_kinds
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.load.scenario import load
from uwserver.scenario.scene.scenery import Scenery
from uwserver.simulation.clock import Timing
from uwserver.world.state.scene_probe import SceneProbe

jet = {"kind": "jet", "position_frd_m": [0.0, 0.0, 0.0], "direction_frd": [0.0, 1.0, 0.0], "max_force_N": 40.0}
tow = {"kind": "force_torque"}
builder = ScenarioBuilder("trial", seed=1).seabed("flat", depth_m=12.0)
builder.vehicle("rov", "bluerov2", position_ned_m=(0.0, 0.0, 5.0), override={"actuators": {"jet": jet, "tow": tow}})
resolved = load(builder.sensor("rov", "finder", "range_finder", rate_hz=10).build(), adapters={})
world = build(resolved)
world.command("rov/tow", force_B=[0.0, 0.0, 0.0])
world.command("rov/jet", u=1.0)
samples, path = [], Path("trial.mcap")
recorder = Recorder(path, world, resolved)
with recorder.stepped(Timing("freerun")):
    for _ in range(240):
        output = world.advance()
        recorder.ticked(world)
        samples += output.samples
        recorder.put_samples(output.samples)
        recorder.drain()
scene = Scenery(resolved, world).scene(SceneProbe(world).state().entities)
(view,) = (sensor for sensor in scene.vehicles[0].sensors if sensor.kind == "range_finder")
port, types = world.ports["rov/finder"], Types()
facts = Facts(mounts=mounts_of(scene))
(sensor_topic,) = topics_of(types, facts, port)
told = [sample for sample in samples if sample.port == "rov/finder"]
print(json.dumps({
    "ranges": [sample.value[0] for sample in told],
    "kept": read_recording(path).series["rov/finder"].columns["range"][:, 0].tolist(),
    "depth": world.vehicles["rov"].p_NB[2],
    "east": world.vehicles["rov"].p_NB[1],
    "beams": [[list(beam.direction), beam.far] for beam in view.beams],
    "type": sensor_topic.type,
    "message": sensor_topic.make(told[-1]).max_range,
    "command_topics": [command_topic.type for command_topic in command_topics(types, world.ports["rov/jet"])],
    "example": [output.example for output in sensor_kinds()["range_finder"].outputs],
}))
"""


def test_a_new_sensor_takes_four_files_and_a_new_force_one_and_a_line(tree: Path) -> None:
    assert follow("Add a sensor", tree) == differing(tree) == {
        "uwserver/sensors/optical/range_finder.py",
        "uwserver/sensors/__init__.py",
        "tests/unit/sensors/optical/test_range_finder.py",
        "scenarios/uwserver_scenarios/one_of_everything.toml",
    }  # fmt: skip
    force = follow("Add an actuator, or another force", tree)
    assert force == {"uwserver/actuators/jet.py", "uwserver/actuators/__init__.py"}
    assert differing(tree) == force | {file for file, _, _ in blocks("Add a sensor")}
    told = json.loads(run(tree, "-c", TRIAL).splitlines()[-1])
    # The jet pushes it to starboard, whatever the rope holds; the laser looks at the bottom meanwhile.
    assert told["east"] > 0.2
    assert len(told["ranges"]) == 10
    assert told["ranges"][-1] == pytest.approx(12.0 - told["depth"], abs=0.5)
    assert told["kept"] == told["ranges"]
    assert told["beams"] == [[[0.0, 0.0, 1.0], 10.0]]
    assert (told["type"], told["message"]) == ("sensor_msgs/msg/Range", 10.0)
    assert told["command_topics"] == ["std_msgs/msg/Float64"]
    assert told["example"] == ["finder"]
    tests = ("optical/test_range_finder.py", "test_every_kind.py::test_no_kind_is_forgotten")
    run(tree, "-m", "pytest", "-q", "-p", "no:cacheprovider", *(f"tests/unit/sensors/{each}" for each in tests))
