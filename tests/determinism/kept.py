"""Keeps what worlds do, as hashes and as plain arrays, so that another engine can be held against this one.

    python tests/determinism/kept.py keep FOLDER [--only NAME ...] [--seeds 1 2 3] [--seconds 60]
    python tests/determinism/kept.py compare OLD NEW

A run is a scenario that ships, a seed, and a kind: nobody touches it, and nobody is held (`untouched`); its actuators are commanded and faults begin
and end (`driven`); also bodies come and go and the time is set (`told`); or it is driven and no sensor has errors (`exact`). Each is made twice, tick
by tick and by `World.step` with odd numbers of ticks, which must be equal. All other ways are held against the first by `test_matrix`.

What is hashed does not hang on how an engine keeps it: states of the bodies at each tick, and the samples of each port. Of each driven run the arrays
of the bodies stand beside, at every 60th tick, with the states one tick later; of each exact one the numbers of all samples.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import structs

from uwserver.ports import Port, Refused, Sample
from uwserver.scenario.build.world import build
from uwserver.scenario.files.documents import shipped
from uwserver.scenario.load.resolved import Resolved
from uwserver.world import World

sys.path.insert(0, str(Path(__file__).parent))

from stories import JUMPS, Story, story
from ways import ODD, resolved

KINDS = ("untouched", "driven", "told", "exact")
EVERY = 60
"""Ticks between two states that are kept as arrays."""
_GOING = (*JUMPS, "world/spawn", "world/remove", "world/snapshot")
_encode = msgspec.json.Encoder().encode


class Run(msgspec.Struct):
    """What one was like.

    Attributes:
        ticks: made.
        states: digest of the states of all bodies at the end of each second.
        ports: digest of all samples of a port, and how many they are.
        ways_differ: "" where ticks one by one and many at a time are equal; else what is not.
    """

    ticks: int
    states: list[str] = []
    ports: dict[str, tuple[str, int]] = {}
    ways_differ: str = ""


class Keeper:
    """Follows one run.

    Attributes:
        arrays: by name, what is kept beside the hashes.
    """

    def __init__(self, world: World, numbers: bool, states: bool) -> None:
        """Of a world; `numbers` of all samples, `states` as arrays."""
        self._world, self._numbers, self._states = world, numbers, states
        self._state, self._ports = hashlib.sha256(), dict[str, Any]()
        self._counts: dict[str, int] = {}
        self._values: dict[str, list[list[float]]] = {}
        self._second = round(world.rate_hz)
        self.run, self.arrays = Run(0), dict[str, Any]()

    def take(self, samples: Sequence[Sample]) -> None:
        """What was delivered."""
        for s in samples:
            self._ports.setdefault(s.port, hashlib.sha256()).update(
                _encode((s.seq, s.t_ns, s.t_sent_ns, s.valid, s.value))
            )
            self._counts[s.port] = self._counts.get(s.port, 0) + 1
            if self._numbers:
                self._values.setdefault(s.port, []).append([float(s.t_ns), *_numbers(s.value)])

    def stand(self) -> None:
        """After a tick."""
        world, run = self._world, self.run
        run.ticks += 1
        for vehicle in world.vehicles.values():
            self._state.update(world.hydro.state[vehicle.row].tobytes())
        if run.ticks % self._second == 0:
            run.states.append(self._state.hexdigest())
        if not self._states:
            return
        if run.ticks % EVERY == 1:
            self.arrays[f"{run.ticks - 1}/next"] = world.hydro.state.copy()
        if run.ticks % EVERY == 0:
            kept = {
                name: getattr(world.hydro, name)
                for name in ("state", "bodies", "thrusters", "wrenches", "servos", "flows")
            }
            kept |= {f"contact/{name}": column for name, column in world.hydro.touched.contacts._asdict().items()}
            self.arrays |= {f"{run.ticks}/{name}": array.copy() for name, array in kept.items()}

    def end(self) -> Run:
        """No tick more."""
        self.run.ports = {
            path: (digest.hexdigest(), self._counts[path]) for path, digest in sorted(self._ports.items())
        }
        self.arrays |= {path: np.array(rows) for path, rows in self._values.items() if len({*map(len, rows)}) == 1}
        return self.run


def _numbers(values: Sequence[Any]) -> Iterator[float]:
    for value in values:
        if isinstance(value, bool | int | float):
            yield float(value)
        elif isinstance(value, list | tuple):
            yield from _numbers(value)


def told(kind: str, name: str, steps: int, seed: int) -> Story:
    """What happens in a run of a kind."""
    if kind == "untouched":
        return Story(name, steps, {})
    whole = story(name, steps, seed)
    if kind == "told":
        return whole
    acts = {at: tuple(act for act in acts if act.path not in _GOING) for at, acts in whole.acts.items()}
    return Story(name, steps, acts)


def without_errors(given: Resolved) -> Resolved:
    """The same scenario, with instruments that are never wrong."""
    vehicles = {}
    for vehicle, each in given.vehicles.items():
        sensors = {
            name: structs.replace(
                config, modifiers={}, **({"ideal": True} if "ideal" in config.__struct_fields__ else {})
            )
            for name, config in each.vehicle.sensors.items()
        }
        vehicles[vehicle] = replace(each, vehicle=structs.replace(each.vehicle, sensors=sensors))
    return replace(given, vehicles=vehicles)


def _commanded(name: str) -> list[Port]:
    return [port for port in build(resolved(name)).ports.values() if port.direction == "actuator"]


def _post(what: Story, step: int, world: World) -> None:
    for _, act in what.numbered(step):
        try:
            world.submit(act.item(world, "kept"))
        except Refused:
            continue


def one_by_one(what: Story, world: World, keeper: Keeper) -> Run:
    """Tick by tick."""
    for step in range(what.steps):
        _post(what, step, world)
        keeper.take(world.step())
        keeper.stand()
    return keeper.end()


def many_at_a_time(what: Story, world: World) -> Run:
    """Odd numbers of ticks, of which only the samples and the last state can be compared."""
    keeper, sizes, step = Keeper(world, numbers=False, states=False), itertools.cycle(ODD), 0
    while step < what.steps:
        _post(what, step, world)
        n = min(next(sizes), what.next_after(step) - step)
        keeper.take(world.step(n))
        step += n
    return keeper.end()


def kept(name: str, kind: str, seed: int, seconds: float) -> tuple[Run, dict[str, Any]]:
    """One run."""
    given = resolved(name)
    given = without_errors(given) if kind == "exact" else given
    if kind == "untouched":  # Held vehicles would not move at all.
        given = replace(given, scenario=structs.replace(given.scenario, start="free"))
    world = build(given, seed)
    what = told(kind, name, round(seconds * world.rate_hz), seed)
    keeper = Keeper(world, kind == "exact", kind == "driven")
    run = one_by_one(what, world, keeper)
    other_world = build(given, seed)
    other = many_at_a_time(what, other_world)
    differ = [path for path in run.ports.keys() | other.ports.keys() if run.ports.get(path) != other.ports.get(path)]
    if differ:
        run.ways_differ = f"samples of {sorted(differ)[:3]}"
    elif world.hydro.state.tobytes() != other_world.hydro.state.tobytes():
        run.ways_differ = "the states at the end"
    return run, keeper.arrays


def keep(folder: Path, names: Sequence[str], seeds: Sequence[int], seconds: float) -> None:
    """All runs that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    driven = {name for name in names if any(port.kind != "teleport" for port in _commanded(name))}
    for name, kind, seed in itertools.product(names, KINDS, seeds):
        path = folder / f"{name}-{kind}-{seed}.json"
        if path.is_file() or (kind in ("untouched", "exact") and seed != seeds[0]):
            continue
        if name not in driven and kind != "untouched":  # nothing of it can be commanded
            continue
        run, arrays = kept(name, kind, seed, seconds)
        if arrays and seed == seeds[0]:
            np.savez_compressed(path.with_suffix(".npz"), **arrays)
        path.write_bytes(msgspec.json.format(msgspec.json.encode(run), indent=1))
        print(
            f"{path.stem}: {run.ticks} ticks, {len(run.ports)} ports {run.ways_differ or 'equal both ways'}", flush=True
        )


