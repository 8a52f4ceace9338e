"""What kind of file this is: tells files of ours apart, recognises those of other programs, and says which command helps with each."""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

from uwserver.logfiles.log import LogError
from uwserver.logfiles.mapping import FORMAT as MAPPING_FORMAT
from uwserver.logfiles.readers.opening import kind_of as kind_of_log

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Kind = Literal[
    "scenario", "vehicle", "device", "mapping", "mission", "plan", "waypoints", "recording", "log", "state", "oracle", "urdf", "xacro", "sdf",
    "stonefish", "holoocean", "morse", "launch", "mujoco", "yaml", "xml", "json", "python", "mesh", "collada", "grid", "folder", "empty",
]  # fmt: skip


class Format(NamedTuple):
    """The kind of a file: what it is called, and what to do with it. In `advice`, FILE stands for the file."""

    name: str
    advice: str


_FROM_MESH = "`uwserver new --vehicle NAME --mesh HULL.stl` writes a vehicle file from the mesh of a hull"
_FROM_NOTHING = "`uwserver new NAME` writes a scenario, in TOML, to begin with"
_CHECKED = "`uwserver check FILE` checks it"
FORMATS: Mapping[Kind, Format] = {
    "scenario": Format("a scenario", "`uwserver run FILE` runs it"),
    "vehicle": Format("a vehicle file", "`uwserver run FILE` puts it into a tank, `uwserver new NAME --vehicle FILE` writes a scenario with it"),
    "device": Format("a device file", f'name it in a vehicle file (device = "FILE" of a thruster, profile = "FILE" of a sensor); {_CHECKED}'),
    "mapping": Format("a mapping for logs", f'name it beside the log of an external vehicle, by mapping = "FILE"; {_CHECKED}'),
    "mission": Format("a mission", f"it is for VEHICLE/autopilot/set_mission of a running server; {_CHECKED}"),
    "plan": Format("a plan of QGroundControl", f"load it in the page of `uwserver run rov_autopilot`, in the tab Mission; {_CHECKED}"),
    "waypoints": Format("a waypoint file", f"a ground station sends it to `uwserver run bluerov2_qgc`; {_CHECKED}"),
    "recording": Format("a recording", "`uwserver play FILE` shows it, `uwserver replay FILE` runs it again"),
    "log": Format("a log", "`uwserver log FILE` tells what is in it, `uwserver play FILE` shows it"),
    "state": Format("a saved state", "`uwserver run SCENARIO --from FILE` goes on from it"),
    "oracle": Format("a reference trajectory", "`uwserver validate FILE` runs it"),
    "urdf": Format("a URDF file of ROS, which uwserver cannot read", _FROM_MESH),
    "xacro": Format("a xacro file of ROS, which uwserver cannot read", _FROM_MESH),
    "sdf": Format("an SDF file of Gazebo, which uwserver cannot read", f"{_FROM_NOTHING}; {_FROM_MESH}"),
    "stonefish": Format("a scenario of Stonefish, which uwserver cannot read", _FROM_NOTHING),
    "holoocean": Format("a scenario of HoloOcean, which uwserver cannot read", _FROM_NOTHING),
    "morse": Format("a Builder script of MORSE", "`uwserver new NAME --from-morse FILE` writes a scenario from it"),
    "launch": Format("a launch file of ROS, which uwserver does not run", _FROM_NOTHING),
    "mujoco": Format("a model of MuJoCo, which uwserver cannot read", _FROM_MESH),
    "yaml": Format("a YAML file, which uwserver does not read", _FROM_NOTHING),
    "xml": Format("an XML file, which uwserver does not read", _FROM_NOTHING),
    "json": Format("a JSON file, which uwserver does not know", _FROM_NOTHING),
    "python": Format("a Python program", "`python FILE` runs it; if it adds kinds of component, name it in a scenario by extensions"),
    "mesh": Format("a mesh", "`uwserver new --vehicle NAME --mesh FILE` writes a vehicle file with this hull"),
    "collada": Format("a mesh in COLLADA, which uwserver does not read", "convert it to .glb, .obj or .stl first, as Blender and MeshLab do"),
    "grid": Format("a grid", 'name it in a scenario as a seabed: kind = "grid", file = "FILE"'),
    "folder": Format("a folder", "name a file in it"),
    "empty": Format("an empty file", "there is nothing in it"),
}  # fmt: skip

