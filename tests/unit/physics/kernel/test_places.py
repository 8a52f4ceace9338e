"""Places in the array of a team: each its own, and what different threads write on different cache lines."""

from uwserver.physics.kernel import places


def test_places_are_distinct_and_writers_apart():
    named = {k: getattr(places, k) for k in (
        "JOB", "STOP", "CLAIM", "DONE", "WAITING", "FAILED", "ASLEEP", "CODE", "DATA", "COUNT", "CHUNK", "THREADS", "SPIN",
    )}  # fmt: skip
    assert len(set(named.values())) == len(named)
    assert max(named.values()) < places.SIZE
    lines = {named[k] // 8 for k in ("JOB", "CLAIM", "DONE", "ASLEEP", "CODE")}
    assert len(lines) == 5
