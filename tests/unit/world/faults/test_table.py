"""Tables of faults: what can be written, and what cannot."""

from __future__ import annotations

from typing import Any, get_args

import msgspec
import pytest

from uwserver.world.faults.table import FaultConfig

GOOD: dict[str, dict[str, Any]] = {
    "thruster_dead": {"members": ["t1"]},
    "thruster_weak": {"factor": 0.5},
    "thruster_stuck": {"u": -1.0},
    "sensor_frozen": {"until_s": 5.0},
    "sensor_silent": {},
    "buoyancy_change": {"fraction": -1.0},
    "mass_loss": {"mass_kg": 1.0, "position_frd_m": [0.0, 0.0, 0.1]},
}


def read(kind: str, **keys: Any) -> Any:
    return msgspec.convert({"kind": kind, "target": "rov", **keys}, FaultConfig)


def test_every_kind_is_found_by_its_name_and_written_back() -> None:
    assert {str(kind.__struct_config__.tag) for kind in get_args(FaultConfig)} == set(GOOD)
    for kind, keys in GOOD.items():
        fault = read(kind, **keys)
        assert msgspec.to_builtins(fault)["kind"] == kind
        assert msgspec.convert(msgspec.to_builtins(fault), FaultConfig) == fault
        assert fault.at_s == 0.0


@pytest.mark.parametrize(
    ("kind", "keys", "text"),
    [
        ("flood", {}, "Invalid value 'flood'"),
        ("thruster_weak", {"factor": 1.5}, "<= 1"),
        ("thruster_weak", {}, "factor"),
        ("thruster_dead", {"members": []}, "length >= 1"),
        ("thruster_stuck", {"u": 1.1}, "<= 1"),
        ("sensor_silent", {"at_s": -1.0}, ">= 0"),
        ("sensor_silent", {"factor": 1.0}, "unknown field"),
        ("sensor_silent", {"target": ""}, "length >= 1"),
        ("mass_loss", {"mass_kg": 0.0}, "> 0"),
        ("buoyancy_change", {}, "0 are given"),
        ("buoyancy_change", {"fraction": 0.1, "force_N": 1.0}, "2 are given"),
        ("buoyancy_change", {"fraction": -1.1}, ">= -1"),
    ],
)
def test_what_cannot_be_is_refused(kind: str, keys: dict[str, Any], text: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=text):
        read(kind, **keys)
