"""Saved states: every kind of part goes on bit for bit in another world and another process, and what does not fit is refused."""

from __future__ import annotations

import contextlib
import hashlib
import math
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import uwserver
from uwserver.physics.bodies import Hydrodynamics
from uwserver.ports import Refused
from uwserver.scenario.files.documents import shipped
from uwserver.scenario.load.checks import MOST_BODIES
from uwserver.world.state import snapshot
from uwserver.world.world import Diverged, World

SCENARIOS = sorted(shipped("."))
PAGE = Path(__file__).parents[4] / "docs/how-to/extend.md"
EXTENDED = """
schema = 1
seed = 4
extensions = ["turbidity.py", "jet.py", "river.py", "loose.py"]

[environment.currents.tide]
kind = "tide"
velocity_ned_mps = [0.6, 0.2, 0.0]
gust_mps = 0.05

[environment.currents.layer]
kind = "bottom_layer"
velocity_ned_mps = [0.4, 0.0, 0.0]
bottom_depth_m = 12

[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]

[vehicles.rov.sensors.turbidity]
kind = "turbidity"
rate_hz = 10
bottom_ntu = 40

[vehicles.rov.sensors.turbidity.modifiers.fouling]
kind = "fouling"
field = "turbidity"
growth_ps = 0.001

[vehicles.rov.override.actuators.jet]
kind = "jet"
position_frd_m = [0.2, 0.0, 0.0]
direction_frd = [0.0, 1.0, 0.0]
max_force_N = 15

[faults.plug]
kind = "loose_connector"
target = "rov/thrusters"
at_s = 0.5
until_s = 60
every_s = 0.3
"""
"""One of every kind that the how-to page about extensions brings."""
IN_ANOTHER_PROCESS = """
import sys
import msgspec, uwserver
from uwserver.world.state import snapshot

jobs = msgspec.msgpack.decode(sys.stdin.buffer.read())
for name, (scenario, data, ticks, _) in jobs.items():
    world = uwserver.load(scenario).core
    snapshot.from_bytes(world, data)
    world.step(ticks)
    print(name, snapshot.take(world).hash())
"""


LOCATING = ("dvl", "gps", "usbl", "lbl", "motion_capture")
"""Kinds without which no mission begins."""


def extended(folder: Path) -> Path:
    """The scenario of the extensions, with their files beside it."""
    for name, code in re.findall(r"^`(\w+\.py)`:\n```python\n(.*?)^```", PAGE.read_text(), re.S | re.M):
        (folder / name).write_text(code)
    path = folder / "extended.toml"
    path.write_text(EXTENDED)
    return path


def fly(world: World) -> None:
    """Let every autopilot of a world fly a mission, and be in the middle of it."""
    located = {path.partition("/")[0] for path, port in world.ports.items() if port.kind in LOCATING}
    pilots = [path.rsplit("/", 1)[0] for path in world.services if path.endswith("/set_mission")]
    pilots = [pilot for pilot in pilots if pilot.partition("/")[0] in located]
    if not pilots:
        return
    world.step(300)  # until the sensors have spoken that a mission needs
    place = {"kind": "waypoint", "position_ned_m": [10.0, 5.0, 4.0]}
    for pilot in pilots:
        world.call(f"{pilot}/set_mission", items=[place, {"kind": "hold", "time_s": 5}])
        world.call(f"{pilot}/arm", force=True)
        world.call(f"{pilot}/start_mission")
    world.step(60)
    modes = {state.value[0] for state in (world.read(f"{pilot}/state") for pilot in pilots) if state is not None}
    assert modes == {"mission"}


def in_the_middle(name: str) -> World:
    """A scenario in the middle of a mission, of faults of thrusters, a sensor and a hull, and under thrust, as far as it has these."""
    world = uwserver.load(name).core
    world.step(50)
    fly(world)
    of_kind = {port.kind: path for path, port in reversed(world.ports.items())}
    faults: list[tuple[str, str, dict[str, Any]]] = []
    if world.actuators:  # bodies that follow a log have no hull that could leak
        faults.append(("buoyancy_change", next(iter(world.vehicles)), {"force_N": 2.0}))
    if "thrusters" in of_kind:
        path = of_kind["thrusters"]
        faults.append(("thruster_weak", path, {"factor": 0.5, "until_s": 60.0}))
        if not world.actuators[path].refusal:
            world.command(path, u=[0.2] * world.ports[path].fields[0].size)
    if "pressure" in of_kind:
        faults.append(("sensor_frozen", of_kind["pressure"], {}))
    for kind, target, parameters in faults:
        world.call("world/set_fault", name=kind, kind=kind, target=target, parameters=parameters)
    world.call("world/set_current", velocity_N=[0.1, 0.0, 0.0])
    world.step(97)
    return world


