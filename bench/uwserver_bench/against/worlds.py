"""Worlds in a process of each version: loading, ticks and snapshots, in processor time of the only thread."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uwserver_bench.against import scenarios
from uwserver_bench.against.installation import Installation
from uwserver_bench.against.pairs import SIDES, Kind, Pairs, Say, Unable, in_turns
from uwserver_bench.processes import BenchFailed, running
from uwserver_bench.server import IMPORT_BAR_S, import_s

PATIENCE_S = 900.0
"""Long, because the first task of a version may compile its kernels."""
Calls = Sequence[tuple[str, Mapping[str, object]]]
"""Services of a world, with their arguments."""
EVERY = 24
"""Ticks between commands: ten per second."""
SLICE_S, QUICK_SLICE_S = 0.1, 0.003
"""Approximate processor time of one turn, s."""
_CRATES = 4


class Probe:
    """A process of one version that runs worlds (`uwserver_bench.against.probe`)."""

    def __init__(self, process: subprocess.Popen[bytes], side: str) -> None:
        self._process = process
        self._side = side
        self.built: set[str] = set()

    def ask(self, do: str, **task: object) -> float:
        """Carry out a task, and return its processor time, s.

        Raises:
            Unable: the version refused it.
            BenchFailed: the process ended, or did not answer in time.
        """
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps({"do": do, **task}).encode() + b"\n")
        process.stdin.flush()
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            if not selector.select(PATIENCE_S):
                raise BenchFailed(f"{self._side}: no answer to {do} within {PATIENCE_S:g} s")
        line = process.stdout.readline()
        if not line:
            raise BenchFailed(f"{self._side}: the process of its worlds ended: see its message above")
        answer: dict[str, Any] = json.loads(line)
        if "failed" in answer:
            raise Unable(answer["failed"])
        return float(answer["ns"]) * 1e-9


@contextlib.contextmanager
def probing(version: Installation, place: Path) -> Iterator[Probe]:
    """Run a probe of a version while the context is open."""
    command = [version.python, str(Path(__file__).with_name("probe.py"))]
    pipe = subprocess.PIPE
    with running(command, stdin=pipe, stdout=pipe, cwd=place, env=dict(version.environment)) as process:
        yield Probe(process, version.side)


@dataclass(frozen=True)
class Ticks:
    """A world whose ticks are measured.

    Attributes:
        vehicles: vehicles that get thruster commands; none if autopilots steer.
        calls: calls of services, after loading.
        reset: whether it begins at the start in each turn, so that no vehicle goes far.
    """

    name: str
    kind: Kind
    vehicles: Sequence[str] = ()
    calls: Calls = ()
    reset: bool = True


def _tick(name: str) -> Kind:
    return Kind("ticks", name, "us")


def _armed(count: int) -> list[tuple[str, Mapping[str, object]]]:
    names = [f"{name}/autopilot" for name in scenarios.vehicles(count)]
    modes = [(f"{name}/set_mode", {"mode": "depth_hold"}) for name in names]
    return [*((f"{name}/arm", {"force": True}) for name in names), *modes]


TICKS = (
    *(
        Ticks(
            f"open{n}", _tick(f"tick of {n} BlueROV2 Heavy, thrusters, no sensor"), scenarios.vehicles(n)
        )
        for n in (1, 20, 100)
    ),
    *(
        Ticks(
            f"navigation{n}", _tick(f"tick of {n} with navigation sensors and autopilots"), (), _armed(n), reset=False
        )
        for n in (1, 20)
    ),
    Ticks("contact", _tick(f"tick of {_CRATES} on the bottom that push crates"), scenarios.vehicles(_CRATES)),
    Ticks("survey", _tick("tick of 1 with scanning sonar, DVL, altimeter above a seabed"), ("rov",)),
)  # fmt: skip
LOADS = {
    "open1": "load 1 vehicle",
    "navigation20": "load 20 with navigation sensors and autopilots",
    "sensors40": "load 40 with the sensors of their file",
    "survey": "load a seabed of 99 458 triangles and a vehicle",
}
QUICK_LOADS = {"open1"}
CALLS: Mapping[str, tuple[str, Calls]] = {
    "snapshot and its hash, 20 with autopilots": ("navigation20", [("world/snapshot", {})]),
    "restore, 20 with autopilots": ("navigation20", [("world/restore", {})]),
    "state hash, 20 with autopilots": ("navigation20", [("world/state_hash", {})]),
    "reset, 100 vehicles": ("open100", [("world/reset", {})]),
}


def write_files(folder: Path) -> dict[str, Path]:
    """Write all scenarios of the worlds, and return their files by name."""
    texts = {f"open{n}": scenarios.open_water(n) for n in (1, 20, 100)}
    texts |= {f"navigation{n}": scenarios.navigation(n) for n in (1, 20)}
    texts |= {"sensors40": scenarios.with_sensors(40), "contact": scenarios.contact(_CRATES)}
    for name, text in texts.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    return {**{name: folder / f"{name}.toml" for name in texts}, "survey": scenarios.write_survey(folder)}


class Worlds:
    """Measures pairs of worlds.

    Args:
        versions: by side.
        place: an empty working directory, for the scenarios.
        quick: very little work in each turn.
    """

    def __init__(self, versions: Mapping[str, Installation], place: Path, quick: bool) -> None:
        self._versions, self._place, self._quick = versions, place, quick
        self.files = write_files(place)
        self._turns: dict[str, int] = {}
        draws = np.random.Generator(np.random.PCG64(1)).uniform(-0.5, 0.5, (16, 8))
        # Zero on average, so that no vehicle goes far.
        self._commands = np.concatenate([draws, -draws]).tolist()

    def warm_up(self, pairs: Pairs, say: Say) -> None:
        """Let each version compile and cache its kernels, and find out how many ticks fill a turn."""
        for side in reversed(SIDES):
            say(f"{side}: first loads (a version whose kernels are not in the cache compiles them, for minutes)")
            with probing(self._versions[side], self._place) as probe:
                for ticks in TICKS:
                    if not pairs.wanted(ticks.kind):
                        continue
                    with contextlib.suppress(Unable):
                        self._build(probe, ticks)
                        seconds = self._step(probe, ticks, 2) / 2
                        self._turns[ticks.name] = max(1, round((QUICK_SLICE_S if self._quick else SLICE_S) / seconds))

    def measure(self, pair: int, pairs: Pairs) -> None:
        """Measure one pair of every figure, in new processes, because the layout of memory differs from process to process and counts as chance."""
        with contextlib.ExitStack() as stack:
            probes = {
                side: stack.enter_context(probing(self._versions[side], self._place)) for side in in_turns(pair)[:2]
            }
            turns = in_turns(pair)
            for side in turns[:2]:
                # The first load of a process imports modules, which `uwserver check` measures.
                probes[side].ask("load", file=str(self.files["open1"]))
            for ticks in TICKS:
                self._measure_ticks(ticks, turns, probes, pairs)
            for title, (name, calls) in CALLS.items():
                self._measure_calls(Kind("state", title, "ms"), name, calls, turns, probes, pairs)
            for name, title in LOADS.items():
                pairs.measure(
                    Kind("loading", title, "ms"),
                    turns if name in QUICK_LOADS else turns[:2],
                    lambda side, name=name: 1e3 * probes[side].ask("load", file=str(self.files[name])),  # type: ignore[misc]
                )

    def _measure_ticks(self, ticks: Ticks, turns: Sequence[str], probes: Mapping[str, Probe], pairs: Pairs) -> None:
        if not pairs.wanted(ticks.kind):
            return
        count = self._turns.get(ticks.name, 1)

        def cost(side: str) -> float:
            self._build(probes[side], ticks)
            return 1e6 * self._step(probes[side], ticks, count) / (count * EVERY)

        pairs.measure(ticks.kind, turns, cost)

    def _measure_calls(
        self, kind: Kind, name: str, calls: Calls, turns: Sequence[str],
        probes: Mapping[str, Probe], pairs: Pairs,
    ) -> None:  # fmt: skip
        times, ready, ticks = 1 if self._quick else 10, set[str](), next(each for each in TICKS if each.name == name)

        def cost(side: str) -> float:
            self._build(probes[side], ticks)  # if only calls are measured
            if side not in ready:
                # A restore needs a snapshot.
                probes[side].ask("call", name=name, calls=[("world/snapshot", {}), *calls])
                ready.add(side)
            return 1e3 * probes[side].ask("call", name=name, calls=calls, times=times) / times

        pairs.measure(kind, turns, cost)

    def _build(self, probe: Probe, ticks: Ticks) -> None:
        """Load a world, once in each process."""
        if ticks.name in probe.built:
            return
        probe.ask("load", name=ticks.name, file=str(self.files[ticks.name]))
        if ticks.calls:
            self._step(probe, ticks, 1)
            probe.ask("call", name=ticks.name, calls=ticks.calls)
        self._step(probe, ticks, 1)
        probe.built.add(ticks.name)

    def _step(self, probe: Probe, ticks: Ticks, turns: int) -> float:
        ports = [f"{name}/thrusters" for name in ticks.vehicles]
        return probe.ask(
            "step", name=ticks.name, ports=ports, commands=self._commands, every=EVERY, turns=turns, reset=ticks.reset
        )


def measure_fresh(
    versions: Mapping[str, Installation], files: Mapping[str, Path], place: Path, pair: int, pairs: Pairs
) -> None:
    """Measure whole processes: `import uwserver`, and commands."""
    pairs.measure(
        Kind("loading", "`import uwserver`, beyond the bare interpreter", "ms", 1e3 * IMPORT_BAR_S),
        in_turns(pair) * 2,
        lambda side: 1e3 * import_s(versions[side].python, versions[side].environment, place),
    )
    commands = {
        "`uwserver list`": ["list"],
        "`uwserver check`, 40 with sensors": ["check", str(files["sensors40"])],
        "`uwserver run`, up and down, 1 with an autopilot": [
            "run", str(files["navigation1"]), "--mode", "freerun", "--until", "1", "--log-level", "error",
        ],
    }  # fmt: skip
    for name, command in commands.items():
        kind = Kind("loading", name, "ms")
        pairs.measure(
            kind,
            in_turns(pair)[:2],
            lambda side, command=command: 1e3 * _process_s(versions[side], command, place),  # type: ignore[misc]
        )


def _process_s(version: Installation, arguments: Sequence[str], place: Path) -> float:
    """Return the processor time of a command from its creation to its end, s."""
    command = [version.python, "-m", "uwserver", *arguments]
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(
        command, cwd=place, env=dict(version.environment), stdin=quiet, stdout=quiet, stderr=subprocess.PIPE
    )
    assert process.stderr is not None
    with process.stderr:
        told = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise Unable((told.decode(errors="replace").strip() or "no message").splitlines()[-1])
    return usage.ru_utime + usage.ru_stime
