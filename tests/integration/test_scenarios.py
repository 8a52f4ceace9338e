"""Every shipped scenario runs: through the real command, and in process with every sensor speaking and every actuator acting."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache
from importlib import resources

import pytest
from nursery import python

from uwserver.actuators import ActuatorConfig
from uwserver.adapter import installed_adapters
from uwserver.modifiers import ModifierConfig
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.sensors import SensorConfig

SCENARIOS = sorted(
    f.name.removesuffix(".toml") for f in resources.files("uwserver_scenarios").iterdir() if f.name.endswith(".toml")
)


def _small(field):
    """A value that every command takes."""
    if field.type == "bytes":
        return b"x"
    return 0.1 if field.maximum is None else min(0.1, field.maximum)


@cache
def resolved(name):
    return load(name, adapters=installed_adapters())


@pytest.mark.parametrize("name", SCENARIOS)
def test_it_runs_through_the_command(name):
    program = sys.executable if name == "bluerov2_pool" else python()
    command = [program, "-m", "uwserver", "run", name, "--port", "0", "--mode", "freerun", "--until", "0.5"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_sensor_speaks_and_every_actuator_takes_a_command(name):
    world = build(resolved(name))
    for path, port in world.ports.items():
        if port.direction == "actuator" and port.kind != "teleport":
            world.command(path, **{f.name: [_small(f)] * f.size if f.shape else _small(f) for f in port.fields})
    spoken = {sample.port for sample in world.step(round(2 * world.rate_hz))}
    # A modem tells what it hears, and who sends at the same time is deaf.
    modems = {path for path, port in world.ports.items() if port.kind.endswith("_modem")}
    assert spoken - modems == {path for path, port in world.ports.items() if port.direction == "sensor"} - modems
    assert all(max(map(abs, vehicle.nu)) < 5.0 for vehicle in world.vehicles.values())


@pytest.mark.parametrize("name", SCENARIOS)
def test_what_its_header_says_to_type_is_right(name):
    """The first lines of a scenario name it in `uwserver run`, and ports and fields that it has."""
    text = (resources.files("uwserver_scenarios") / f"{name}.toml").read_text()
    lines = [line.removeprefix("#").split("#")[0].split() for line in text.partition("\nschema")[0].splitlines()]
    world = build(resolved(name))
    for words in lines:
        if words[:2] == ["uwserver", "run"]:
            assert words[2] == name
        elif words[:2] == ["uwclient", "send"]:
            values = [word.partition("=") for word in words[3:] if "=" in word]
            world.command(words[2], **{key: json.loads(value.strip("'")) for key, _, value in values})
        elif words[:2] == ["uwclient", "echo"]:
            assert words[2] in world.ports


def test_one_of_everything_has_one_of_everything():
    everything = resolved("one_of_everything")
    vehicles = [vehicle.vehicle for vehicle in everything.vehicles.values()]
    sensors = [sensor for vehicle in vehicles for sensor in vehicle.sensors.values()]
    used = {type(sensor) for sensor in sensors} | {type(a) for vehicle in vehicles for a in vehicle.actuators.values()}
    streams = [stream for sensor in sensors for stream in (sensor, *sensor.streams.values())]
    used |= {type(m) for stream in streams for m in stream.modifiers.values()}
    used |= {type(adapter) for adapter in everything.scenario.adapters.values()}
    every = {*SensorConfig.__args__, *ActuatorConfig.__args__, *ModifierConfig.__args__, *installed_adapters().values()}
    assert every <= used
