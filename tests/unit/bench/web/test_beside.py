"""Both pictures are computed beside the world that is measured, and what is lost counts."""

from __future__ import annotations

import socket
from collections import Counter

import msgspec
import pytest
from uwserver_bench.web import beside


@pytest.mark.slow
def test_a_row_for_the_world_and_one_for_each_picture() -> None:
    rows = beside.bench_beside(quick=True, say=lambda line: None)
    assert [row.at_most for row in rows] == [beside.LATENESS_BAR_MS, None, None]
    assert [len(row.values) for row in rows] == [1, 1, 1]
    assert rows[0].values[0] > 0.0
    assert all(0.0 <= row.values[0] <= 1.0 for row in rows[1:])
    assert any(row.values[0] > 0.0 for row in rows[1:])


def test_samples_are_counted_by_port_and_nothing_else() -> None:
    here, there = socket.socketpair()
    sent = [{"id": 0, "result": {}}, *({"method": "sample", "params": {"port": port}} for port in ("a", "b", "a"))]
    for message in sent:
        body = msgspec.msgpack.encode(message)
        here.sendall(len(body).to_bytes(4, "big") + body)
    here.close()
    got: Counter[str] = Counter()
    beside._count(there, got)
    there.close()
    assert got == {"a": 2, "b": 1}
