"""The sensors of a world: which measure in a tick, and the samples that are on their way."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from uwserver.ports import Port, Sample, Value
from uwserver.ports.checks import check_values
from uwserver.sensors import Scope
from uwserver.world.components import Count, SensorSlot
from uwserver.world.part import Part, Stage, State


class OnTheirWay(State, frozen=True):
    """Samples that are measured and not delivered yet: time of delivery (ns), order, port, seq, t_ns, valid and values of each."""

    order: Count
    samples: Annotated[
        tuple[tuple[Count, Count, str, Count, Count, bool, tuple[Value, ...]], ...], Meta(max_length=65536)
    ]


class Sensing(Part):
    """A part that stands for all sensors: it runs those that are due, and delivers what is delayed."""

    path = "world/samples"
    state_type = OnTheirWay
    stage: ClassVar[Stage] = Stage.SENSORS

    def __init__(
        self,
        slots: Mapping[str, SensorSlot],
        seconds: Callable[[], float],
        scopes: Callable[[bool], Callable[[SensorSlot], Scope]],
    ) -> None:
        """Of a world that is still being built.

        Args:
            slots: the sensors by path; may change before each `schedule`.
            seconds: time of the world.
            scopes: gives what sees the world as it is now, for one sensor after the other, with accelerations or without.
        """
        self._slots = slots
        self._seconds = seconds
        self._scopes = scopes
        self._due: list[tuple[int, list[SensorSlot]]] = []
        self._listening: list[SensorSlot] = []
        self._pending: list[tuple[int, int, Sample]] = []
        self._order = 0

    def schedule(self) -> None:
        """Sort the active sensors by how often they are due."""
        groups: dict[tuple[bool, int], list[SensorSlot]] = {}
        for slot in self._slots.values():
            if slot.active:
                groups.setdefault((slot.sensor.repeats, slot.divisor), []).append(slot)
        self._listening = [slot for slot in self._slots.values() if slot.active and slot.sensor.listens]
        self._due = [(divisor, slots) for (_, divisor), slots in sorted(groups.items(), key=lambda group: group[0])]

    def keep(self, ports: Mapping[str, Port]) -> None:
        """Samples of other ports are lost on their way."""
        self._pending = [entry for entry in self._pending if entry[2].port in ports]
        heapq.heapify(self._pending)

    def after(self, tick: int, t_ns: int, samples: list[Sample]) -> None:
        """What is delivered in a tick. The order is part of the contract:

        1. the delayed samples whose time has come, oldest first: they are older than anything measured now;
        2. sensors to which something has come meanwhile that they wait for, as the answer of a beacon;
        3. sensors that are due, with their errors, from the new state.
        """
        pending = self._pending
        while pending and pending[0][0] <= t_ns:
            samples.append(heapq.heappop(pending)[2])
        if self._listening:
            now = self._seconds()
            self._measure([slot for slot in self._listening if slot.is_called(now)], t_ns, samples)
        for divisor, slots in self._due:
            if tick % divisor == 0:
                self._measure(slots, t_ns, samples)

    def _measure(self, slots: Sequence[SensorSlot], t_ns: int, samples: list[Sample]) -> None:
        scope_of = self._scopes(any(slot.sensor.needs_rates for slot in slots))
        for slot in slots:
            if slot.fault == "silent":
                continue
            for sample in slot.samples(scope_of(slot)):
                if sample.t_sent_ns <= t_ns:
                    samples.append(sample)
                else:
                    self._order += 1
                    heapq.heappush(self._pending, (sample.t_sent_ns, self._order, sample))

    def save(self) -> OnTheirWay:
        """The samples on their way, in their order."""
        entries = sorted(self._pending)
        return OnTheirWay(self._order, tuple((t, n, s.port, s.seq, s.t_ns, s.valid, s.value) for t, n, s in entries))

    def check(self, state: Any) -> None:
        """Each sample is of a sensor, and fits its fields."""
        ports = dict(self._ports())
        for _, order, path, seq, t_ns, _, values in state.samples:
            if path not in ports or order > state.order or seq < 0 or t_ns < 0:
                raise ValueError(f'a sample on its way from "{path[:80]}" that cannot be')
            check_values(ports[path].fields, values)

    def load(self, state: OnTheirWay) -> None:
        """Put them on their way again."""
        self._order = state.order
        self._pending = [
            (t, n, Sample(path, seq, t_ns, t, valid, values)) for t, n, path, seq, t_ns, valid, values in state.samples
        ]
        heapq.heapify(self._pending)

    def _ports(self) -> Iterable[tuple[str, Port]]:
        return ((stream.port.path, stream.port) for slot in self._slots.values() for stream in slot.streams())
