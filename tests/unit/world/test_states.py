"""Saved states: every kind of part goes on bit for bit in another world and another process, and what does not fit is refused."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import uwserver
from uwserver.ports import Refused
from uwserver.scenario.files.documents import shipped
from uwserver.world import snapshot
from uwserver.world.world import World

SCENARIOS = sorted(shipped("."))
IN_ANOTHER_PROCESS = """
import sys
import msgspec, uwserver
from uwserver.world import snapshot

jobs = msgspec.msgpack.decode(sys.stdin.buffer.read())
for name, (data, ticks) in jobs.items():
    world = uwserver.load(name)
    snapshot.from_bytes(world, data)
    world.step(ticks)
    print(name, snapshot.take(world).hash())
"""


def in_the_middle(name: str) -> World:
    """A shipped scenario in the middle of all that it can be in the middle of."""
    world = uwserver.load(name)
    world.step(50)
    for path in [path for path in world.services if path.endswith("/set_mission")]:
        vehicle = path.rsplit("/", 1)[0]
        place = [10.0, 5.0, 4.0]
        world.call(path, items=[{"kind": "waypoint", "position_ned_m": place}, {"kind": "hold", "time_s": 5}])
        world.call(f"{vehicle}/arm", force=True)
        try:
            world.call(f"{vehicle}/start_mission")
        except Refused:
            world.call(f"{vehicle}/set_mode", mode="manual")
    for path, port in world.ports.items():
        if port.kind == "thrusters" and not world.actuators[path].refusal:
            world.command(path, u=[0.2] * port.fields[0].size)
            world.call(
                "world/set_fault",
                name="weak",
                kind="thruster_weak",
                target=path,
                parameters={"factor": 0.5, "until_s": 2.0},
            )
            break
    world.call("world/set_current", velocity_N=[0.1, 0.0, 0.0])
    world.step(97)
    return world


@pytest.fixture(scope="module")
def elsewhere() -> dict[str, tuple[str, str]]:
    """State hash of every shipped scenario after some ticks from a saved state, in this process and in another."""
    here, jobs = {}, {}
    for name in SCENARIOS:
        world = in_the_middle(name)
        ticks = 20 if name == "swarm_100" else 120
        jobs[name] = (snapshot.to_bytes(world, snapshot.take(world)), ticks)
        world.step(ticks)
        here[name] = snapshot.take(world).hash()
    done = subprocess.run(
        [sys.executable, "-c", IN_ANOTHER_PROCESS], input=msgspec.msgpack.encode(jobs), capture_output=True, timeout=600
    )
    assert done.returncode == 0, done.stderr.decode()
    there = dict(line.split() for line in done.stdout.decode().splitlines())
    return {name: (here[name], there[name]) for name in SCENARIOS}


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_shipped_scenario_goes_on_in_another_process(elsewhere: dict[str, tuple[str, str]], name: str) -> None:
    here, there = elsewhere[name]
    assert here == there


# -- every kind of part --------------------------------------------------------------------------------------------------------------------


def kind_of(world: World, path: str) -> str:
    slot: Any = world.sensors.get(path) or world.actuators.get(path)
    return path if slot is None else f"{slot.port.direction} {slot.port.kind}"


@cache
def everything() -> tuple[World, World, snapshot.Snapshot]:
    """A world with one of every kind after some seconds, another one that took its state over as bytes, and the state at the start."""
    world, other = (uwserver.load("one_of_everything") for _ in range(2))
    start = snapshot.take(other)
    for path, port in world.ports.items():
        if port.direction == "actuator" and port.kind in ("thrusters", "fins", "propeller", "ballast", "moving_mass"):
            high = port.fields[0].maximum or 1.0
            world.command(path, **{port.fields[0].name: np.full(port.fields[0].shape, 0.3 * high).tolist()})
    world.step(700)
    world.call("world/spawn", name="second", like=next(iter(world.vehicles)), p_NB=[30.0, 30.0, 20.0])
    world.step(300)
    snapshot.from_bytes(other, snapshot.to_bytes(world, snapshot.take(world)))
    return world, other, start


KINDS = sorted({kind_of(everything()[0], path) for path in everything()[0].parts})


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_part_takes_its_state_over(kind: str) -> None:
    world, other, _ = everything()
    for path in [path for path in world.parts if kind_of(world, path) == kind]:
        # As bytes, for a number that is none equals itself there.
        assert msgspec.msgpack.encode(other.parts[path].save()) == msgspec.msgpack.encode(world.parts[path].save()), (
            path
        )


def test_what_came_later_is_there_too_and_all_go_on_alike() -> None:
    world, other, start = everything()
    assert list(other.vehicles) == list(world.vehicles)
    assert other.ports == world.ports
    assert other.step(200) == world.step(200)
    assert snapshot.take(other) == snapshot.take(world)
    for each in (world, other):
        snapshot.restore(each, start)
        assert "second" not in each.vehicles
        assert snapshot.take(each) == start


def changes(world: World, start: snapshot.Snapshot) -> list[str]:
    now = snapshot.take(world)
    return [path for path in start.parts if now.parts[path] != start.parts[path]]


def test_the_state_of_a_part_matters() -> None:
    """A state in which one part is as it was at the start goes on otherwise, or that part's state holds nothing of use."""
    world = uwserver.load("rov_autopilot")
    start = snapshot.take(world)
    world.step(301)
    kept = snapshot.take(world)
    world.step(60)
    expected = snapshot.take(world).hash()
    changed = [path for path in start.parts if kept.parts[path] != start.parts[path]]
    assert len(changed) > 5
    for path in changed:
        mixed = snapshot.Snapshot(kept.tick, {**kept.parts, path: start.parts[path]})
        snapshot.restore(world, mixed)
        world.step(60)
        assert snapshot.take(world).hash() != expected, path