def differences(old: Path, new: Path) -> Iterator[str]:
    """What two folders do not have alike."""
    for path in sorted(old.glob("*.json")):
        other = new / path.name
        if not other.is_file():
            yield f"{path.stem}: not in {new}"
            continue
        before, after = (msgspec.json.decode(each.read_bytes(), type=Run) for each in (path, other))
        if after.ways_differ:
            yield f"{path.stem}: one by one and many at a time differ: {after.ways_differ}"
        seconds = [k for k, (a, b) in enumerate(zip(before.states, after.states, strict=False)) if a != b]
        if seconds:
            yield f"{path.stem}: the states differ from second {seconds[0]} on"
        ports = [p for p in before.ports.keys() | after.ports.keys() if before.ports.get(p) != after.ports.get(p)]
        if ports:
            yield f"{path.stem}: {len(ports)} of {len(before.ports)} ports differ: {', '.join(sorted(ports)[:8])}"


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    commands = parser.add_subparsers(required=True, dest="command")
    keeping = commands.add_parser("keep", help="make the runs that are not there yet")
    keeping.add_argument("folder", type=Path)
    keeping.add_argument("--only", nargs="+", default=list(shipped()), metavar="NAME")
    keeping.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    keeping.add_argument("--seconds", type=float, default=60.0)
    comparing = commands.add_parser("compare", help="say what differs")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    given = parser.parse_args()
    if given.command == "keep":
        keep(given.folder, given.only, given.seeds, given.seconds)
        return 0
    found = list(differences(given.old, given.new))
    print("\n".join(found) or "equal")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