Jobs = dict[str, tuple[str, bytes, int, str]]
"""By name: scenario, state, ticks to go on, and the hash that this process came to."""


def ping(name: str, jobs: Jobs, times: int) -> None:
    """States of ticks in which a ping of the sonar, and an exchange with beacons, are under way."""
    world = uwserver.load(name).core
    world.step(240)
    for _ in range(times):
        world.step(1)
        while not any(slot.sensor.wake is not None for slot in world.sensors.values()):
            world.step(1)
        state = snapshot.to_bytes(world, snapshot.take(world))
        on = uwserver.load(name).core
        snapshot.from_bytes(on, state)
        on.step(120)
        jobs[f"{name}, exchange at tick {world.tick}"] = (name, state, 120, snapshot.take(on).hash())
        world.step(17)


def differ_elsewhere(names: Sequence[str], exchanges: int) -> list[str]:
    """Which of these scenarios have another state hash some ticks after a saved state in another process than in this."""
    jobs: Jobs = {}
    for name in names:
        world = in_the_middle(name)
        ticks = 20 if name == "swarm_100" else 120
        state = snapshot.to_bytes(world, snapshot.take(world))
        world.step(ticks)
        jobs[Path(name).stem] = (name, state, ticks, snapshot.take(world).hash())
    ping("one_of_everything", jobs, exchanges)
    done = subprocess.run(
        [sys.executable, "-c", IN_ANOTHER_PROCESS], input=msgspec.msgpack.encode(jobs), capture_output=True, timeout=600
    )
    assert done.returncode == 0, done.stderr.decode()
    there = dict(line.rsplit(" ", 1) for line in done.stdout.decode().splitlines())
    assert there.keys() == jobs.keys()
    assert len(jobs) == len(names) + exchanges
    return [name for name, job in jobs.items() if job[3] != there[name]]


def test_scenarios_and_exchanges_under_way_go_on_in_another_process(tmp_path: Path) -> None:
    """Those that together have a part of each kind, with missions, contacts, fins, and a body that follows a log."""
    chosen = ("filter_review", "one_of_everything", "push_the_crate")
    assert not differ_elsewhere([*chosen, str(extended(tmp_path))], 1)


@pytest.mark.slow
def test_every_scenario_goes_on_in_another_process() -> None:
    assert not differ_elsewhere(SCENARIOS, 3)


# -- every kind of part --------------------------------------------------------------------------------------------------------------------


DRIVEN = ("thrusters", "fins", "propeller", "ballast", "moving_mass", "jet")


