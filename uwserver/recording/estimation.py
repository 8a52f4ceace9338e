"""Runs the estimator of a built-in autopilot on the recorded samples of its vehicle: with other gains or mounts, or without a sensor.

No world is stepped. The estimator gets each sample when it was delivered, and steps when it did. So without a change it gives the same estimate.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from uwserver.autopilot.arrays import AutopilotRow
from uwserver.autopilot.ports import StateSensor
from uwserver.frames import rotate
from uwserver.ports import Call, Event, Field, Port, Refused, Sample
from uwserver.ports.checks import bind
from uwserver.recording.changes import BadChange, Setting, changed_record
from uwserver.recording.channels import Column, SampleMessage
from uwserver.recording.differences import Distance, Pairing
from uwserver.recording.format import EVENTS, FORMAT, REQUESTS, Request, head_of, versions_here
from uwserver.recording.parts import ESTIMATED, new_file
from uwserver.recording.reading import NotReplayable, Reading
from uwserver.recording.writer import RecordingWriter
from uwserver.scenario.build.world import build
from uwserver.scenario.files.convert import More
from uwserver.scenario.files.errors import suggestion
from uwserver.units import NANOSECONDS
from uwserver.world.state import snapshot
from uwserver.world.stepping.piloting import Piloting
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
_PAIR_EVERY = 256
_LATE_S = 2
"""If the first sample comes later than this, the estimator begins there."""


@dataclass(frozen=True)
class Estimated:
    """The result of an estimation.

    Attributes:
        port: port of the estimate in the new recording.
        samples: number of samples that the estimator got.
        end_ns: simulation time at the end.
        before, after: differences of the recorded and of the new estimate from the truth, by field; without pairs if no truth was recorded.
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
    """Run the estimator on a recording.

    Args:
        path: path of the recording.
        vehicle: a vehicle with a built-in autopilot.
        settings: changed keys of the scenario, of the autopilot and the sensors of the vehicle.
        more: kinds of the extensions of the scenario.
        record: a file that does not exist yet, for the old estimate, the new one and the truth.

    Raises:
        OSError: the file cannot be read, or the new one cannot be written.
        NotReplayable: it is not a recording of ours, is damaged, or this version cannot build its scenario.
        BadChange: there is no such vehicle or key, or a value is not allowed.
    """
    with Reading(path) as reading, contextlib.ExitStack() as stack:
        changed = changed_record(reading.record, settings, more or {}) if settings else reading.record
        try:
            head = head_of(changed, more or {})
        except (ValueError, KeyError) as error:
            raise NotReplayable(f"{path}: {error}") from error
        world = build(head.resolved, head.seed)
        estimation = _Estimation(world, _piloting(world, vehicle), vehicle)
        if reading.state:
            before = head_of(reading.record, more or {})
            estimation.begin(path, build(before.resolved, before.seed), reading.state, vehicle)
        if record is not None:
            listed = "; ".join(f"{each}={each.value}" for each in settings)
            stack.enter_context(_written(record, estimation, {ESTIMATED: path.name, "changes": listed}))
        estimation.run(reading)
        return estimation.result()


def _piloting(world: World, vehicle: str) -> Piloting:
    part = world.parts.get(f"{vehicle}/autopilot")
    if not isinstance(part, Piloting):
        there = [each.pilot.spec.path.split("/")[0] for each in world.parts.values() if isinstance(each, Piloting)]
        raise BadChange(f'"{vehicle}" has no built-in autopilot{suggestion(vehicle, there, "; there are: ")}')
    return part


@contextlib.contextmanager
def _written(record: Path, estimation: _Estimation, about: dict[str, str]) -> Iterator[None]:
    """Write an estimation into a new file, which is deleted if that fails."""
    file = new_file(record)
    try:
        with file:
            head = {"format": FORMAT, **msgspec.structs.asdict(versions_here()), **about}
            estimation.writer = RecordingWriter(file, head, estimation.written)
            yield
            estimation.writer.finish()
    except BaseException as error:
        record.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OSError(f"cannot record to {record}: {error.strerror or error}") from error
        raise