_HEAD_BYTES = 4096
_MOST_BYTES = 1 << 20
_MARKS: Mapping[Kind, frozenset[str]] = {
    "scenario": frozenset((
        "extensions", "seed", "world", "environment", "seabed", "structures", "objects", "vehicles", "faults", "adapters", "server",
    )),
    "vehicle": frozenset((
        "rigid_body", "buoyancy", "added_mass", "damping", "mounts", "lamps", "thrusters", "fins", "foils", "propellers", "ballasts", "hull",
        "moving_masses", "actuators", "collision", "published", "sensors",
    )),
    "device": frozenset(("properties", "default_voltage_V", "tables", "curves", "lag", "propeller", "electric")),
    "mapping": frozenset(("tracks", "ports", "format")),
}  # fmt: skip
"""Keys at the top that only one kind of TOML file has."""
_BY_ENDING: Mapping[str, Kind] = {
    **dict.fromkeys((".yaml", ".yml"), "yaml"),
    **dict.fromkeys((".stl", ".obj", ".ply", ".glb", ".gltf"), "mesh"),
    ".dae": "collada",
    **dict.fromkeys((".npy", ".nc", ".nc4"), "grid"),
    ".py": "python",
    ".xacro": "xacro",
}  # fmt: skip
_ROOT = re.compile(r"<(?![?!])([\w.:-]+)([^>]*)")
_BY_ROOT: Mapping[str, Kind] = {
    "robot": "urdf", "sdf": "sdf", "gazebo": "sdf", "scenario": "stonefish", "launch": "launch", "mujoco": "mujoco", "COLLADA": "collada",
}  # fmt: skip


def told(label: str, kind: Kind) -> str:
    """Return what a file is and what to do with it, for people: ``this is a scenario: `uwserver run tank.toml` runs it``.

    Args:
        label: the file as a user types it: its path, or the name of a shipped one.
        kind: kind of the file.
    """
    name, advice = FORMATS[kind]
    here = advice.replace('"FILE"', json.dumps(label, ensure_ascii=False)).replace("FILE", shlex.quote(label))
    return f"this is {name}: {here}"


def format_of(path: Path) -> Kind | None:
    """Return the kind of a file, from its first bytes and its ending; None if it is none of these, or cannot be read."""
    try:
        if path.is_dir():
            return _log_kind(path) or "folder"
        if not path.is_file():
            return None
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        whole = path.read_bytes() if path.stat().st_size <= _MOST_BYTES else b""
    except (OSError, ValueError):
        return None
    if not head.strip():
        return "empty"
    text = head.decode("utf-8-sig", "replace").lstrip()
    if text.startswith("QGC WPL"):
        return "waypoints"
    if b"uwserver-state-" in head[:64]:
        return "state"
    return _by_text(path, text, whole) or _log_kind(path)


def _by_text(path: Path, text: str, whole: bytes) -> Kind | None:
    ending = path.suffix.lower()
    if ending == ".toml":
        return _by_tables(whole)
    if ending == ".py" and path.name.endswith(".launch.py"):
        return "launch"
    if ending == ".py" and "morse.builder" in text:
        return "morse"
    if ending in _BY_ENDING:
        return _BY_ENDING[ending]
    if text.startswith("<"):
        return _by_root(text)
    if text.startswith(("{", "[")) and (found := _by_json(whole)) is not None:
        return found
    return "yaml" if text.startswith(("---\n", "%YAML")) else None


def _by_root(text: str) -> Kind:
    root = _ROOT.search(text)
    if root is None:
        return "xml"
    if root[1] == "robot" and "xacro" in root[2]:
        return "xacro"
    return _BY_ROOT.get(root[1], "xml")


def _by_json(whole: bytes) -> Kind | None:
    try:
        tree = json.loads(whole)
    except (ValueError, RecursionError):
        return None
    if isinstance(tree, list):
        return "mission" if tree and all(isinstance(item, dict) and "kind" in item for item in tree) else "json"
    if not isinstance(tree, dict):
        return None
    if tree.get("fileType") == "Plan":
        return "plan"
    if str(tree.get("format", "")).startswith("uwserver-") and "oracle" in str(tree["format"]):
        return "oracle"
    return "holoocean" if "agents" in tree and "world" in tree else "json"


def _by_tables(whole: bytes) -> Kind | None:
    try:
        return kind_of_tables(tomllib.loads(whole.decode("utf-8-sig")))
    except (ValueError, RecursionError):
        return None


def kind_of_tables(raw: Mapping[str, Any]) -> Kind | None:
    """Return the kind of TOML file of ours whose keys these are; None if they do not tell."""
    if raw.get("format") == MAPPING_FORMAT:
        return "mapping"
    count = {kind: len(marks & raw.keys()) for kind, marks in _MARKS.items()}
    best = max(count, key=lambda kind: count[kind])
    return best if count[best] > sum(count.values()) - count[best] else None


def _log_kind(path: Path) -> Kind | None:
    """Return whether this is a recording of ours or another log; text files without a mark only by the ending of tables."""
    try:
        found = kind_of_log(path)
    except (LogError, OSError):
        return None
    if found == "mcap":
        with path.open("rb") as file:
            return "recording" if b"uwserver" in file.read(_HEAD_BYTES) else "log"
    return "log" if found != "csv" or path.is_dir() or path.suffix.lower() != ".txt" else None
