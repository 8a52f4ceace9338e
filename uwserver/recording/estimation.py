"""The recorded samples of a vehicle's sensors into the estimator of its built-in autopilot alone: with other gains, mounts, or without a sensor.

No world is stepped. The estimator hears each sample when it was delivered, and steps when it did; so without a change it gives what it gave.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import msgspec
from msgspec import Struct

from uwserver.autopilot.bank import Seat
from uwserver.frames import rotate
from uwserver.ports import Call, Event, Field, Port, Refused, Sample
from uwserver.recording.changes import BadChange, Setting, changed_record
from uwserver.recording.channels import Column
from uwserver.recording.differences import Distance, Pairing
from uwserver.recording.format import EVENTS, FORMAT, REQUESTS, Request, head_of, versions_here
from uwserver.recording.opening import new_file
from uwserver.recording.parts import ESTIMATED
from uwserver.recording.reading import NotReplayable, Reading
from uwserver.recording.writer import RecordingWriter
from uwserver.scenario.build.world import build
from uwserver.scenario.files.convert import More
from uwserver.scenario.files.errors import suggestion
from uwserver.units import NANOSECONDS
from uwserver.world import snapshot
from uwserver.world.piloting import Piloting
from uwserver.world.world import World

_FIELDS = (
    Field("p_N", "m", "position of the body origin, estimated", "N", (3,)),
    Field("v_N", "m/s", "velocity over ground, estimated", "N", (3,)),
    Field("q_NB", "1", "attitude, estimated, w x y z", "NB", (4,)),
    Field("depth", "m", "below the surface, estimated; nan when unknown"),
    Field("altitude", "m", "above the bottom, estimated; nan when unknown"),
)
_COMPARED = (
    Column("p_N", "m", "number", 3), Column("v_N", "m/s", "number", 3), Column("q_NB", "1", "number", 4), Column("depth", "m", "number"),
)  # fmt: skip
_SETTLE_EVERY = 256
_LATE_S = 2
"""A recording whose first sample comes later than this begins there."""


class _Told(Struct):
    """A message on the channel of a sensor."""

    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool
    value: dict[str, Any]


@dataclass(frozen=True)
class Estimated:
    """What came of it.

    Attributes:
        port: of the estimate in the new recording.
        samples: heard.
        end_ns: simulation time to which it goes.
        before, after: distance from the truth of the recorded estimate and of the new one, by field; without numbers where no truth was recorded.
        remarks: what was left out, and why.
    """

    port: str
    samples: int
    end_ns: int
    before: Mapping[str, Distance]
    after: Mapping[str, Distance]
    remarks: tuple[str, ...]


def estimate(
    path: Path, vehicle: str, settings: Sequence[Setting] = (), more: More | None = None, record: Path | None = None
) -> Estimated:
    """Let the estimator hear a recording again.

    Args:
        path: of the recording.
        vehicle: with a built-in autopilot.
        settings: keys of the scenario that are other ones, of its autopilot and its sensors.
        more: kinds of its extensions.
        record: file for the old estimate, the new one and the truth; it must not exist.

    Raises:
        OSError: the file cannot be read, or the new one not written.
        NotReplayable: it is no recording of ours, damaged, or of a scenario that this version cannot build.
        BadChange: no such vehicle or key, or a value that cannot be.
    """
    with Reading(path) as reading, contextlib.ExitStack() as stack:
        changed = changed_record(reading.record, settings, more or {}) if settings else reading.record
        try:
            head = head_of(changed, more or {})
        except (ValueError, KeyError) as error:
            raise NotReplayable(f"{path}: {error}") from error
        world = build(head.resolved, head.seed)
        hearing = _Hearing(world, _piloting(world, vehicle), vehicle)
        if reading.state:
            before = head_of(reading.record, more or {})
            hearing.begin(path, build(before.resolved, before.seed), reading.state, vehicle)
        if record is not None:
            listed = "; ".join(f"{each}={each.value}" for each in settings)
            stack.enter_context(_written(record, hearing, {ESTIMATED: path.name, "changes": listed}))
        hearing.run(reading)
        return hearing.result()


def _piloting(world: World, vehicle: str) -> Piloting:
    part = world.parts.get(f"{vehicle}/autopilot")
    if not isinstance(part, Piloting):
        there = [each.pilot.craft.path.split("/")[0] for each in world.parts.values() if isinstance(each, Piloting)]
        raise BadChange(f'"{vehicle}" has no built-in autopilot{suggestion(vehicle, there, "; there are: ")}')
    return part


@contextlib.contextmanager
def _written(record: Path, hearing: _Hearing, about: dict[str, str]) -> Iterator[None]:
    """Let it be written into a new file, which goes again when that fails."""
    file: IO[bytes] = new_file(record)
    is_whole = False
    try:
        with file:
            head = {"format": FORMAT, **msgspec.structs.asdict(versions_here()), **about}
            hearing.writer = RecordingWriter(file, head, hearing.told)
            yield
            hearing.writer.finish()
        is_whole = True
    except OSError as error:
        raise OSError(f"cannot record to {record}: {error.strerror or error}") from error
    finally:
        if not is_whole:
            record.unlink(missing_ok=True)


class _Hearing:
    """An autopilot whose estimator hears what was recorded.

    Attributes:
        told: ports of the new recording.
        writer: of it; None where nobody wants it.
    """

    def __init__(self, world: World, part: Piloting, vehicle: str) -> None:
        self._world, self._pilot = world, part.pilot
        self._seat: Seat = part.pilot.seat
        orders = part.pilot.orders
        orders.armed = orders.waits = False
        self._ears = set(self._pilot.craft.hearing.ports)
        self._state, self._pose, self._velocity = (
            f"{vehicle}/autopilot/state",
            f"{vehicle}/truth/pose",
            f"{vehicle}/truth/velocity",
        )
        self._set_position, self._set_gain = f"{vehicle}/autopilot/set_position", f"{vehicle}/autopilot/set_gain"
        self.port = Port(
            f"{vehicle}/estimate/state", "sensor", "estimate", _FIELDS, "What the estimator makes of the recording."
        )
        kept = [each for each in (self._state, self._pose, self._velocity) if each in world.ports]
        self.told: dict[str, Port] = {each: world.ports[each] for each in kept} | {self.port.path: self.port}
        self.writer: RecordingWriter | None = None
        self._decode = msgspec.json.Decoder(_Told).decode
        self._tick, self._now_ns = -1, -1
        self._shown: tuple[Any, ...] = ()
        self._attitude: tuple[int, tuple[float, ...]] | None = None
        self._before, self._after = Pairing(_COMPARED, False, 1), Pairing(_COMPARED, False, 1)
        self._samples = self._seq = 0
        self._remarks: list[str] = []
        self._asked: deque[Request] = deque()
        self._truth: dict[int, dict[str, Any]] = {}

    def begin(self, path: Path, world: World, state: bytes, vehicle: str) -> None:
        """Believe what was believed where the recording begins, in the midst of a run: `state` of `world`, which is as it was recorded."""
        seat = _piloting(world, vehicle).pilot.seat
        has_other_gains = self._seat.orders.gains != seat.orders.gains
        try:
            snapshot.from_bytes(world, state)
        except Refused as refused:
            raise NotReplayable(f"{path}: the state it begins with cannot be loaded: {refused}") from refused
        self._seat.row["e"] = seat.row["e"]
        if not has_other_gains:  # some may have been set before
            self._seat.orders.gains = seat.orders.gains
        self._world.tick = self._tick = world.tick

    def run(self, reading: Reading) -> None:
        """Hear all of it, up to a reset: what the estimator was then is not in a recording."""
        wanted = dict.fromkeys((*self._ears, *self.told, REQUESTS, EVENTS))
        requests, events = msgspec.json.Decoder(Request), msgspec.json.Decoder(Event)
        for count, (topic, message) in enumerate(reading.messages(wanted)):
            try:
                if topic == REQUESTS:
                    request = requests.decode(message.data)
                    if request.service in (self._set_position, self._set_gain):
                        self._asked.append(request)
                elif topic == EVENTS:
                    if events.decode(message.data).event == "reset" and self._samples:
                        self._remarks.append(f"heard to {self._now_ns / NANOSECONDS:g} s, where a reset sets the time")
                        break
                else:
                    self._take(topic, self._decode(message.data))
            except (msgspec.MsgspecError, KeyError) as error:
                raise NotReplayable(f"{topic} at {message.log_time} ns cannot be read: {error}") from error
            if count % _SETTLE_EVERY == 0:
                self._settle(self._now_ns)
        self._settle(float("inf"))
        if reading.truncated:
            self._remarks.append("the recording has no end: heard as far as it goes")

    def _settle(self, reached: float) -> None:
        for pairing in (self._before, self._after):
            pairing.settle((reached, reached))

    def _ask(self, tick: int) -> None:
        """What the operator told the estimator in ticks before this one; samples of the same tick may stand behind it in the file."""
        while self._asked and self._asked[0].tick < tick:
            request = self._asked.popleft()
            self._world.tick = request.tick
            self._step_before(self._world.t_ns)
            call = request.item
            assert isinstance(call, Call)
            with contextlib.suppress(Refused):  # it was refused then, too
                given = {name: value for name, value in call.args.items() if value is not None}
                self._world.call(call.service, **given)

    def _take(self, topic: str, told: _Told) -> None:
        # With a delay a sample is sent between two ticks, and heard in the second.
        tick = self._world.ticks.first_at(told.t_sent_ns)
        if tick > self._world.tick or not self._shown:
            self._ask(tick)
            self._world.tick = tick
            self._now_ns = self._world.t_ns
            self._step_before(self._now_ns)
            # What it believes is measured before the samples of the tick are heard.
            self._shown = self._believed()
        if topic in self._ears:
            self._samples += 1
            if told.valid:
                self._seat.hear(topic, self._values(topic, told.value), told.t_ns, self._now_ns)
        if topic not in self.told:
            return
        if self.writer is not None:
            values = self._values(topic, told.value)
            self.writer.sample(Sample(topic, told.seq, told.t_ns, told.t_sent_ns, told.valid, values), self.told)
        if topic == self._state:
            self._compare(told)
        elif topic == self._pose:
            self._attitude = told.t_ns, tuple(told.value["q_NB"])
            self._keep(told.t_ns, p_N=told.value["p_NB"], q_NB=told.value["q_NB"], depth=told.value["p_NB"][2])
        elif topic == self._velocity and self._attitude is not None and self._attitude[0] == told.t_ns:
            self._keep(told.t_ns, v_N=list(rotate(self._attitude[1], told.value["v_NB_B"])))

    def _values(self, topic: str, value: Mapping[str, Any]) -> tuple[Any, ...]:
        given = (value[field.name] for field in self._world.ports[topic].fields)
        return tuple(tuple(each) if isinstance(each, list) else each for each in given)

    def _step_before(self, t_ns: int) -> None:
        """Step at all ticks before a time."""
        end = self._world.ticks.first_at(t_ns)
        if self._tick < 0:
            # A run may begin at a saved state: what was before is not in the recording.
            self._tick = end - 1 if end > _LATE_S * self._world.rate_hz else 0
        for tick in range(self._tick, end):
            now_ns = self._world.ticks.time_of(tick)
            self._seat.bank.step(self._world.hydro.table, tick, now_ns)
        self._tick = max(self._tick, end)

    def _believed(self) -> tuple[Any, ...]:
        x, _ = self._seat.show(self._now_ns)
        return tuple(x[0:3]), tuple(x[3:6]), tuple(x[6:10]), x[13], x[14]

    def _compare(self, told: _Told) -> None:
        """The recorded estimate and the new one of the same time, with what was true."""
        values = tuple(each if isinstance(each, tuple) or each == each else None for each in self._shown)
        if self.writer is not None:
            sample = Sample(self.port.path, self._seq, told.t_ns, told.t_sent_ns, True, values)
            self.writer.sample(sample, self.told)
            self._seq += 1
        now = dict(zip([field.name for field in _FIELDS], values, strict=True))
        self._before.put(1, (told.t_ns, True, told.value))
        self._after.put(1, (told.t_ns, True, now))

    def _keep(self, t_ns: int, **values: Any) -> None:
        """What was true; pose and velocity of one time come one after the other."""
        true = self._truth.setdefault(t_ns, {})
        true |= values
        if "v_N" in true or self._velocity not in self.told:
            del self._truth[t_ns]
            self._before.put(0, (t_ns, True, true))
            self._after.put(0, (t_ns, True, true))
        if len(self._truth) > 16:
            del self._truth[next(iter(self._truth))]

    def result(self) -> Estimated:
        """What came of it."""
        if not self._after.pairs[0] + self._after.pairs[1]:
            self._remarks.append(
                "no truth was recorded beside it ([vehicles.NAME.truth]): there is nothing to measure it by"
            )
        if not self._seq and self._after.samples[1] == 0:
            self._remarks.append(f"no sample of {self._state} was recorded: there is nothing to show the estimate at")
        return Estimated(
            self.port.path, self._samples, max(0, self._now_ns), self._before.fields, self._after.fields, tuple(self._remarks)
        )  # fmt: skip