@pytest.fixture(scope="module", params=["one_of_everything", "extended"])
def everything(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[World, World, snapshot.Snapshot]:
    """A world with one of every kind after some seconds, another one that took its state over as bytes, and the state at the start."""
    folder = tmp_path_factory.mktemp("extended")
    scenario = str(extended(folder)) if request.param == "extended" else request.param
    world, other = (uwserver.load(scenario).core for _ in range(2))
    start = snapshot.take(other)
    for path, port in world.ports.items():
        if port.direction == "actuator" and port.kind in DRIVEN:
            high = port.fields[0].maximum or 1.0
            world.command(path, **{port.fields[0].name: np.full(port.fields[0].shape, 0.8 * high).tolist()})
    world.step(400)
    world.call("world/spawn", name="second", like=next(iter(world.vehicles)), p_NB=[30.0, 30.0, 20.0])
    world.step(200)
    snapshot.from_bytes(other, snapshot.to_bytes(world, snapshot.take(world)))
    return world, other, start


def test_every_part_takes_its_state_over(everything: tuple[World, World, snapshot.Snapshot]) -> None:
    """Those of extensions too: a sensor with its modifier, an actuator that remembers, a current that drifts, a fault."""
    world, other, start = everything
    # As bytes, for a number that is none equals itself there.
    kept, taken = (
        {path: msgspec.msgpack.encode(part.save().completed()) for path, part in one.parts.items()}
        for one in (world, other)
    )
    assert kept.keys() == taken.keys()
    assert [path for path in kept if kept[path] != taken[path]] == []
    if "rov/turbidity" not in world.parts:
        return
    assert len(world.water.sea.drifts) == 1  # type: ignore[union-attr]  # the tide
    assert any(entry.name.startswith("plug/") for entry in world.parts["world/faults"].save().entries)
    for path in ("rov/turbidity", "rov/jet", "world/water", "world/faults"):
        assert world.parts[path].save() != start.parts[path], f"{path} has nothing to take over"


def test_what_came_later_is_there_too_and_all_go_on_alike(
    everything: tuple[World, World, snapshot.Snapshot],
) -> None:
    world, other, start = everything
    assert list(other.vehicles) == list(world.vehicles)
    assert other.ports == world.ports
    assert other.step(200) == world.step(200)
    assert snapshot.take(other) == snapshot.take(world)
    for each in (world, other):
        snapshot.restore(each, start)
        assert "second" not in each.vehicles
        assert snapshot.take(each) == start


def test_the_state_of_a_part_matters() -> None:
    """A state in which one part is as it was at the start goes on otherwise, or that part's state holds nothing of use."""
    world = uwserver.load("rov_autopilot").core
    world.call("world/let_go")
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
    world, other = (uwserver.load("one_of_everything").core for _ in range(2))
    world.step(240)
    states, samples = [], []
    for _ in range(90):
        states.append(snapshot.to_bytes(world, snapshot.take(world)))
        samples.append(world.step())
    for k in range(0, 60, 5):
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


def on_its_way(port: str, t_sent_ns: int, *numbers: float) -> dict[str, Any]:
    """One sample, in a state."""
    entry = np.array([t_sent_ns, 1, 0, 0, 0, 1]).tobytes()
    return {"order": 1, "ports": [port], "entries": entry, "numbers": np.array(numbers, float).tobytes(), "loose": []}


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
        (_bodies(lambda x: x.__setitem__((0, 3), 1e300)), "no rotation"),
        (lambda raw: raw["parts"].pop("rov/imu"), "rov/imu"),
        (lambda raw: raw["parts"].update({"rov/more": {}}), "rov/more"),
        (lambda raw: raw.update(tick=-1), "tick -1"),
        (lambda raw: raw["parts"]["rov/imu"].update(number="x"), "int"),
        (lambda raw: raw["parts"]["rov/imu"].update(divisor=0), ">= 1"),
        (lambda raw: raw["parts"]["rov/pressure"].update(numbers=b""), "modifiers"),
        (lambda raw: raw["parts"]["rov/pressure"].update(modifiers=[bytes(16)]), "modifiers"),
        (lambda raw: raw["parts"]["rov/imu"].update(numbers=bytes(8)), "readings"),
        (lambda raw: raw["parts"]["rov/imu"].update(held=bytes(16)), "streams"),
        (lambda raw: raw["parts"]["rov/imu"].update(memory=bytes(3)), "bytes of memory"),
        (lambda raw: raw["parts"]["rov/thrusters"].update(last_value=[[9.0] * 8]), "at most"),
        (lambda raw: raw["parts"]["world/water"].update(current=[1e9, 0.0, 0.0]), "current"),
        (lambda raw: raw["parts"]["world/samples"].update(on_its_way("rov/none", 1)), "rov/none"),
        (lambda raw: raw["parts"]["world/samples"].update(on_its_way("rov/imu", 1, 0.0)), "other fields"),
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
    born = [{"like": "rov", "name": f"r{k}"} for k in range(MOST_BODIES + 1)]
    text = refusal(world, forged(world, lambda raw: raw["parts"]["world/population"].update(born=born)))
    assert f"<= {MOST_BODIES}" in text


@pytest.mark.parametrize("present", [True, False])
@pytest.mark.parametrize("parts", [True, False])
def test_nobody_is_made_for_a_state_that_has_not_what_belongs_to_them(
    make_world: Callable[..., World], monkeypatch: pytest.MonkeyPatch, present: bool, parts: bool
) -> None:
    """Names cost a few bytes, and bodies milliseconds: with the parts of all of them, their rows are still missing."""
    world = make_world()
    born = [{"like": "rov", "name": f"r{k}", "present": present} for k in range(999)]

    def change(raw: Any) -> None:
        raw["parts"]["world/population"].update(born=born)
        if parts:
            own = {path: state for path, state in raw["parts"].items() if path.startswith("world/")}
            rov = {path[4:]: state for path, state in raw["parts"].items() if path.startswith("rov/")}
            here = [body["name"] for body in born if present]
            raw["parts"] = own | {f"{name}/{part}": state for name in here for part, state in rov.items()}

    data, made = forged(world, change), list[str]()
    add = Hydrodynamics.add
    monkeypatch.setattr(Hydrodynamics, "add", lambda *args: made.append("") or add(*args))
    text = refusal(world, data)
    assert ("999 rows" if parts else "other vehicles or components") in text
    assert not made


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda raw: raw["parts"].update({f"{k:x}": None for k in range(2**17)}), "length"),
        (lambda raw: raw["parts"]["world/population"].update(scenario=[""] * 100_000), "length"),
        (lambda raw: raw["parts"]["world/bodies"]["arrays"].update({str(k): b"" for k in range(100)}), "length"),
        (lambda raw: raw["parts"]["world/water"].update(drifts=[[b"", [0.0] * 7]]), "length"),
        (lambda raw: raw["parts"]["world/faults"].update(entries=[None] * 257), "length"),
        (lambda raw: raw["parts"]["world/samples"].update(entries=bytes(48 * 65537)), "length"),
        (lambda raw: raw["parts"]["world/samples"].update(ports=["rov/imu"] * 65537), "length"),
        (lambda raw: raw["parts"]["world/samples"].update(loose=[[]] * 65537), "length"),
        (lambda raw: raw["parts"]["rov/thrusters"].update(memory=b"x"), "has none"),
        (lambda raw: raw["parts"]["rov/thrusters"]["sources"].update(source="x" * 5000), "length"),
    ],
)
def test_counts_are_bounded_before_anything_is_made_of_them(
    make_world: Callable[..., World], change: Callable[[Any], Any], text: str
) -> None:
    world = make_world()
    assert text in refusal(world, forged(world, lambda raw: change(raw) and None))


