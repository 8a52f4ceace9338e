"""What a recording's head must be for it to be played, and what does not matter."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest
from playback_rig import pool

from uwserver.recording.format import FORMAT, METADATA, metadata
from uwserver.recording.player.chunks import NotPlayable
from uwserver.recording.player.head import played_head
from uwserver.simulation.clock import Timing


class File:
    """Chunks with this head."""

    path = Path("x.mcap")

    def __init__(self, head: dict[str, str] | None) -> None:
        self.metadata = {} if head is None else {METADATA: head}


def head(**changes: str) -> dict[str, str]:
    return metadata(pool(), 3, Timing()) | changes


def read(record: dict[str, str] | None) -> Any:
    return played_head(File(record))  # type: ignore[arg-type]


def test_another_physics_does_not_matter() -> None:
    found, remarks = read(head(physics="1"))
    assert list(found.resolved.vehicles) == ["rov"]
    assert remarks == ()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (None, "not written by"),
        ({"format": "uwserver-recording-9", "uwserver": "7.1"}, "made by uwserver 7.1 in the format uwserver-recording-9"),
        ({"format": "uwserver-recording-2"}, f"this version plays {FORMAT}: play it with that version"),
        ({"scenario": "{"}, "the head of the recording is damaged"),
        ({"scenario": "[]"}, "the head of the recording is damaged"),
        ({"scenario": '{"name": "x", "scenario": {"schema": 1, "colour": 3}, "vehicles": {}}'}, "does not fit"),
        ({"seed": "many"}, "does not fit"),
        ({"solids": "?"}, "does not fit"),
    ],
)  # fmt: skip
def test_what_cannot_be_played_is_told(changes: dict[str, str] | None, text: str) -> None:
    with pytest.raises(NotPlayable) as fault:
        read(None if changes is None else head(**changes))
    assert text in str(fault.value)


def test_extensions_are_named_and_never_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = head()
    trap = tmp_path / "trap.py"
    trap.write_text("raise SystemExit('it was run')")
    monkeypatch.chdir(tmp_path)
    whole = msgspec.json.decode(record["scenario"])
    whole["scenario"]["extensions"] = ["trap.py", str(trap)]
    whole["scenario"]["faults"] = {"odd": {"kind": "of_an_extension"}}
    sensors = whole["vehicles"]["rov"]["vehicle"]["sensors"]
    sensors["odd"] = {"kind": "of_an_extension", "rate_hz": 3}
    next(iter(sensors.values()))["modifiers"] = {"odd": {"kind": "of_an_extension"}}
    record["scenario"] = msgspec.json.encode(whole).decode()
    found, remarks = read(record)
    assert found.resolved.scenario.extensions == ()
    assert "odd" not in found.resolved.vehicles["rov"].vehicle.sensors
    assert "the extensions trap.py" in remarks[0]
    assert "vehicles.rov.sensors.odd are not drawn" in remarks[0]
