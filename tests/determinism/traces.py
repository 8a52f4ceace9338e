"""What is compared between two ways of running the same story: states, samples and replies."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from uwserver.ports import Buffer, Progress, Reply, Sample
from uwserver.world import World
from uwserver.world.state import snapshot

STATE_EVERY = 100
"""Ticks between two state hashes."""
BLOCK = 200
"""Samples under one digest."""


class Trace:
    """What a run was like.

    Attributes:
        states: by ticks run: tick of the world and state hash.
        samples: digest of each `BLOCK` samples with all before, and which sample was the last.
        rest: the same of all but pictures, of which some are lost in real time.
        replies: by act, without what tells who asked.
    """

    def __init__(self) -> None:
        self.states: dict[str, tuple[int, str]] = {}
        self.samples: list[tuple[str, str]] = []
        self.rest: list[tuple[str, str]] = []
        self.replies: dict[str, Any] = {}
        self.count = 0
        self._digest, self._rest, self._rest_count = hashlib.sha256(), hashlib.sha256(), 0
        self._encode = msgspec.json.Encoder().encode

    def stand(self, step: int, steps: int, world: World) -> None:
        """After a tick of the story: note the state where it is due."""
        if step % STATE_EVERY == 0 or step == steps:
            self.states[str(step)] = (world.tick, snapshot.take(world).hash())

    def take(self, samples: Iterable[Sample]) -> None:
        """What was delivered."""
        for s in samples:
            self.take_one(s.port, s.seq, s.t_ns, s.t_sent_ns, s.valid, s.value)

    def take_one(self, *sample: object) -> None:
        """One sample, as its attributes in their order. As JSON, which tells every float from every other; NaN is null, as in a recording."""
        encoded = self._encode(sample)
        self._digest.update(encoded)
        values = sample[5]
        if not (isinstance(values, tuple) and any(isinstance(value, Buffer | dict) for value in values)):
            self._rest.update(encoded)
            self._rest_count += 1
            if self._rest_count % BLOCK == 0:
                self.rest.append((f"{sample[0]} {sample[1]}", self._rest.hexdigest()))
        self.count += 1
        if self.count % BLOCK == 0:
            self.samples.append((f"{sample[0]} {sample[1]}", self._digest.hexdigest()))

    def replied(self, name: str) -> Callable[[Reply | Progress], None]:
        """Where the reply to an act goes."""

        def reply(answer: Reply | Progress) -> None:
            if isinstance(answer, Reply):
                fault = None if answer.fault is None else [answer.fault.code, answer.fault.text]
                self.replies[name] = [answer.tick, answer.t_ns, msgspec.to_builtins(answer.result), fault]

        return reply

    def refused(self, name: str, text: str) -> None:
        """An act that could not even be posted."""
        self.replies[name] = text

    def end(self) -> Trace:
        """No sample more."""
        self.samples.append((f"the end, after {self.count}", self._digest.hexdigest()))
        self.rest.append((f"the end, after {self._rest_count}", self._rest.hexdigest()))
        return self

    def as_json(self) -> bytes:
        """For another process."""
        return msgspec.json.encode([self.states, self.samples, self.rest, self.replies])

    @classmethod
    def from_json(cls, data: bytes) -> Trace:
        """Of another process."""
        trace = cls()
        states, samples, rest, trace.replies = msgspec.json.decode(data)
        trace.states = {step: tuple(state) for step, state in states.items()}
        trace.samples, trace.rest = [tuple(block) for block in samples], [tuple(block) for block in rest]
        return trace


def difference(expected: Trace, found: Trace, *, replies: bool = True, pictures: bool = True) -> str:
    """Where two runs first differ; "" where they are equal. Without `pictures` of all other samples."""
    here, there = (expected.samples, found.samples) if pictures else (expected.rest, found.rest)
    for step, state in expected.states.items():
        if found.states.get(step) != state:
            return f"after {step} ticks the state is {found.states.get(step)}, not {state}"
    if len(expected.states) != len(found.states):
        return f"{len(found.states)} states instead of {len(expected.states)}"
    for n, block in enumerate(here):
        if n >= len(there) or there[n] != block:
            place = there[n][0] if n < len(there) else "nothing"
            return f"of the samples {n * BLOCK} to {(n + 1) * BLOCK}, the last of them {block[0]}, one is another ({place})"
    if len(here) != len(there):
        return f"{len(there)} blocks of samples instead of {len(here)}"
    if replies:
        for name in sorted(expected.replies.keys() | found.replies.keys()):
            if expected.replies.get(name) != found.replies.get(name):
                return f"the reply to act {name} is {found.replies.get(name)}, not {expected.replies.get(name)}"
    return ""