def test_nothing_named_in_it_is_opened(make_world: Callable[..., World], tmp_path: Path) -> None:
    """Names in a state that are those of files, Python files and vehicle files too, are names and nothing more."""
    (tmp_path / "evil.py").write_text("raise SystemExit('run')")
    world, evil = make_world(), str(tmp_path / "evil.py")
    fault = {
        "name": evil,
        "fault": {"kind": "sensor_frozen", "target": evil},
        "begin": 0,
        "end": None,
        "state": "active",
    }
    changes: list[Callable[[Any], Any]] = [
        lambda raw: raw["parts"]["world/population"].update(born=[{"like": evil, "name": "x"}]),
        lambda raw: raw["parts"]["world/population"].update(scenario=[evil]),
        lambda raw: raw["parts"]["world/faults"].update(entries=[fault]),
        lambda raw: raw["parts"]["world/samples"].update(on_its_way(evil, 1)),
        lambda raw: raw["parts"].update({evil: {}}),
        lambda raw: raw.update(scenario=evil),
    ]
    states = [forged(world, lambda raw, change=change: change(raw) and None) for change in changes]
    good, opened, watching = saved(world), list[Any](), False

    def audit(event: str, args: Any) -> None:
        if watching and event in ("open", "import", "exec", "compile", "os.listdir", "subprocess.Popen"):
            opened.append((event, args))

    snapshot.from_bytes(world, good)  # what is loaded at a first use is loaded now
    sys.addaudithook(audit)
    watching = True
    for state in (good, *states):
        try:
            snapshot.from_bytes(world, state)
        except Refused:
            continue
    watching = False
    assert opened == []


