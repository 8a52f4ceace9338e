"""Runs a recording again and compares: the same requests at the same ticks must give the same states, bit for bit.

The world may be changed from a given time on. The recorded requests then go to a different world, whose states are not compared any more, and the
run can be recorded as a new one.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from uwserver.physics.collision.engine import missing_engine
from uwserver.ports import Call, Command, Fault, Progress, Reply
from uwserver.ports.crossing import TickOutput
from uwserver.recording.changes import BadChange, Changes, calls_for, changed_record
from uwserver.recording.format import Head, Request, StateHash, Versions, head_of, versions_here
from uwserver.recording.parts import ESTIMATED, SERVED
from uwserver.recording.reading import NotReplayable, Reading
from uwserver.recording.recorder import Recorder
from uwserver.scenario.build.members import physics_rate
from uwserver.scenario.build.world import build
from uwserver.scenario.files.convert import NO_MORE, More
from uwserver.scenario.load.extensions import extension_kinds
from uwserver.simulation.clock import Timing
from uwserver.units import NANOSECONDS
from uwserver.world.state import snapshot
from uwserver.world.state.saving import in_one_piece
from uwserver.world.stepping.step_table import Ticks
from uwserver.world.world import Diverged, World

__all__ = ["Difference", "NotReplayable", "Replayed", "replay"]

UNCHANGED = Changes()


@dataclass(frozen=True)
class Difference:
    """The first difference between a replay and the recording.

    Attributes:
        tick: tick of the recorded entry.
        t_ns: its simulation time.
        index: running number of the entry.
        expected, found: state hashes; if the entry is not a hash, descriptions of the recorded and of the replayed world.
    """

    tick: int
    t_ns: int
    index: int
    expected: str
    found: str


@dataclass(frozen=True)
class Replayed:
    """The result of a replay.

    Attributes:
        ticks: number of ticks that were run.
        requests: number of requests that were carried out.
        hashes: number of state hashes that were equal.
        difference: the first difference; None when all states are equal.
        truncated: the recording has no end (its server was killed, or the disk was full); it was replayed as far as it goes.
        recorded, here: software versions of the recording and of this process.
        changed_ns: simulation time from which the world was changed; None if it never was.
        end_ns: simulation time at the end.
        refused: the number of requests that the world refused from `changed_ns` on, and the reason for the first.
        diverged: why the changed world could not continue; "" if it could.
    """

    ticks: int
    requests: int
    hashes: int
    difference: Difference | None
    truncated: bool
    recorded: Versions
    here: Versions
    changed_ns: int | None = None
    end_ns: int = 0
    refused: tuple[int, str] = (0, "")
    diverged: str = ""

    @property
    def changed_versions(self) -> dict[str, tuple[str, str]]:
        """Return the versions that differ: name -> (recorded, here)."""
        pairs = {
            name: (getattr(self.recorded, name), getattr(self.here, name))
            for name in Versions.__struct_fields__
            if name != "started_utc"
        }
        return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


def replay(
    path: Path,
    extensions: Sequence[Path] = (),
    *,
    changes: Changes = UNCHANGED,
    to_s: float | None = None,
    record: Path | None = None,
) -> Replayed:
    """Replay a recording as fast as possible. It needs only the file of the recording, and no adapter.

    Args:
        path: path of the recording.
        extensions: the Python files of its scenario, which are not in the recording; they are run.
        changes: changes of the world; before their time the run is the recorded one, bit for bit.
        to_s: simulation time at which the replay ends, s; None for the end of the recording.
        record: a file for the new run, which does not exist yet. A replay that fails or differs leaves no file.

    Raises:
        OSError: the file cannot be read, or the new one cannot be written.
        NotReplayable: it is not a recording of ours, is damaged, this version cannot build its scenario, or it ends before the changes begin.
        BadChange: the changes are not possible.
    """
    with ExitStack() as stack:
        reading = stack.enter_context(Reading(path))
        more = kinds_of_extensions(extensions)
        changed = head = _head(path, reading.record, more)
        if changes.settings:
            changed = _head(path, changed_record(reading.record, changes.settings, more), more)
        run = _Run(path, head, changed, changes, to_s)
        if record is not None:
            about = {"replay_of": path.name, "changed_from_s": f"{changes.from_s:g}", "changes": _listed(changes)}
            stack.enter_context(_recorded(record, run, head, about))
        run.begin(reading.state)
        for entry in reading.entries():
            if not run.follow(entry):
                break
        else:
            run.carry_out()
        run.end()
        return run.result(reading.truncated, head.versions)


@contextlib.contextmanager
def _recorded(record: Path, run: _Run, head: Head, about: Mapping[str, str]) -> Iterator[None]:
    """Record a run into a new file, which is deleted if the run fails or differs."""
    recorder = Recorder(record, run.world, run.head.resolved)
    is_whole = has_begun = False
    try:
        with recorder.stepped(msgspec.convert(head.timing, Timing), about):
            run.recorder, has_begun = recorder, True
            yield
        is_whole = run.difference is None
    except OSError as error:
        if error.strerror is None:  # the recorder made this error, and its text says everything
            raise
        raise OSError(f"cannot record to {record}: {error.strerror}") from error
    finally:
        if has_begun and not is_whole:
            record.unlink(missing_ok=True)


def _listed(changes: Changes) -> str:
    calls = [f"{one.service}={dict(one.args)}" for one in changes.calls]
    return "; ".join([*(f"{each}={each.value}" for each in changes.settings), *calls])


def _head(path: Path, record: Mapping[str, str], more: More) -> Head:
    if SERVED in record:
        text = "`uwserver record` recorded it from outside, without the scenario and the commands"
        raise NotReplayable(f"{path}: {text}; use `uwserver run --record`, which records them")
    if ESTIMATED in record:
        raise NotReplayable(f"{path}: an estimator made it from {record[ESTIMATED]}: replay that recording")
    try:
        return head_of(record, more)
    except ValueError as error:
        raise NotReplayable(f"{path}: {error}") from error


def kinds_of_extensions(extensions: Sequence[Path]) -> More:
    """Return the kinds of a recording's extensions, whose files are run. Raises NotReplayable."""
    problems: list[str] = []
    names = [str(path) for path in extensions]
    more = extension_kinds(
        names, Path.cwd(), lambda _, text: problems.append(text), lambda problem: problems.append(str(problem))
    )
    if problems:
        raise NotReplayable("\n".join(problems))
    return more if extensions else NO_MORE


