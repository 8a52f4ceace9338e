"""Files as `uwserver record` writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from uwserver.ports import Event, Field, Port, Sample
from uwserver.recording.format import FORMAT, versions_here
from uwserver.recording.parts import SERVED
from uwserver.recording.writer import RecordingWriter

POSE = Port("rov/truth/pose", "sensor", "pose", (
    Field("p_NB", "m", "place", "N", (3,)), Field("q_NB", "1", "attitude", "NB", (4,)),
), "Pose.", 10.0)  # fmt: skip
TOLD = Port("rov/modem", "sensor", "modem", (
    Field("text", "1", "said", type="str"), Field("bits", "1", "how many", type="int"), Field("ok", "1", "so", type="bool"),
), "Modem.", 1.0)  # fmt: skip
LATER = Port("rov/arm", "sensor", "arm", (Field("angle", "rad", "of joints", "", (2,)),), "Arm.", 10.0)
SERVICE = {"path": "rov/grip", "doc": "Grips.", "arguments": [{"name": "on", "type": "bool", "doc": "so"}]}
PAUSE_NS = 100_000_000


def served(
    path: Path, samples: list[Sample], head: dict[str, str] | None = None, more: tuple[Port, Sample] | None = None
) -> Path:
    world = {"scenario": "tank", "rate_hz": 50.0, "epoch_utc": "2026-01-01T00:00:00Z", "seed": 4, "vehicles": ["rov"]}
    ports = {port.path: port for port in (POSE, TOLD)}
    told = {"server": {}, "world": world, "ports": list(ports.values()), "services": [SERVICE]}
    usual = {"format": FORMAT, **msgspec.structs.asdict(versions_here()), SERVED: "127.0.0.1:7600"}
    usual["describe"] = msgspec.json.encode(told).decode()
    with path.open("wb") as file:
        writer = RecordingWriter(file, {**usual, **(head or {})}, ports)
        for sample in samples:
            writer.sample(sample, {**ports, LATER.path: LATER})
        if more is not None:
            writer.sample(more[1], {more[0].path: more[0]})
        writer.event(Event("fault", 2, 2 * PAUSE_NS, "a leak"))
        writer.event(Event("reset", 0, 0, "another run"))
        writer.finish()
    return path


def dive() -> list[Sample]:
    found: list[Sample] = []
    for k in range(1, 21):
        t = k * PAUSE_NS
        value: Any = ((float(k), 0.0, 2.0), (1.0, 0.0, 0.0, 0.0))
        found.append(Sample(POSE.path, k, t, t + 7, k != 5, value))
        found.append(Sample(TOLD.path, k, t, t + 9, True, ("hello", k, True)))
    found.append(Sample(LATER.path, 0, 21 * PAUSE_NS, 21 * PAUSE_NS, True, ((0.1, 0.2),)))
    return found