# -- found by an attack ----------------------------------------------------------------------------------------------------------------------


def test_a_member_does_not_keep_rows_that_have_moved() -> None:
    """Bodies before it had no thrusters then, and have some now: commands must reach its own."""
    world, like = uwserver.load("push_the_crate").core, uwserver.load("push_the_crate").core
    objects = [name for name, member in world.members.items() if not member.actuators]
    rovs = [name for name, member in world.members.items() if member.actuators]
    for each in (world, like):
        each.call("world/spawn", name="y", like=objects[0], p_NB=[30.0, 0.0, 1.0])
        each.call("world/spawn", name="x", like=rovs[0], p_NB=[0.0, 30.0, 1.0])
    kept = snapshot.take(world)
    world.call("world/reset")
    world.call("world/spawn", name="v2", like=rovs[0], p_NB=[30.0, 0.0, 1.0])
    world.call("world/spawn", name="x", like=rovs[0], p_NB=[0.0, 30.0, 1.0])
    snapshot.restore(world, kept)
    (port,) = [path for path, each in world.ports.items() if path.startswith("x/") and each.kind == "thrusters"]
    for each in (world, like):
        each.command(port, u=[0.5] * each.ports[port].fields[0].size)
        each.step(60)
    assert world.vehicles["x"].p_NB == like.vehicles["x"].p_NB
    assert world.vehicles["y"].nu == like.vehicles["y"].nu


def test_a_refused_spawn_leaves_the_collisions_on() -> None:
    world = uwserver.load("bluerov2_open_sea").core
    (name,) = world.vehicles
    with pytest.raises(Refused, match="would begin inside"):
        world.call("world/spawn", name="x", like=name, p_NB=list(world.vehicles[name].p_NB))
    assert world.scene is not None
    assert world.hydro.collider is world.scene


def test_faults_in_any_order_can_be_saved(world: World) -> None:
    """What was set and cleared in an order in which it could not be set again is a state all the same."""
    volume = 0.01
    for name, part in (("a", 5.0), ("b", -0.5)):
        world.call(
            "world/set_fault", name=name, kind="buoyancy_change", target="rov", parameters={"volume_m3": part * volume}
        )
    world.call("world/clear_fault", name="a")
    kept = snapshot.take(world)
    world.step(5)
    snapshot.restore(world, kept)
    snapshot.from_bytes(world, saved(world))


@pytest.mark.parametrize("port", ["rov/imu", "rov/ahrs", "rov/dvl", "rov/depth"])
def test_samples_that_no_sensor_gives_do_not_stop_the_autopilot(port: str) -> None:
    world = uwserver.load("rov_autopilot").core
    world.step(300)
    width = sum(field.size for field in world.ports[port].fields)
    for number in (math.nan, 1e308, math.inf, 0.0):
        sample = on_its_way(port, world.t_ns + 1, *[number] * width)
        data = forged(world, lambda raw, sample=sample: raw["parts"]["world/samples"].update(sample) and None)
        snapshot.from_bytes(world, data)
        with contextlib.suppress(Diverged):
            world.step(3)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda raw: raw.update(tick=2**53), "not possible"),
        (lambda raw: raw["parts"]["rov/imu"].update(number=2**64 - 1), "<="),
        (lambda raw: raw["parts"]["world/samples"].update(order=2**64 - 1), "<="),
    ],
)
def test_numbers_that_could_not_be_saved_again_are_refused(
    make_world: Callable[..., World], change: Callable[[Any], Any], text: str
) -> None:
    world = make_world()
    world.step(10)
    assert text in refusal(world, forged(world, lambda raw: change(raw) and None))


def test_a_mission_without_items_is_not_under_way() -> None:
    world = uwserver.load("rov_autopilot").core
    fly(world)
    data = forged(world, lambda raw: raw["parts"]["rov/autopilot"]["pilot"].update(items=[]))
    assert "its mission does not have" in refusal(world, data)


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
        world = uwserver.load(path).core
        world.step(60)
        hashes.add(snapshot.take(world).hash())
    assert len(hashes) == 1


def test_it_is_small_and_the_hash_does_not_tell_who_commanded(world: World) -> None:
    world.step(100)
    assert len(saved(world)) < 20_000