def test_at_any_tick_of_pings_and_exchanges() -> None:
    """Sonar pings, USBL and LBL exchanges take many ticks: a state from any of them goes on alike."""
    world, other = (uwserver.load("one_of_everything") for _ in range(2))
    world.step(240)
    states, samples = [], []
    for _ in range(90):
        states.append(snapshot.to_bytes(world, snapshot.take(world)))
        samples.append(world.step())
    for k in range(0, 60, 3):
        snapshot.from_bytes(other, states[k])
        assert [other.step() for _ in range(30)] == samples[k : k + 30], k


# -- refused -------------------------------------------------------------------------------------------------------------------------------


def refusal(world: World, data: bytes) -> str:
    before, events = snapshot.take(world), len(world.vehicles)
    with pytest.raises(Refused) as caught:
        snapshot.from_bytes(world, data)
    assert snapshot.take(world) == before
    assert len(world.vehicles) == events
    return caught.value.fault.text


def saved(world: World) -> bytes:
    return snapshot.to_bytes(world, snapshot.take(world))


def forged(world: World, change: Callable[[Any], Any]) -> bytes:
    """A saved state with something else in it, and a check sum that fits."""
    raw = msgspec.msgpack.decode(saved(world)[:-32])
    body = msgspec.msgpack.encode(change(raw) or raw)
    return body + hashlib.sha256(body).digest()


def test_damaged_cut_and_huge_ones_are_refused(world: World) -> None:
    world.step(30)
    data = saved(world)
    for bad in (b"", data[:10], data[:-1], data[:40] + b"?" + data[41:], data + b"x"):
        assert "check sum" in refusal(world, bad)
    assert "at most" in refusal(world, bytes(snapshot.MAX_BYTES + 1))


def test_those_of_another_version_are_refused(world: World) -> None:
    assert "another version of uwserver (physics 1" in refusal(world, forged(world, lambda raw: raw.update(physics=1)))
    text = refusal(world, forged(world, lambda raw: raw.update(format="uwserver-state-9")))
    assert "another version" in text
    assert "no saved state of this version" in refusal(world, forged(world, lambda raw: raw.update(more=1)))


def test_those_of_another_scenario_or_seed_are_refused(make_world: Callable[..., World]) -> None:
    world = make_world()
    assert "another scenario" in refusal(world, saved(make_world(vehicles=2)))
    assert "another scenario" in refusal(world, saved(make_world(rate_hz=480.0)))
    assert "(seed 6, here 5)" in refusal(world, saved(make_world(seed=6)))


