"""The contract of a part: when it acts, what it hears, and that one which cannot be saved does not exist."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uwserver.ports import Argument, Sample, Service
from uwserver.world.parts.part import Part, RandomStream, Stage, State
from uwserver.world.state.snapshot import restore, take
from uwserver.world.world import World


class Count(State, frozen=True):
    n: int


class Recorder(Part):
    """Writes down when it acts."""

    state_type = Count

    def __init__(
        self, path: str, diary: list[tuple[str, str, int]], stage: Stage = Stage.FORCES, order: int = 0
    ) -> None:
        self.name, self.diary, self.n = path, diary, 0
        self.stage, self.order = stage, order  # type: ignore[misc]  # classes of their own elsewhere
        self.next_tick = 0

    @property
    def path(self) -> str:
        return self.name

    def before(self, tick: int, t_ns: int) -> None:
        self.n += 1
        self.diary.append(("before", self.path, tick))

    def save(self) -> Count:
        return Count(self.n)

    def load(self, state: Any) -> None:
        self.n = state.n


class Listener(Recorder):
    def __init__(self, path: str, diary: list[tuple[str, str, int]], listens_to: tuple[str, ...]) -> None:
        super().__init__(path, diary)
        self.next_tick = None
        self.listens_to = listens_to
        note = Argument("note", "str", "what is told")
        self.services = ((Service(f"{path}/tell", "Write it down.", (note,)), self._told),)

    def _told(self, args: Any) -> str:
        return f"{self.path}: {args['note']}"

    def after(self, tick: int, t_ns: int, samples: list[Sample]) -> None:
        self.diary.append(("after", self.path, tick))

    def on_sample(self, sample: Sample, t_ns: int) -> None:
        self.diary.append(("hear", sample.port, t_ns))

    def leave(self, why: str) -> None:
        self.diary.append(("leave", why, 0))


def test_a_part_without_save_and_load_cannot_be_made() -> None:
    class Forgetful(Part):
        path = "x"

        def save(self) -> State:
            return State()

    with pytest.raises(TypeError, match="load"):
        Forgetful()  # type: ignore[abstract]


def test_two_parts_of_one_path_are_refused(world: World) -> None:
    world.add(Recorder("a", []))
    with pytest.raises(ValueError, match='"a" already'):
        world.add(Recorder("a", []))


def test_parts_act_by_stage_then_order_then_path(world: World) -> None:
    diary: list[tuple[str, str, int]] = []
    for path, stage, order in (
        ("z", Stage.FAULTS, 0), ("b", Stage.FORCES, 0), ("a", Stage.FORCES, 0), ("c", Stage.FORCES, -1), ("y", Stage.WATCHDOGS, 5),
    ):  # fmt: skip
        world.add(Recorder(path, diary, stage, order))
    world.step()
    assert [path for _, path, _ in diary] == ["z", "y", "c", "a", "b"]


def test_faults_come_before_the_requests_of_a_tick_and_forces_after_them(world: World) -> None:
    diary: list[tuple[str, str, int]] = []
    world.add(Recorder("first", diary, Stage.FAULTS))
    world.add(Recorder("last", diary))
    world.offer(Service("world/mark", "Mark."), lambda _: diary.append(("call", "", world.tick)))
    from uwserver.ports import Call

    world.submit(Call("world/mark", {}, "test"))
    world.step()
    assert diary == [("before", "first", 0), ("call", "", 0), ("before", "last", 0)]


def test_a_part_acts_from_its_next_tick_on(world: World) -> None:
    part = Recorder("a", [])
    world.add(part)
    part.next_tick = 3
    world.step(5)
    assert [tick for _, _, tick in part.diary] == [3, 4]
    part.next_tick = None
    world.step(5)
    assert len(part.diary) == 2


def test_what_is_not_implemented_is_not_called(world: World) -> None:
    """Nothing is paid in a tick for stages in which a part takes no part."""
    diary: list[tuple[str, str, int]] = []
    part = Recorder("a", diary)
    part.next_tick = None
    world.add(part)
    world.step(3)
    assert diary == []
    world.add(Listener("b", diary, ()))
    world.step(2)
    assert [what for what, _, _ in diary] == ["after", "after"]


def test_a_part_hears_delivered_samples_of_its_ports_after_all_have_read(world: World) -> None:
    diary: list[tuple[str, str, int]] = []
    world.add(Listener("b", diary, ("rov/depth",)))
    delivered = [sample for sample in world.step(20) if sample.port == "rov/depth"]
    heard = [entry for entry in diary if entry[0] == "hear"]
    assert delivered
    assert [port for _, port, _ in heard] == ["rov/depth"] * len(delivered)
    at = diary.index(heard[0])
    assert diary[at - 1][0] == "after"


def test_its_services_are_those_of_the_world(world: World) -> None:
    world.add(Listener("b", [], ()))
    assert world.call("b/tell", note="x") == "b: x"


def test_the_end_of_a_run_is_told_to_every_part(world: World) -> None:
    diary: list[tuple[str, str, int]] = []
    world.add(Listener("b", diary, ()))
    world.end("enough")
    assert ("leave", "enough", 0) in diary


def test_a_body_that_goes_is_told_to_every_part_while_it_is_still_there(make_world: Any) -> None:
    class Widow(Recorder):
        def forget(self, body: str) -> None:
            self.diary.append(("forget", body, len(world.vehicles)))

    world, diary = make_world(vehicles=2), list[tuple[str, str, int]]()
    world.add(Widow("a", diary))
    world.call("world/remove", name="rov1")
    assert diary == [("forget", "rov1", 2)]
    assert list(world.vehicles) == ["rov"]
    assert not any(path.startswith("rov1/") for path in world.parts)


def test_any_part_is_part_of_a_snapshot(world: World) -> None:
    part = Recorder("a", [])
    world.add(part)
    world.step(7)
    kept = take(world)
    world.step(5)
    assert take(world).parts["a"] == Count(12)
    restore(world, kept)
    assert part.n == 7


def test_a_random_stream_comes_back_at_any_point() -> None:
    rng, other = np.random.default_rng(7), np.random.default_rng(7)
    kept, there = RandomStream(rng), RandomStream(other)
    for k in range(20):
        rng.integers(0, 2**31, k, dtype=np.uint32)  # an odd number leaves half of a 64-bit draw in the buffer
        state = kept.save()
        RandomStream.check(state)
        there.load(state)
        assert there.save() == state
        assert other.bit_generator.state == {
            **rng.bit_generator.state,
            "uinteger": other.bit_generator.state["uinteger"],
        }
        assert other.standard_normal(5).tolist() == rng.standard_normal(5).tolist()


@pytest.mark.parametrize("length", [0, 15, 17, 19, 21])
def test_what_is_no_random_stream_is_refused(length: int) -> None:
    with pytest.raises(ValueError, match="16 or 20 bytes"):
        RandomStream.check(bytes(length))
