"""What happens in a run: commands and calls, each in its tick, made from a seed for whatever ports a scenario has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import uwserver
from uwserver.ports import Call, Command, Field, Port
from uwserver.ports.checks import checked_args, checked_command, find
from uwserver.world import World

SCENARIOS = (
    "rov_autopilot",  # missions
    "one_of_everything",  # every sensor, modifier and actuator, waves, a drifting current
    "push_the_crate",  # a free body in contact
    "slope",  # a sled and a lander on bathymetry
    "remus_survey",  # fins and a propeller over a slope
    "subsea_template",  # structures, a current that changes with depth and in time
    "pool_inspection",  # walls to bump into
)
JUMPS = ("world/reset", "world/restore")
REBUILDING = (*JUMPS, "world/spawn", "world/remove")
"""Calls after which a world in real time carries out no more in the same tick."""
CHAPTER = 600
"""Ticks in which everything happens once."""
ACT_EVERY = 8
"""Ticks between two acts, on average."""
REACH = 8.0
"""Where a port or its unit sets no narrower bound, commands are within this."""


@dataclass(frozen=True)
class Act:
    """A command to a port, or a call of a service.

    Attributes:
        path: of the port or service.
        given: value or arguments, as a client says them.
        is_command: whether `path` is a port.
    """

    path: str
    given: Mapping[str, Any]
    is_command: bool

    @property
    def is_jump(self) -> bool:
        """Whether it puts the world to another time."""
        return self.path in JUMPS

    def item(self, world: World, source: str) -> Command | Call:
        """For a world as it is now. Raises `Refused` as a server does before anything is posted."""
        if self.is_command:
            find("port", self.path, world.ports)
            return Command(self.path, checked_command(world.ports[self.path], self.given), source)
        find("service", self.path, world.services)
        return Call(self.path, checked_args(world.services[self.path], self.given), source)


@dataclass(frozen=True)
class Story:
    """Ticks are counted from the beginning of the run, also where the world goes back in time.

    Attributes:
        scenario: its name.
        steps: ticks to be run.
        acts: what is asked before the tick of that number, in order.
    """

    scenario: str
    steps: int
    acts: Mapping[int, tuple[Act, ...]]

    def numbered(self, step: int) -> list[tuple[str, Act]]:
        """The acts before a tick, with names for their replies."""
        return [(f"{step}.{n}", act) for n, act in enumerate(self.acts.get(step, ()))]

    def next_after(self, step: int) -> int:
        """The next tick before which something is asked, or the end."""
        return min((at for at in self.acts if at > step), default=self.steps)

    @property
    def first_jump(self) -> int:
        """The first tick before which a snapshot is kept, or the world goes to another time."""
        kept = ("world/snapshot", *JUMPS)
        return min((at for at, acts in self.acts.items() if any(act.path in kept for act in acts)), default=self.steps)


def story(scenario: str, steps: int, seed: int = 1) -> Story:
    """A story for a scenario: some commands to each actuator, and everything else that can happen to a world."""
    world = uwserver.load(scenario).core
    rng = np.random.default_rng([seed, *scenario.encode()])
    ports = [port for port in world.ports.values() if port.direction == "actuator" and port.kind != "teleport"]
    if any(port.kind == "autopilot" for port in ports):  # which holds most of the others for most of the time
        followed = ("pilot", "position", "velocity", "attitude", "heading")
        ports += 3 * [port for port in ports if port.kind == "autopilot" and port.path.rpartition("/")[2] in followed]
    acts: dict[int, list[Act]] = {}
    for _ in range(steps // ACT_EVERY):
        at = int(rng.integers(0, steps))
        # Now and then several in one tick.
        for _ in range(1 if rng.random() < 0.8 else 3):
            acts.setdefault(at, []).append(_command(ports[int(rng.integers(len(ports)))], rng))
    for begin in range(0, steps, CHAPTER):
        for part, act in _incidents(world, rng):
            acts.setdefault(min(steps - 1, begin + int(part * CHAPTER)), []).append(act)
    ordered = {at: sorted(found, key=lambda act: act.path in REBUILDING) for at, found in sorted(acts.items())}
    return Story(scenario, steps, {at: tuple(found) for at, found in ordered.items()})


def _command(port: Port, rng: np.random.Generator) -> Act:
    given = {field.name: _value(field, rng) for field in port.fields[:1]}
    if port.path.endswith("/attitude"):
        given = {"q_NB": [1.0, 0.0, 0.0, round(float(rng.uniform(-1.0, 1.0)), 3)]}
    if port.kind in ("force_torque", "autopilot") and len(port.fields) == 2:
        given |= {field.name: _value(field, rng) for field in port.fields[1:]}
    return Act(port.path, given, is_command=True)


def _value(field: Field, rng: np.random.Generator) -> Any:
    low = max(-REACH, -REACH if field.minimum is None else field.minimum)
    high = min(REACH, REACH if field.maximum is None else field.maximum)
    if field.name == "speed_radps":
        low, high = 0.0, field.maximum or REACH
    if field.name in ("force_B", "torque_B") and field.maximum:
        low, high = -0.3 * field.maximum, 0.3 * field.maximum
    values = rng.uniform(low, high, field.size).tolist()
    return values if field.shape else values[0]


def _incidents(world: World, rng: np.random.Generator) -> list[tuple[float, Act]]:
    """What happens in each chapter, as parts of it: faults, other currents, bodies that come and go, jumps in time."""
    path = next(iter(world.vehicles))
    model = next(name for name in world.vehicles if not name.startswith(("crate", "lander", "sled")))
    sensors = [p for p, slot in world.sensors.items() if "/truth/" not in p and "/autopilot/" not in p and slot.active]
    sensor = sensors[int(rng.integers(len(sensors)))]
    thrusters = [port.path for port in world.ports.values() if port.kind == "thrusters"]
    place = rng.uniform(-3.0, 3.0, 3)
    told: list[tuple[float, str, dict[str, Any]]] = [
        (0.05, "world/set_current", {"velocity_N": rng.uniform(-0.3, 0.3, 3).tolist()}),
        (0.10, "world/set_fault", {"name": "hull", "kind": "buoyancy_change", "target": path, "parameters": {"fraction": -0.02}}),
        (0.15, "world/set_fault", {"name": "mute", "kind": "sensor_silent", "target": sensor}),
        (0.20, "world/spawn", {"name": "guest", "like": model, "p_NB": [float(12 + place[0]), float(place[1]), 1.0]}),
        (0.25, "world/state_hash", {}),
        (0.30, "world/snapshot", {"name": "here"}),
        (0.36, "world/clear_fault", {"name": "mute"}),
        (0.40, f"{sensor}/set", {"rate_hz": 4.0}),
        (0.45, "world/set_fault", {"name": "ice", "kind": "sensor_frozen", "target": sensor, "parameters": {"until_s": 1.4}}),
        (0.55, "world/restore", {"name": "here"}),
        (0.60, "world/remove", {"name": "guest"}),
        (0.63, "world/spawn", {"name": "second", "like": model, "p_NB": [float(14 + place[0]), float(place[1]), 1.5]}),
        (0.65, f"{sensor}/deactivate", {}),
        (0.70, f"{sensor}/activate", {}),
        (0.75, "world/snapshot", {"name": "there"}),
        (0.80, "world/reset", {}),
        (0.95, "world/restore", {"name": "there"}),
        (0.98, "world/clear_fault", {"name": "hull"}),
        (0.99, "world/remove", {"name": "second"}),
    ]  # fmt: skip
    if thrusters:
        fault = {"name": "lame", "kind": "thruster_weak", "target": thrusters[0], "parameters": {"factor": 0.4}}
        told += [(0.12, "world/set_fault", fault), (0.5, "world/clear_fault", {"name": "lame"})]
    if f"{path}/autopilot/arm" in world.services:
        there = [round(float(x), 2) for x in (place[0], place[1], 6.0)]
        mission = [{"kind": "waypoint", "position_ned_m": there}, {"kind": "hold", "time_s": 1.0}, {"kind": "surface"}]
        told += [
            (0.01, f"{path}/autopilot/arm", {"force": True}),
            (0.11, f"{path}/autopilot/set_mode", {"mode": "guided"}),
            (0.16, f"{path}/autopilot/goto", {"position_ned_m": there}),
            (0.35, f"{path}/autopilot/disarm", {}),
            (0.37, f"{path}/autopilot/arm", {"force": True}),
            (0.38, f"{path}/autopilot/set_mode", {"mode": "guided"}),
            (0.57, f"{path}/autopilot/set_mode", {"mode": "guided"}),
            (0.22, f"{path}/autopilot/set_mission", {"items": mission}),
            (0.28, f"{path}/autopilot/start_mission", {}),
            (0.81, f"{path}/autopilot/arm", {"force": True}),
            (0.90, f"{path}/autopilot/set_mode", {"mode": "position_hold"}),
        ]
    return [(part, Act(service, args, is_command=False)) for part, service, args in told]
