"""Equal runs are equal bit for bit, however they are run: scenarios by ways. What a way is stands in `ways`, what happens in a run in `stories`.

The short table is of every day: three scenarios go all ways, of the others each goes some. In the slow one every scenario goes every way for
10^5 ticks.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from served import served
from stories import CHAPTER, SCENARIOS, Act, Story, story
from traces import Trace, difference
from ways import SILENT, WAYS, in_process, other_process, recorded, recording, replayed

SHORT = CHAPTER
LONG = -(-100_000 // CHAPTER) * CHAPTER
"""Whole chapters: what does not fit into the last one would all happen in its last tick, of which real time carries out some in the next."""
SERVED = ("rov_autopilot", "push_the_crate")
ALL_WAYS = ("rov_autopilot", "push_the_crate", "remus_survey")
SOME_WAYS = {
    "one_of_everything": ("there and back",),  # and free-run, as it is recorded
    "slope": ("real time x20", "after a reset", "free-run"),
    "subsea_template": ("paused", "lock-step, two clients"),
    "pool_inspection": ("real time x5", "lock-step, one client"),
}
RECORDED = ("one_of_everything", "push_the_crate", "rov_autopilot")


@cache
def told(scenario: str, steps: int) -> Story:
    return story(scenario, steps)


@cache
def expected(scenario: str, steps: int) -> Trace:
    return in_process(told(scenario, steps))


@cache
def elsewhere(steps: int, scenarios: tuple[str, ...]) -> dict[str, Trace]:
    return other_process([told(scenario, steps) for scenario in scenarios])


def check(way: str, scenario: str, steps: int) -> None:
    trace = WAYS[way](told(scenario, steps))
    # In real time a picture that is not ready is dropped.
    found = difference(expected(scenario, steps), trace, replies=way not in SILENT, pictures="real time" not in way)
    assert not found, f"{scenario}, {way}: {found}"


def check_recorded(scenario: str, steps: int, path: Path) -> None:
    """The run itself, what the file says of its samples, and its replay."""
    run = recorded(told(scenario, steps), path)
    for name, trace in {"recorded": run, "its file": recording(path, run)}.items():
        found = difference(expected(scenario, steps), trace)
        assert not found, f"{scenario}, {name}: {found}"
    assert replayed(path).ticks == steps


def check_served(scenario: str, steps: int, path: Path) -> None:
    run = recording(path, served(told(scenario, steps), path))
    found = difference(expected(scenario, steps), run, replies=False)
    assert not found, f"{scenario}, served: {found}"
    assert replayed(path).ticks == steps


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_story_is_worth_telling(scenario: str) -> None:
    replies = expected(scenario, SHORT).replies
    done = [reply for reply in replies.values() if isinstance(reply, list) and reply[3] is None]
    assert len(replies) >= SHORT // 6
    assert len(done) > len(replies) / 4
    assert len({state for _, state in expected(scenario, SHORT).states.values()}) == len(
        expected(scenario, SHORT).states
    )


@pytest.mark.parametrize("scenario", ALL_WAYS)
@pytest.mark.parametrize("way", WAYS)
def test_every_way_is_equal(way: str, scenario: str) -> None:
    check(way, scenario, SHORT)


@pytest.mark.parametrize(("scenario", "way"), [(scenario, way) for scenario, ways in SOME_WAYS.items() for way in ways])
def test_some_ways_are_equal(way: str, scenario: str) -> None:
    check(way, scenario, SHORT)


def test_every_way_is_gone_by_every_kind_of_scenario() -> None:
    assert {*ALL_WAYS, *SOME_WAYS} == set(SCENARIOS)
    assert {way for ways in SOME_WAYS.values() for way in ways} == set(WAYS)


@pytest.mark.parametrize("scenario", ALL_WAYS)
def test_another_process_is_equal(scenario: str) -> None:
    assert not difference(expected(scenario, SHORT), elsewhere(SHORT, ALL_WAYS)[scenario])


@pytest.mark.parametrize("scenario", RECORDED)
def test_a_recorded_run_its_file_and_its_replay_are_equal(scenario: str, tmp_path: Path) -> None:
    check_recorded(scenario, SHORT, tmp_path / "run.mcap")


@pytest.mark.parametrize("scenario", SERVED)
def test_a_server_with_a_recorder_and_eight_subscribers_is_equal(scenario: str, tmp_path: Path) -> None:
    check_served(scenario, SHORT, tmp_path / "run.mcap")


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("way", WAYS)
def test_every_long_way_is_equal(way: str, scenario: str) -> None:
    check(way, scenario, LONG)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_another_process_is_equal_for_long(scenario: str) -> None:
    assert not difference(expected(scenario, LONG), elsewhere(LONG, (scenario,))[scenario])


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_long_recorded_run_its_file_and_its_replay_are_equal(scenario: str, tmp_path: Path) -> None:
    check_recorded(scenario, LONG, tmp_path / "run.mcap")


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_server_is_equal_for_long(scenario: str, tmp_path: Path) -> None:
    check_served(scenario, LONG // 10, tmp_path / "run.mcap")


# The table itself can fail.


def changed(scenario: str, at: int, act: Act) -> Story:
    before = told(scenario, SHORT)
    return replace(before, acts={**before.acts, at: (*before.acts.get(at, ()), act)})


def test_a_change_in_the_last_bits_of_one_command_is_seen() -> None:
    told_so = told("push_the_crate", SHORT)
    at = next(at for at, acts in told_so.acts.items() if acts[0].is_command and "u" in acts[0].given)
    u = [*told_so.acts[at][0].given["u"]]
    u[4] += 1e-15
    other = changed("push_the_crate", at, Act(told_so.acts[at][0].path, {"u": u}, is_command=True))
    acts = {**told_so.acts, at: (*told_so.acts[at], told_so.acts[at][0])}
    twice = replace(told_so, acts=acts)  # the same command twice is the same run
    assert not difference(expected("push_the_crate", SHORT), in_process(twice), replies=False)
    assert "the state is" in difference(expected("push_the_crate", SHORT), in_process(other), replies=False)


def test_a_command_one_tick_late_is_seen() -> None:
    before = told("pool_inspection", SHORT)
    at = next(at for at, acts in before.acts.items() if at + 1 not in before.acts and "u" in acts[0].given)
    late = replace(before, acts={at + 1 if step == at else step: acts for step, acts in before.acts.items()})
    assert "the state is" in difference(expected("pool_inspection", SHORT), in_process(late))


def test_samples_and_replies_are_compared_too() -> None:
    trace, other = Trace(), Trace()
    for n in range(450):
        trace.take_one("rov/depth", n, n, n, True, (1.0,))
        other.take_one("rov/depth", n, n, n, True, (1.0 if n != 300 else 1.0000000000000002,))
    assert "samples 200 to 400" in difference(trace.end(), other.end())
    asked, answered = Trace().end(), Trace().end()
    answered.replies["7.0"] = [7, 0, None, None]
    assert "act 7.0" in difference(asked, answered)