def _bodies(change: Callable[[np.ndarray[Any, Any]], None]) -> Callable[[Any], None]:
    def applied(raw: Any) -> None:
        arrays = raw["parts"]["world/bodies"]["arrays"]
        state = np.frombuffer(arrays["state"]).reshape(-1, 13).copy()
        change(state)
        arrays["state"] = state.tobytes()

    return applied


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (_bodies(lambda x: x.__setitem__((0, 2), np.nan)), "not finite"),
        (_bodies(lambda x: x.__setitem__((0, 7), np.inf)), "not finite"),
        (_bodies(lambda x: x.__setitem__((0, slice(3, 7)), 0.0)), "no rotation"),
        (lambda raw: raw["parts"].pop("rov/imu"), "rov/imu"),
        (lambda raw: raw["parts"].update({"rov/more": {}}), "rov/more"),
        (lambda raw: raw.update(tick=-1), "tick -1"),
        (lambda raw: raw["parts"]["rov/imu"].update(seq="x"), "int"),
        (lambda raw: raw["parts"]["rov/imu"].update(divisor=0), ">= 1"),
        (lambda raw: raw["parts"]["rov/imu"].update(memories=[]), "modifiers"),
        (lambda raw: raw["parts"]["rov/imu"].update(held=[True, [1.0]]), "fields"),
        (lambda raw: raw["parts"]["rov/thrusters"].update(last_value=[[9.0] * 8]), "at most"),
        (lambda raw: raw["parts"]["world/water"].update(current=[1e9, 0.0, 0.0]), "current"),
        (lambda raw: raw["parts"]["world/samples"].update(samples=[[1, 0, "rov/none", 0, 0, True, []]]), "rov/none"),
        (lambda raw: raw["parts"]["world/population"].update(born=[{"like": "/etc/passwd", "name": "x"}]), "/etc/passwd"),
        (lambda raw: raw["parts"]["world/population"].update(born=[{"like": "rov", "name": "a/b"}]), "cannot be a name"),
    ],
)  # fmt: skip
def test_impossible_ones_are_refused_and_change_nothing(
    make_world: Callable[..., World], change: Callable[[Any], None], text: str
) -> None:
    world = make_world()
    world.step(40)
    world.command("rov/thrusters", u=[0.1] * 8)
    world.step(5)
    assert text in refusal(world, forged(world, lambda raw: change(raw) and None))
    world.step(20)


def test_no_more_bodies_than_a_world_may_have(make_world: Callable[..., World]) -> None:
    world = make_world()
    born = [{"like": "rov", "name": f"r{k}"} for k in range(1001)]
    text = refusal(world, forged(world, lambda raw: raw["parts"]["world/population"].update(born=born)))
    assert "<= 1000" in text


def test_nothing_named_in_it_is_opened(make_world: Callable[..., World], tmp_path: Path, monkeypatch: Any) -> None:
    world = make_world()
    data = saved(world)
    opened: list[Any] = []

    def audit(event: str, args: Any) -> None:
        if event in ("open", "import", "exec", "compile") and watching:
            opened.append((event, args))

    watching = False
    sys.addaudithook(audit)
    snapshot.from_bytes(world, data)  # what is loaded at a first use is loaded now
    watching = True
    snapshot.from_bytes(world, data)
    watching = False
    assert opened == []


SPELT = """
schema = 1
[vehicles.rov]
model = "bluerov2_heavy"
{gains}
[vehicles.rov.autopilot]
mode = "manual"
[faults.weak]
kind = "thruster_weak"
target = "rov/thrusters"
factor = 0.5
{at}
"""


def test_a_default_that_is_spelt_out_is_the_default(tmp_path: Path) -> None:
    """A recording spells every default of its scenario: its world must still have the same states."""
    hashes = set()
    for k, words in enumerate(
        (
            {"gains": "", "at": ""},
            {"gains": "[vehicles.rov.override.autopilot.gains]\nrate_p = 6.0", "at": "at_s = 0.0"},
        )
    ):
        path = tmp_path / f"{k}.toml"
        path.write_text(SPELT.format(**words))
        world = uwserver.load(path)
        world.step(60)
        hashes.add(snapshot.take(world).hash())
    assert len(hashes) == 1


def test_it_is_small_and_the_hash_does_not_tell_who_commanded(world: World) -> None:
    world.step(100)
    assert len(saved(world)) < 20_000
