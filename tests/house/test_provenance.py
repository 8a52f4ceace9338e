"""Every number of a shipped vehicle or device file says where it comes from and how far to trust it.

Tables that hold numbers carry `source` and `status`. By rule free of them: parts of a sensor's table within a
group of a device file, which the group speaks for; where things are mounted, how buoyancy shapes lie, the
derivatives of a hull or fin and the gains of the autopilot (the table around them speaks for them), the density that
coefficients refer to, and tables of names. Sensors with their modifiers, and collision shapes, have no
such keys: the line above their header is a comment, ``# status: source``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from sources import ROOT

SHIPPED = ROOT / "scenarios" / "uwserver_scenarios"
FILES = sorted(path for folder in ("vehicles", "devices") for path in (SHIPPED / folder).glob("*.toml"))
STATUSES = ("measured", "paper", "datasheet", "derived", "guess")
FREE = re.compile(
    r"(properties\.\w+\..+|mounts\..*|buoyancy\.shapes\..*|hull\.derivatives\.terms|fins\.\w+\.derivatives|autopilot\.gains|actuators\..*|damping|)"
)
"""Tables that need no source of their own; the last alternative is the file's root (schema version, default voltage)."""
COMMENTED = re.compile(r"(sensors|collision)\..*")


def tables(value: dict[str, Any], path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    yield path, value
    for key, child in value.items():
        if isinstance(child, dict):
            yield from tables(child, f"{path}.{key}" if path else key)
        elif isinstance(child, list):
            for item in child:
                if isinstance(item, dict):
                    yield from tables(item, f"{path}.{key}" if path else key)


def has_number(value: Any) -> bool:
    if isinstance(value, list):
        return any(has_number(item) for item in value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def unsourced(text: str) -> list[str]:
    """Tables of a file that hold numbers without saying where they come from."""
    lines = text.splitlines()
    missing = []
    for path, table in tables(msgspec.toml.decode(text)):
        if FREE.fullmatch(path) or not any(has_number(value) for value in table.values()):
            continue
        if COMMENTED.fullmatch(path):
            above = lines[lines.index(f"[{path}]") - 1]
            if not re.fullmatch(rf"# ({'|'.join(STATUSES)}): \S.*", above):
                missing.append(path)
        elif len(table.get("source", "")) < 10 or table.get("status") not in STATUSES:
            missing.append(path)
    return missing


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_number_has_a_source_and_a_status(path: Path) -> None:
    assert unsourced(path.read_text()) == []


def test_less_than_a_third_of_the_devices_groups_are_guesses() -> None:
    """Every table with a status is one group. More guesses need better sources elsewhere, not fewer and larger groups."""
    devices = [msgspec.toml.decode(path.read_text()) for path in FILES if path.parent.name == "devices"]
    statuses = [table["status"] for raw in devices for _, table in tables(raw) if "status" in table]
    assert len(statuses) >= 180
    assert statuses.count("guess") / len(statuses) < 1 / 3


def test_all_shipped_files_are_looked_at() -> None:
    assert {path.stem for path in FILES} >= {"bluerov2", "bluerov2_heavy", "rexrov", "lauv", "eca_a9", "tethys", "t200"}


@pytest.mark.parametrize(
    ("text", "missing"),
    [
        ('[lag]\nsource = "somebody, somewhere"\nstatus = "paper"\ntime_constant_s = 0.1\n', []),
        ("[lag]\ntime_constant_s = 0.1\n", ["lag"]),
        ('[lag]\nsource = "somebody, somewhere"\nstatus = "sure"\ntime_constant_s = 0.1\n', ["lag"]),
        ('[lag]\nsource = "x"\nstatus = "guess"\ntime_constant_s = 0.1\n', ["lag"]),
        ("[sensors.imu]\nrate_hz = 10.0\n", ["sensors.imu"]),
        ("# datasheet: of somebody\n[sensors.imu]\nrate_hz = 10.0\n", []),
        ("# of somebody\n[sensors.imu.modifiers.noise]\nsigma = 10.0\n", ["sensors.imu.modifiers.noise"]),
        ("[mounts.a]\nposition_frd_m = [1.0, 0.0, 0.0]\n", []),
        ("[thrusters.t1]\naxis_frd = [1, 0, 0]\n", ["thrusters.t1"]),
        ("[[published]]\nvalue = 1.5\n", ["published"]),
    ],
)
def test_the_rule_finds_what_is_missing(text: str, missing: list[str]) -> None:
    assert unsourced(text) == missing
