"""Vehicles small enough to know what they do: an ideal ROV, a torpedo, a raft with two thrusters, a glider."""

from __future__ import annotations

from pathlib import Path

import msgspec
import tomli_w

from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.world.tables import Environment
from uwserver.validation.manoeuvres.helm import Helm
from uwserver.validation.manoeuvres.report import resolve

GUESS = {"source": "made up for the test", "status": "guess"}
DEVICE = {
    "schema": 1,
    "kind": "thruster",
    "name": "ideal",
    "default_voltage_V": 12.0,
    "shape": {**GUESS, "coefficients": [1.0]},
    "curves": {"v12": {**GUESS, "voltage_V": 12.0, "max_forward_N": 50.0, "max_reverse_N": 50.0, "dead_band": [0.0, 0.0]}},
    "lag": {**GUESS, "time_constant_s": 0.05},
    "propeller": {**GUESS, "diameter_m": 0.1},
}  # fmt: skip


def vehicle(**tables: object) -> dict[str, object]:
    """Raw tables of a neutral box of 100 kg whose drag is 100 N at 1 m/s, with a righting arm of 5 cm."""
    return {
        "schema": 1,
        "name": "craft",
        "description": "A box",
        "rigid_body": {**GUESS, "mass_kg": 102.5, "inertia_kgm2": [10.0, 10.0, 10.0], "center_of_mass_frd_m": [0.0, 0.0, 0.05]},
        "buoyancy": {**GUESS, "volume_m3": 0.1, "shapes": {"box": {"kind": "box", "size_m": [1.0, 0.5, 0.2]}}},
        "added_mass": {**GUESS, "diagonal": [50.0, 50.0, 50.0, 5.0, 5.0, 5.0]},
        "damping": {
            "linear": {**GUESS, "diagonal": [1.0, 1.0, 1.0, 5.0, 5.0, 5.0]},
            "quadratic": {**GUESS, "diagonal": [100.0, 200.0, 200.0, 10.0, 10.0, 10.0]},
        },
        "collision": {"box": {"kind": "box", "size_m": [1.0, 0.5, 0.2]}},
        **tables,
    }  # fmt: skip


def thruster(position: list[float], axis: list[float]) -> dict[str, object]:
    return {**GUESS, "device": "ideal.toml", "position_frd_m": position, "axis_frd": axis}


FOUR = {
    "t1": thruster([0.3, 0.2, 0.05], [-1.0, 1.0, 0.0]),
    "t2": thruster([0.3, -0.2, 0.05], [-1.0, -1.0, 0.0]),
    "t3": thruster([-0.3, 0.2, 0.05], [1.0, 1.0, 0.0]),
    "t4": thruster([-0.3, -0.2, 0.05], [1.0, -1.0, 0.0]),
    "up": thruster([0.0, 0.1, 0.0], [0.0, 0.0, -1.0]),
    "down": thruster([0.0, -0.1, 0.0], [0.0, 0.0, 1.0]),
}
"""Vectored, as of a BlueROV2, and two vertical ones that push in opposite senses."""
TWO = {"port": thruster([-0.4, -0.3, 0.05], [1.0, 0.0, 0.0]), "starboard": thruster([-0.4, 0.3, 0.05], [1.0, 0.0, 0.0])}
FIN = {**GUESS, "area_m2": 0.01, "lift_slope_prad": 3.0, "limit_deg": 20.0}
FINS = {
    "rudder": {**FIN, "position_frd_m": [-0.5, 0.0, 0.0], "hinge_frd": [0.0, 0.0, 1.0]},
    "planes": {**FIN, "position_frd_m": [-0.5, 0.0, 0.0], "hinge_frd": [0.0, 1.0, 0.0], "limit_deg": 10.0},
}
"""A positive angle of this rudder turns to port: its hinge points down."""
PROPELLER = {"main": {**GUESS, "position_frd_m": [-0.5, 0.0, 0.0], "diameter_m": 0.2, "curve": [[0.0, 0.4, 0.0], [1.0, 0.0, 0.0]],
                      "max_speed_radps": 100.0}}  # fmt: skip
ENGINE = {"engine": {**GUESS, "position_frd_m": [0.0, 0.0, 0.0], "form": "bladder", "max_volume_m3": 1e-3, "neutral_volume_m3": 5e-4,
                     "rate_m3ps": 1e-4}}  # fmt: skip
BATTERY = {"battery": {**GUESS, "mass_kg": 10.0, "min_position_m": -0.1, "max_position_m": 0.1, "rate_mps": 0.01}}
ROV = vehicle(thrusters=FOUR)
TORPEDO = vehicle(fins=FINS, propellers=PROPELLER) | {
    "rigid_body": {**GUESS, "mass_kg": 102.5, "inertia_kgm2": [10.0] * 3, "center_of_mass_frd_m": [0.0, 0.0, 0.002]}
}
"""With little to right it: below the speed at which fins can hold the pitch, planes at the stern lift more than they turn."""
RAFT = vehicle(thrusters=TWO)
GLIDER = vehicle(ballasts=ENGINE, moving_masses=BATTERY)


def written(folder: Path, raw: dict[str, object]) -> Path:
    """The vehicle file, with its device beside it."""
    (folder / "ideal.toml").write_text(tomli_w.dumps(DEVICE))
    file = folder / "craft.toml"
    file.write_text(tomli_w.dumps(msgspec.to_builtins(raw)))
    return file


def helm(folder: Path, raw: dict[str, object]) -> Helm:
    """Its sticks, in sea water."""
    environment = Environment()
    resolved = resolve(str(written(folder, raw)), environment)
    return Helm(resolved.vehicle, body_params(resolved.vehicle, resolved.devices, environment))