class _Estimation:
    """An autopilot whose estimator gets the recorded samples.

    Attributes:
        written: ports of the new recording.
        writer: writes the new recording; None if there is none.
    """

    def __init__(self, world: World, part: Piloting, vehicle: str) -> None:
        self._world, self._pilot = world, part.pilot
        self._row: AutopilotRow = part.pilot.row
        orders = part.pilot.orders
        orders.armed = orders.waits = False
        self._inputs = set(self._pilot.spec.inputs.ports)
        self._state, self._pose, self._velocity = (
            f"{vehicle}/autopilot/state",
            f"{vehicle}/truth/pose",
            f"{vehicle}/truth/velocity",
        )
        sensor = world.sensors[self._state].sensor
        assert isinstance(sensor, StateSensor)
        self._sensor, self._places = sensor, bind(self._state, sensor.fields, *[field.name for field in _FIELDS])
        self._set_position, self._set_gain = f"{vehicle}/autopilot/set_position", f"{vehicle}/autopilot/set_gain"
        self.port = Port(
            f"{vehicle}/estimate/state", "sensor", "estimate", _FIELDS, "The estimate from the recorded samples."
        )
        kept = [each for each in (self._state, self._pose, self._velocity) if each in world.ports]
        self.written: dict[str, Port] = {each: world.ports[each] for each in kept} | {self.port.path: self.port}
        self.writer: RecordingWriter | None = None
        self._decode = msgspec.json.Decoder(SampleMessage).decode
        self._tick, self._now_ns = -1, -1
        self._estimate: tuple[Any, ...] = ()
        self._attitude: tuple[int, tuple[float, ...]] | None = None
        self._before, self._after = Pairing(_COMPARED, False, 1), Pairing(_COMPARED, False, 1)
        self._samples = self._seq = 0
        self._remarks: list[str] = []
        self._asked: deque[Request] = deque()
        self._truth: dict[int, dict[str, Any]] = {}

    def begin(self, path: Path, world: World, state: bytes, vehicle: str) -> None:
        """Take over the estimate at the begin of a recording that began during a run.

        Args:
            path: path of the recording.
            world: the world as it was recorded.
            state: its state at the begin of the recording.
            vehicle: name of the vehicle.
        """
        row = _piloting(world, vehicle).pilot.row
        has_other_gains = self._row.orders.gains != row.orders.gains
        try:
            snapshot.from_bytes(world, state)
        except Refused as refused:
            raise NotReplayable(f"{path}: the state it begins with cannot be loaded: {refused}") from refused
        self._row.record["e"] = row.record["e"]
        if not has_other_gains:  # gains may have been set before the recording began
            self._row.orders.gains = row.orders.gains
        self._world.tick = self._tick = world.tick

    def run(self, reading: Reading) -> None:
        """Run on the whole recording, or up to a reset, because the recording does not contain the estimate after it."""
        wanted = dict.fromkeys((*self._inputs, *self.written, REQUESTS, EVENTS))
        requests, events = msgspec.json.Decoder(Request), msgspec.json.Decoder(Event)
        for count, (topic, message) in enumerate(reading.messages(wanted)):
            try:
                if topic == REQUESTS:
                    request = requests.decode(message.data)
                    if request.service in (self._set_position, self._set_gain):
                        self._asked.append(request)
                elif topic == EVENTS:
                    if events.decode(message.data).event == "reset" and self._samples:
                        end = f"{self._now_ns / NANOSECONDS:g} s"
                        self._remarks.append(f"the estimate ends at {end}, where a reset sets the time")
                        break
                else:
                    self._take(topic, self._decode(message.data))
            except (msgspec.MsgspecError, KeyError) as error:
                raise NotReplayable(f"{topic} at {message.log_time} ns cannot be read: {error}") from error
            if count % _PAIR_EVERY == 0:
                self._pair(self._now_ns)
        self._pair(float("inf"))
        if reading.truncated:
            self._remarks.append("the recording has no end: it is used as far as it goes")

    def _pair(self, reached: float) -> None:
        for pairing in (self._before, self._after):
            pairing.pair((reached, reached))

    def _ask(self, tick: int) -> None:
        """Repeat the calls of earlier ticks to the estimator. In the file, samples of the same tick may come after a call."""
        while self._asked and self._asked[0].tick < tick:
            request = self._asked.popleft()
            self._world.tick = request.tick
            self._step_before(self._world.t_ns)
            call = request.item
            assert isinstance(call, Call)
            with contextlib.suppress(Refused):  # then it was refused in the recorded run too
                given = {name: value for name, value in call.args.items() if value is not None}
                self._world.call(call.service, **given)

    def _take(self, topic: str, message: SampleMessage) -> None:
        t_ns, value = message.t_ns, message.value
        # A delayed sample is sent between two ticks, and delivered in the second.
        tick = self._world.ticks.first_at(message.t_sent_ns)
        if tick > self._world.tick or not self._estimate:
            self._ask(tick)
            self._world.tick = tick
            self._now_ns = self._world.t_ns
            self._step_before(self._now_ns)
            # The autopilot's port gives the estimate before it gets the samples of the tick.
            _, state = self._sensor.measure(None)
            self._estimate = tuple(state[place] for place in self._places)
        if topic in self._inputs:
            self._samples += 1
            if message.valid:
                self._row.on_sample(topic, self._values(topic, value), t_ns, self._now_ns)
        if topic not in self.written:
            return
        if self.writer is not None:
            sample = Sample(topic, message.seq, t_ns, message.t_sent_ns, message.valid, self._values(topic, value))
            self.writer.sample(sample, self.written)
        if topic == self._state:
            self._compare(message)
        elif topic == self._pose:
            self._attitude = t_ns, tuple(value["q_NB"])
            self._add_truth(t_ns, p_N=value["p_NB"], q_NB=value["q_NB"], depth=value["p_NB"][2])
        elif topic == self._velocity and self._attitude is not None and self._attitude[0] == t_ns:
            self._add_truth(t_ns, v_N=list(rotate(self._attitude[1], value["v_NB_B"])))

    def _values(self, topic: str, value: Mapping[str, Any]) -> tuple[Any, ...]:
        given = (value[field.name] for field in self._world.ports[topic].fields)
        return tuple(tuple(each) if isinstance(each, list) else each for each in given)

    def _step_before(self, t_ns: int) -> None:
        """Step the estimator at all ticks before a time."""
        end = self._world.ticks.first_at(t_ns)
        if self._tick < 0:
            # A run may begin at a saved state; then the recording contains nothing of the time before.
            self._tick = end - 1 if end > _LATE_S * self._world.rate_hz else 0
        for tick in range(self._tick, end):
            now_ns = self._world.ticks.time_of(tick)
            self._row.arrays.step(self._world.hydro.table, tick, now_ns)
        self._tick = max(self._tick, end)

    def _compare(self, message: SampleMessage) -> None:
        """Add the recorded estimate, and the new one of the same time, to their comparisons with the truth."""
        if self.writer is not None:
            sample = Sample(self.port.path, self._seq, message.t_ns, message.t_sent_ns, True, self._estimate)
            self.writer.sample(sample, self.written)
            self._seq += 1
        estimate = dict(zip([field.name for field in _FIELDS], self._estimate, strict=True))
        self._before.put(1, (message.t_ns, True, message.value))
        self._after.put(1, (message.t_ns, True, estimate))

    def _add_truth(self, t_ns: int, **values: Any) -> None:
        """Add true values. Pose and velocity of one time come one after the other."""
        true = self._truth.setdefault(t_ns, {})
        true |= values
        if "v_N" in true or self._velocity not in self.written:
            del self._truth[t_ns]
            self._before.put(0, (t_ns, True, true))
            self._after.put(0, (t_ns, True, true))
        if len(self._truth) > 16:
            del self._truth[next(iter(self._truth))]

    def result(self) -> Estimated:
        """Return the result."""
        if not any(self._after.pairs):
            self._remarks.append("no truth was recorded ([vehicles.NAME.truth]), so the errors are unknown")
        if not self._after.samples[1]:
            self._remarks.append(
                f"no sample of {self._state} was recorded: there are no times at which to give the estimate"
            )
        return Estimated(
            self.port.path, self._samples, max(0, self._now_ns), self._before.fields, self._after.fields, tuple(self._remarks)
        )  # fmt: skip
