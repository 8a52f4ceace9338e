"""clients/ros2/uwserver_msgs: what is built there is what the server speaks."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

from uwserver_adapters.ros.messages.definitions import ACTIONS, MESSAGES, SERVICES

PACKAGE = Path(__file__).parents[4] / "clients/ros2/uwserver_msgs"


def _fields(text):
    return [line.split("#")[0].strip() for line in text.splitlines() if line.split("#")[0].strip()]


def test_definitions_are_those_of_the_adapters():
    own = {f"uwserver_msgs/msg/{path.stem}": _fields(path.read_text()) for path in PACKAGE.glob("msg/*.msg")}
    assert own == {name: _fields(text) for name, text in MESSAGES.items() if name.startswith("uwserver_msgs/")}
    services = {}
    for path in PACKAGE.glob("srv/*.srv"):
        request, _, response = path.read_text().partition("---\n")
        services[f"uwserver_msgs/srv/{path.stem}"] = (_fields(request), _fields(response))
    wanted = {n: (_fields(a), _fields(b)) for n, (a, b) in SERVICES.items() if n.startswith("uwserver_msgs/")}
    assert services == wanted
    actions = {
        f"uwserver_msgs/action/{path.stem}": tuple(map(_fields, path.read_text().split("---\n")))
        for path in PACKAGE.glob("action/*.action")
    }
    assert actions == {n: tuple(map(_fields, parts)) for n, parts in ACTIONS.items() if n.startswith("uwserver_msgs/")}


def test_the_build_names_every_file():
    text = (PACKAGE / "CMakeLists.txt").read_text()
    named = set(re.findall(r'"(\w+/\w+\.(?:msg|srv|action))"', text))
    assert named == {
        str(path.relative_to(PACKAGE)) for kind in ("msg", "srv", "action") for path in PACKAGE.glob(f"{kind}/*.{kind}")
    }
    for folder in re.search(r"DIRECTORY (.*) DESTINATION", text)[1].split():
        assert (PACKAGE / folder).is_dir()


def test_launch_file_and_layout_are_well_formed():
    ast.parse((PACKAGE / "launch/view.launch.py").read_text())
    layout = json.loads((PACKAGE / "foxglove/rov.json").read_text())
    assert {"layout", "configById"} <= layout.keys()
