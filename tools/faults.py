"""Puts faults into the code one at a time, and sees which tests find them.

The faults stand in `faults.toml` beside this file. It works on a clone below ``--work``, never in the checkout. Each outcome is written at once,
so a later call goes on where one stopped. There are three stages:

    room    the tests of the file's room (`rooms`)
    all     of what survives these: all tests that are not marked slow
    old     of every fault: the tests of another checkout (``--old``) on the same code, to see whether they were any better

A test counts only if it fails twice with the fault, the second time alone, and passes without it. After a change of the tests
``--update --again`` asks first those that have found each fault before.
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Literal

import msgspec
from faulty_tree import ROOT, Fault, Tree, Trial, tree_of, update
from rooms import tests_of

LIST = Path(__file__).with_name("faults.toml")
OUTCOME = Path(__file__).with_name("faults_outcome.json")
PAGE = ROOT / "docs" / "explanation" / "faults.md"

Stage = Literal["room", "all", "old"]


class Entry(msgspec.Struct):
    """All that is known of one fault, by stage; `key` is that of the fault for which it holds."""

    key: str
    trials: dict[str, Trial] = {}

    @property
    def found(self) -> Trial | None:
        """How tests of now find it."""
        return next((self.trials[s] for s in ("room", "all") if s in self.trials and self.trials[s].by), None)


class Outcome(msgspec.Struct):
    """Of all faults, by name; and tests that fail, or pass, without any."""

    faults: dict[str, Entry] = {}
    broken: list[str] = []
    sound: list[str] = []


def faults() -> list[Fault]:
    """The list."""
    return msgspec.toml.decode(LIST.read_bytes(), type=dict[str, list[Fault]])["fault"]


def objections(root: Path = ROOT) -> Iterator[str]:
    """What is wrong with the list: each fault must be one place of one file, and leave something that Python reads."""
    names = [fault.name for fault in faults()]
    yield from (f"{name}: this name is there twice" for name in sorted({n for n in names if names.count(n) > 1}))
    for fault in faults():
        path = root / fault.file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if text.count(fault.old) != 1:
            yield f"{fault.name}: its text stands {text.count(fault.old)} times in {fault.file}"
        elif fault.old == fault.new:
            yield f"{fault.name}: it changes nothing"
        elif path.suffix == ".py":
            try:
                compile(text.replace(fault.old, fault.new), fault.file, "exec", dont_inherit=True)
            except SyntaxError as error:
                yield f"{fault.name}: {error}"


def read_outcome(path: Path) -> Outcome:
    """What is known so far."""
    return msgspec.json.decode(path.read_bytes(), type=Outcome) if path.is_file() else Outcome()


def write_outcome(path: Path, outcome: Outcome) -> None:
    """Whole, or not at all."""
    part = path.with_suffix(".part")
    part.write_bytes(msgspec.json.format(msgspec.json.encode(outcome), indent=1) + b"\n")
    part.replace(path)


# -- stages -------------------------------------------------------------------------------------------------------------------------------


def try_room(fault: Fault, tree: Tree, entry: Entry) -> Trial:
    """By the test that finds it as far as is known, then by its room, the nearest first: pytest would take a file with the folder that holds it."""
    known, room = entry.found, tests_of(fault.file, tree.root)
    there = known is not None and (tree.root / known.by.partition("::")[0]).is_file()
    trial = Trial("survived", commit=tree.commit)
    for tests in ((known.by,) if known is not None and there else (), room[:1], room[1:]):
        if tests and not trial.by:
            trial = tree.tried(fault, tests)
    return trial


def try_all(fault: Fault, tree: Tree, workers: int) -> Trial:
    """By all tests, in two runs, as a worker keeps what it compiles."""
    spread = ("-n", str(workers))
    trial = tree.tried(fault, ["tests/unit"], *spread, warm=True)
    return trial if trial.by else tree.tried(fault, ["tests"], "--ignore=tests/unit", *spread, warm=True)


def try_stage(stage: Stage, fault: Fault, tree: Tree, entry: Entry, workers: int) -> Trial:
    """One fault. Old tests: the one that finds it now, the room, and all where nothing finds it now."""
    if stage == "all":
        return try_all(fault, tree, workers)
    trial = try_room(fault, tree, entry)
    if stage == "old" and not trial.by and entry.found is None:
        return try_all(fault, tree, workers)
    return trial


def is_open(stage: Stage, entry: Entry, commit: str, again: bool) -> bool:
    """Whether a stage is to be done for a fault."""
    trial, room = entry.trials.get(stage), entry.trials.get("room")
    if stage != "room" and (room is None or (stage == "all" and room.by)):
        return False
    return trial is None or (again and trial.commit != commit)


def go_on(stage: Stage, tree: Tree, chosen: Iterable[Fault], outcome: Outcome, given: argparse.Namespace) -> None:
    """Do what is left of a stage; faults in physics last, as all kernels are compiled anew for each."""
    for fault in sorted(chosen, key=lambda fault: fault.file.startswith("uwserver/physics/")):
        entry = outcome.faults.get(fault.name)
        if entry is None or entry.key != fault.key:
            entry = outcome.faults[fault.name] = Entry(fault.key)
        if not is_open(stage, entry, tree.commit, given.again):
            continue
        trial = entry.trials[stage] = try_stage(stage, fault, tree, entry, given.workers)
        write_outcome(given.outcome, outcome)
        doubts = f", doubtful: {' '.join(trial.doubts)}" if trial.doubts else ""
        print(f"{fault.name}: {trial.result} {trial.by} ({trial.seconds} s{doubts})", flush=True)


# -- page ---------------------------------------------------------------------------------------------------------------------------------


def page(listed: Sequence[Fault], outcome: Outcome) -> str:
    """Return the page that shows which tests find which faults."""
    rows, now, before = [], 0, 0
    for fault in listed:
        entry = outcome.faults.get(fault.name, Entry(""))
        found, old = entry.found, entry.trials.get("old")
        now, before = now + (found is not None), before + (old is not None and bool(old.by))
        by = "" if found is None else f"`{found.by.removeprefix('tests/').replace('|', '/')}`"
        told = "not tried" if "room" not in entry.trials else "no" if found is None else "yes"
        then = "not tried" if old is None else "yes" if old.by else "no"
        rows.append(f"| {fault.wrong} | `{fault.file}` | {then} | {told} | {by} |\n")
    text = f"""<!-- Generated by tools/faults.py --page from tools/faults.toml and tools/faults_outcome.json: do not edit. -->
