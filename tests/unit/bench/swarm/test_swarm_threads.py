"""The other thread does begin, and servers with one thread and with two are compared in turns."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace
from typing import Any

import pytest
from uwserver_bench.swarm import swarm_threads

from uwserver.physics.kernel.team import why_alone

pytestmark = pytest.mark.skipif(bool(why_alone()), reason=why_alone())


@pytest.mark.parametrize("pause_s", [0.0, swarm_threads._ASLEEP_S])
def test_the_other_thread_begins_after_its_share_was_handed_out(pause_s: float) -> None:
    # On a busy machine it may come too late for some.
    found = [us for _ in range(20) for us in swarm_threads.starts_us(10, pause_s)]
    assert found
    assert min(found) > 0.01, "nothing goes from core to core in less"


def test_what_two_threads_add_to_lateness_is_measured_in_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    texts: list[str] = []
    served = SimpleNamespace()

    def serving(file: Any) -> Any:
        texts.append(file.read_text(encoding="utf-8"))
        return contextlib.nullcontext(served)

    asked: list[dict[str, Any]] = []
    load = SimpleNamespace(do=lambda task, to, **given: asked.append({"task": task, **given}))
    monkeypatch.setattr(swarm_threads, "loading", lambda: contextlib.nullcontext(load))
    monkeypatch.setattr(swarm_threads, "serving", serving)
    monkeypatch.setattr(swarm_threads, "lateness_p99_ms", lambda _: 0.2 if "threads = 1" in texts[-1] else 0.6)
    rows = swarm_threads._lateness(2, 1.0, lambda line: None)
    assert [(row.value, row.verdict) for row in rows] == [(0.2, "info"), (0.6, "info"), (pytest.approx(0.4), "miss")]
    assert ["threads = 2" in text for text in texts] == [False, True, False, True]
    assert all(request["active"] + request["silent"] == 20 for request in asked)
