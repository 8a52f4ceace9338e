"""What is measured is what the report says: silent modems, and packets that everybody hears."""

from __future__ import annotations

from uwserver_bench import cli, modems


def test_a_row_for_silence_and_one_for_a_packet(monkeypatch) -> None:
    monkeypatch.setattr(modems, "VEHICLES", 3)
    rows = modems.bench_modems(quick=True, say=lambda line: None)
    assert [row.at_most for row in rows] == [5.0, 1000.0]
    assert all(len(row.values) == 2 for row in rows)
    assert min(rows[1].values) > 0.0
    assert "modems" in cli._MODULES["sensors"]


def test_everybody_hears_the_packet(monkeypatch) -> None:
    monkeypatch.setattr(modems, "VEHICLES", 3)
    world = modems.fleet()
    modems._packet_us(world, 2, 0.0)
    heard = [world.call(f"v{k}/modem/received/get")["counts"]["heard"] for k in range(3)]
    assert heard == [1, 1, 2]
    assert not [path for path in modems.fleet(with_modems=False).sensors if "modem" in path]