# Faults that the tests find

This page shows how good the tests are at finding faults. {len(listed)} plausible mistakes were put into the code, one at a time
([list](../../tools/faults.toml), [tool](../../tools/faults.py)). Each was run against the tests of its file's room. If these passed, it was run
against everything that `make test` runs. A test counts only if it fails twice with the fault, the second time alone, and passes without it.
"Before" means the older tests, with which `make test` took forty minutes.

Of {len(listed)} faults {now} are found now, and {before} were found before.

| what is wrong | file | found before | found now | by the test |
|---|---|---|---|---|
"""
    return text + "".join(rows)


# -- command line -------------------------------------------------------------------------------------------------------------------------


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, help="folder for clones and compiled kernels")
    parser.add_argument("--python", type=Path, default=Path(sys.executable), help="that runs the tests")
    parser.add_argument("--outcome", type=Path, default=OUTCOME, help="file that is written after each fault")
    parser.add_argument("--stage", choices=("room", "all", "old"), default="room")
    parser.add_argument("--old", type=Path, help="checkout whose tests are asked in the stage old")
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help="this fault; may be given again")
    parser.add_argument("--again", action="store_true", help="also what was tried with tests of another commit")
    parser.add_argument("--update", action="store_true", help="move the clone to the commit of the checkout first")
    parser.add_argument("--workers", type=int, default=2, help="processes for all tests")
    parser.add_argument("--list", action="store_true", help="show the faults and what is known of them")
    parser.add_argument("--check", action="store_true", help="see that each fault fits the checkout")
    parser.add_argument("--page", action="store_true", help=f"write {PAGE.relative_to(ROOT)}")
    return parser


def _stop(number: int, frame: object) -> None:
    raise SystemExit(128 + number)


def _show(chosen: Iterable[Fault], outcome: Outcome) -> None:
    for fault in chosen:
        trials = outcome.faults.get(fault.name, Entry("")).trials
        print(fault.name, fault.file, *(f"{stage}: {t.result} {t.by}" for stage, t in trials.items()), sep="  ")


def main() -> int:
    """Do as the command line says."""
    parser = _parser()
    given = parser.parse_args()
    outcome, listed = read_outcome(given.outcome), faults()
    chosen = [fault for fault in listed if not given.only or fault.name in given.only]
    if unknown := set(given.only) - {fault.name for fault in listed}:
        parser.error(f"no fault {', '.join(sorted(unknown))}")
    if given.check:
        found = list(objections())
        print(*(found or [f"{len(listed)} faults fit"]), sep="\n")
        return 1 if found else 0
    if given.page:
        PAGE.write_text(page(listed, outcome), encoding="utf-8")
    elif given.list:
        _show(chosen, outcome)
    elif given.work is None or (given.stage == "old") != (given.old is not None):
        parser.error("give --work; and --old with the stage old alone")
    else:
        signal.signal(signal.SIGTERM, _stop)
        work = given.work.resolve()
        work.mkdir(parents=True, exist_ok=True)
        old = None if given.old is None else given.old.resolve() / "tests"
        root = work / ("tree" if old is None else "old")
        if given.update and root.is_dir():
            update(root)
        if given.again:  # of other tests
            outcome.broken.clear()
            outcome.sound.clear()
        tree = tree_of(root, given.python.absolute(), work / "kernels", outcome.broken, outcome.sound, old)
        go_on(given.stage, tree, chosen, outcome, given)
    return 0


if __name__ == "__main__":
    sys.exit(main())