def _built(head: Head, is_changed: bool) -> World:
    try:
        return build(head.resolved, head.seed)
    except ValueError as error:
        if not is_changed:
            raise
        raise BadChange(f"the changed world cannot be built: {error}") from error


class _Run:
    """A world that repeats the entries of a recording.

    Attributes:
        head: the head from which the world was built.
        world: the world.
        recorder: records the new run; None if it is not recorded.
        difference: the first difference from the recording before any change.
    """

    def __init__(self, path: Path, recorded: Head, changed: Head, changes: Changes, to_s: float | None) -> None:
        head = recorded if changes.from_s > 0.0 else changed
        self._path, self.head, self._changes, self._changed_head = path, head, changes, changed
        # Another engine's contacts may differ in their last bits.
        missing = missing_engine(head.resolved.scenario.world.engine, instead=False) if head.resolved.is_solid else None
        if missing is not None:
            raise NotReplayable(f"{path}: its contacts cannot be computed here: {missing}")
        self.world: World = _built(head, is_changed=head is changed and bool(changes))
        self.world.subscribe(())
        rate = physics_rate(recorded.resolved.scenario.world.rate_hz)
        self._recorded_ticks, self._has_other_ticks = Ticks(rate), rate != self.world.rate_hz
        self.recorder: Recorder | None = None
        self._batches = 0
        self._batch: list[Request] = []
        self._next_index: int | None = 0
        self._from = self.world.ticks.at(changes.from_s)
        self._last = None if to_s is None else self.world.ticks.at(to_s)
        self._has_pending_changes = bool(changes)
        self._has_reached_last = False
        self.changed_ns: int | None = None
        self._refused, self._first_refusal, self._diverged = 0, "", ""
        self.ticks = self.requests = self.hashes = 0
        self.difference: Difference | None = None

    def begin(self, state: bytes) -> None:
        """Go to the begin of the recording. `state` is the state with which it begins, b"" for the start of the scenario."""
        if self.recorder is not None:
            self.world.subscribe(None)
        if state:
            if self._changes.settings and self._from == 0:
                raise BadChange(f"{self._path}: it begins during a run: give a --from after its begin")
            self._next_index = None
            fault = self._call(Call("world/load", in_one_piece(state), "begin"))
            if fault is not None:
                raise NotReplayable(f"{self._path}: the state it begins with cannot be loaded: {fault.text}")
        if self._has_pending_changes and self._from == 0:
            self._change()

    def follow(self, entry: Request | StateHash) -> bool:
        """Advance to the tick of an entry, and carry it out or compare it; return False when nothing is left to do."""
        if self._next_index is None:
            self._next_index = entry.index
        if self._has_other_ticks:
            at = self.world.ticks.first_at(self._recorded_ticks.time_of(entry.tick))
            entry = msgspec.structs.replace(entry, tick=at)
        if entry.index != self._next_index:
            text = f"{self._path}: entry {self._next_index} is missing before tick {entry.tick}: the file was changed after its recording"
            raise NotReplayable(text)
        self._next_index += 1
        if self._batch and not (isinstance(entry, Request) and entry.batch == self._batch[0].batch):
            self.carry_out()
        # A hash is taken at the end of its tick, a request is carried out at the start.
        if self._has_pending_changes and entry.tick - isinstance(entry, StateHash) >= self._from:
            if not self._advance(self._from, entry):
                return False
            self._change()
        if self._last is not None and entry.tick > self._last:
            self._advance(self._last, entry)
            self._has_reached_last = True
            return False
        if not self._advance(entry.tick, entry):
            return False
        if isinstance(entry, Request):
            self._batch.append(entry)
        elif self.changed_ns is None:
            found = snapshot.take(self.world).hash()
            if found != entry.hash:
                self._differs(entry, entry.hash, found)
                return False
            self.hashes += 1
        return True

    def end(self) -> None:
        """End the run after all entries. Raises NotReplayable if the time of the changes was not reached."""
        if self._has_pending_changes and self.difference is None:
            end = self.world.t_ns / NANOSECONDS
            raise NotReplayable(f"{self._path}: it ends at {end:g} s, before --from {self._changes.from_s:g}")

    def carry_out(self) -> None:
        """Carry out the collected batch, without a tick, because the recorded world may have been paused. If it was not, its tick follows."""
        for request in self._batch:
            if request.service and request.service not in self.world.services and self.changed_ns is None:
                text = f'{self._path}: tick {request.tick} calls "{request.service}", which this version of uwserver does not have'
                raise NotReplayable(text)
        self._write_requests([request.item for request in self._batch])
        for request in self._batch:
            self.world.submit(request.item, self._count_refusal if self.changed_ns is not None else None)
        self._flush()
        self.requests += len(self._batch)
        self._batch = []

    def _count_refusal(self, answer: Reply | Progress) -> None:
        if isinstance(answer, Reply) and answer.fault is not None:
            self._refused += 1
            self._first_refusal = self._first_refusal or f"{self.world.t_ns / NANOSECONDS:g} s: {answer.fault.text}"

    def _change(self) -> None:
        """Make the changes with calls, so that a recording contains them. A change from the start was made when the world was built."""
        self._has_pending_changes = False
        self.changed_ns = self.world.t_ns
        changes = self._changes
        if self._from == 0:
            changes = Changes(calls=changes.calls)
        for call in calls_for(changes, self._changed_head.resolved.scenario, self.world):
            fault = self._call(call)
            if fault is not None:
                raise BadChange(f"{call.service} at {self.world.t_ns / NANOSECONDS:g} s: {fault.text}")

    def _call(self, call: Call) -> Fault | None:
        """Call a service; return the fault if it is refused."""
        self._write_requests([call])
        answers: list[Any] = []
        self.world.submit(call, answers.append)
        self._flush()
        return next((answer.fault for answer in answers if isinstance(answer, Reply)), None)

    def _flush(self) -> None:
        output = self.world.flush()
        for on_reply, answer in output.replies:
            on_reply(answer)
        self._write(output)

    def _write_requests(self, items: Sequence[Command | Call]) -> None:
        if self.recorder is not None:
            for item in items:
                self.recorder.requested(item, self.world.tick, self._batches)
            self._batches += 1

    def _write(self, output: TickOutput, is_tick: bool = False) -> None:
        recorder = self.recorder
        if recorder is not None:
            if is_tick:
                recorder.ticked(self.world)
            for event in output.events:
                recorder.put_event(event)
            recorder.put_samples(output.samples)
            recorder.drain()

    def _advance(self, tick: int, entry: Request | StateHash) -> bool:
        """Step to a tick, that of the entry or an earlier one.

        Returns:
            False when the world cannot get there, because it differs from the recording, or because the changed world diverged.
        """
        world = self.world
        # A recording has at least one entry per simulated second.
        if tick - world.tick > 2 * max(1, round(world.rate_hz)):
            text = f"{self._path}: no entry between the ticks {world.tick} and {tick}: the file was changed after its recording"
            raise NotReplayable(text)
        while world.tick < tick:
            self.ticks += 1
            try:
                output = world.advance()
            except Diverged as error:
                self._write(error.output)
                if self.changed_ns is not None:
                    self._diverged = str(error)
                    return False
                # If the next entry is at this tick, the recorded world stopped here too.
                if world.tick != tick:
                    self._differs(entry, f"a world that continues to tick {tick}", str(error))
                    return False
                continue
            for on_reply, answer in output.replies:
                on_reply(answer)
            self._write(output, is_tick=True)
        if world.tick > tick:
            if self.changed_ns is not None:
                self._diverged = (
                    f"the recording continues at tick {tick}: the request that set the time there was refused here"
                )
                return False
            if tick != entry.tick:
                raise NotReplayable(
                    f"{self._path}: the recording begins at {world.t_ns / NANOSECONDS:g} s, which is later"
                )
            self._differs(entry, f"a world at tick {entry.tick}", f"a world at tick {world.tick}")
            return False
        return True

    def _differs(self, entry: Request | StateHash, expected: str, found: str) -> None:
        self.difference = Difference(entry.tick, self.world.ticks.time_of(entry.tick), entry.index, expected, found)

    def result(self, truncated: bool, recorded: Versions) -> Replayed:
        """Return the result."""
        return Replayed(
            self.ticks, self.requests, self.hashes, self.difference, truncated and not self._has_reached_last, recorded, versions_here(),
            self.changed_ns, self.world.t_ns, (self._refused, self._first_refusal), self._diverged,
        )  # fmt: skip
