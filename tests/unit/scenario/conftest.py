"""A tiny vehicle and device of our own, so that these tests do not depend on shipped numbers."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import pytest

from uwserver.adapter import installed_adapters
from uwserver.scenario.files.convert import Converter, Node
from uwserver.scenario.files.errors import KeyPath, dotted
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

VEHICLE = """\
schema = 1
name = "tiny"
description = "a box"

[rigid_body]
source = "test"
status = "guess"
mass_kg = 10.0
inertia_kgm2 = [0.1, 0.2, 0.3]

[buoyancy]
source = "test"
status = "guess"
volume_m3 = 0.0098

[added_mass]
source = "test"
status = "guess"
diagonal = [5, 6, 7, 0.1, 0.1, 0.1]

[damping.linear]
source = "test"
status = "guess"
diagonal = [5, 6, 7, 0.1, 0.1, 0.1]

[mounts.nose]
position_frd_m = [0.2, 0.0, 0.0]

[thrusters.left]
source = "test"
status = "guess"
device = "./motor.toml"
position_frd_m = [0.0, -0.1, 0.0]
axis_frd = [1.0, 0.0, 0.0]

[actuators.thrusters]
kind = "thrusters"

[sensors.imu]
kind = "imu"
rate_hz = 120
mount = "nose"
"""

DEVICE = """\
schema = 1
kind = "thruster"
name = "motor"
default_voltage_V = 16.0

[shape]
source = "test"
status = "guess"
coefficients = [1.0, 2.0]

[curves.v16]
source = "test"
status = "guess"
voltage_V = 16.0
max_forward_N = 50.0
max_reverse_N = 40.0
dead_band = [-0.07, 0.07]

[lag]
source = "test"
status = "guess"
time_constant_s = 0.1

[propeller]
source = "test"
status = "guess"
diameter_m = 0.076
"""

SCENARIO = """\
schema = 1
title = "tank"

[vehicles.rov]
model = "./tiny.toml"

[adapters.tcp]
kind = "sockets"
port = 7600
"""


PAGE = Path(__file__).parents[3] / "docs/how-to/extend.md"
ADAPTERS: dict[str, type] = installed_adapters()
Write = Callable[..., Path]


@pytest.fixture
def adapters() -> Mapping[str, type]:
    return ADAPTERS


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Writes tank.toml, tiny.toml and motor.toml into an empty working folder; returns the path of tank.toml."""
    monkeypatch.chdir(tmp_path)

    def write_files(scenario: str = SCENARIO, vehicle: str = VEHICLE, device: str = DEVICE) -> Path:
        for name, text in (("tank", scenario), ("tiny", vehicle), ("motor", device)):
            (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
        return tmp_path / "tank.toml"

    return write_files


@pytest.fixture
def files() -> dict[str, str]:
    """Text of the three good files."""
    return {"tank": SCENARIO, "tiny": VEHICLE, "motor": DEVICE}


@pytest.fixture(scope="session")
def listings() -> dict[str, str]:
    """The files of docs/how-to/extend.md by name, and its tests under "tests"."""
    text = PAGE.read_text(encoding="utf-8")
    named = dict(re.findall(r"^`([\w.]+)`:\n```\w+\n(.*?)^```", text, re.S | re.M))
    (named["tests"],) = re.findall(r"^## Test it\n```python\n(.*?)^```", text, re.S | re.M)
    return named


@pytest.fixture
def beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, listings: dict[str, str]) -> Path:
    """A working folder with all files of the page."""
    monkeypatch.chdir(tmp_path)
    for name, code in listings.items():
        if name != "tests":
            (tmp_path / name).write_text(code, encoding="utf-8")
    return tmp_path


class Told:
    """A `Report` that keeps what it is told: as ``path: text``, the place in brackets where it is another."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def __call__(self, path: KeyPath, text: str, at: KeyPath | None = None) -> None:
        place = "" if at is None or at == path else f" [{dotted(at)}]"
        self.lines.append(f"{dotted(path)}{place}: {text}")


@pytest.fixture
def report() -> Told:
    return Told()


@pytest.fixture
def warn() -> Told:
    return Told()


@pytest.fixture
def tree_of(report: Told) -> Callable[..., Node]:
    """A raw table as a tree, of a Scenario unless another type is given; its faults go to `report`."""
    return lambda raw, type_=Scenario: Converter(report).tree(raw, type_)


@pytest.fixture
def raw_vehicle() -> dict[str, Any]:
    """The raw tables of the tiny vehicle."""
    return tomllib.loads(VEHICLE)


@pytest.fixture
def raw_device() -> dict[str, Any]:
    """The raw tables of its thruster."""
    return tomllib.loads(DEVICE)


@pytest.fixture
def tiny(raw_vehicle: dict[str, Any]) -> VehicleFile:
    """The tiny vehicle."""
    return msgspec.convert(raw_vehicle, VehicleFile)


@pytest.fixture
def motor(raw_device: dict[str, Any]) -> ThrusterDevice:
    """Its thruster."""
    return msgspec.convert(raw_device, ThrusterDevice)
