"""Writes the log of the scenario `filter_review`: a dive of our BlueROV2 Heavy, of which sensors and navigation filter tell two stories.

The vehicle surveys four lines over the slope of `make_slope.py`, its bow to the north. Its DVL is mounted 1 degree askew and always shows 3 cm/s
too much; a USBL hears a beacon on the bottom once a second. Three tracks come into the file, 5 poses a second, each on a topic with p_NB and q_NB:

* ``rov/truth/pose``: where it was;
* ``rov/autopilot/state``: where the built-in autopilot believed it was, by DVL, AHRS, depth and the beacon;
* ``rov/dead_reckoning/pose``: what DVL, AHRS and depth alone say, summed up here, sample by sample.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

import uwserver
from uwserver.frames import rotate
from uwserver.ports import Sample

ASSETS = Path(__file__).parents[1] / "scenarios" / "uwserver_scenarios" / "assets"
FILE = ASSETS / "filter_review.mcap"
RATE_HZ, LONGEST_S = 5, 400
START = (-15.0, -12.0, 22.0)
SCENARIO = f"""
schema = 1
title = "A dive with a DVL that drifts"
seed = 19

[world]
rate_hz = 240
epoch_utc = "2026-06-01T10:00:00Z"

[environment.current]
velocity_ned_mps = [0.05, 0.1, 0.0]

[seabed]
kind = "grid"
file = "{ASSETS / "slope.npy"}"
spacing_m = [5.0, 5.0]

[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = {list(START)}
truth = {{ rate_hz = {RATE_HZ} }}
autopilot = {{ start_position_ned_m = {list(START)}, state_rate_hz = {RATE_HZ} }}

[vehicles.rov.sensors.ahrs]
kind = "attitude"
profile = "mems_ahrs"
rate_hz = 40

[vehicles.rov.sensors.dvl]
kind = "dvl"
profile = "a50"
rate_hz = 8
misalignment_rpy_deg = [0.0, 0.0, 1.0]
modifiers = {{ drift = {{ kind = "bias", field = "v_S", value = [0.02, 0.025, 0.0] }} }}

[vehicles.rov.sensors.usbl]
kind = "usbl"
rate_hz = 1
position_frd_m = [0.0, 0.0, -0.2]
beacons = {{ station = {{ position_ned_m = [25.0, 0.0, 30.0] }} }}
"""
LINES = [(15.0, -12.0), (15.0, -4.0), (-15.0, -4.0), (-15.0, 4.0), (15.0, 4.0), (15.0, 12.0), (-15.0, 12.0)]
"""North, east of the corners of the survey, m."""


class DeadReckoning:
    """Position from velocities of the DVL, turned by the attitude of the AHRS; depth from the pressure sensor."""

    def __init__(self, start: tuple[float, ...]) -> None:
        self.p, self.q = list(start), (1.0, 0.0, 0.0, 0.0)
        self._last_ns = 0

    def hear(self, sample: Sample, fields: dict[str, Any]) -> None:
        """One delivered sample."""
        if not sample.valid:
            return
        if sample.port == "rov/ahrs":
            self.q = fields["q_NS"]
        elif sample.port == "rov/dvl":
            passed = (sample.t_ns - self._last_ns) / 1e9
            self._last_ns = sample.t_ns
            v = rotate(self.q, fields["v_S"])
            self.p[0] += v[0] * passed
            self.p[1] += v[1] * passed
        elif sample.port == "rov/depth":
            self.p[2] = fields["depth"]


def dive(world: Any, write: Any) -> None:
    """Survey, and hand on what belongs into the log."""
    reckoning = DeadReckoning(START)
    world.step(480)  # sensors must have told of it before anybody steers
    world.call("rov/autopilot/set_mode", mode="position_hold")
    world.call("rov/autopilot/arm", force=True)
    items = [
        {"kind": "waypoint", "position_ned_m": [n, e, START[2]], "speed_mps": 0.8, "heading_deg": 0.0} for n, e in LINES
    ]
    world.call("rov/autopilot/set_mission", items=items)
    world.call("rov/autopilot/start_mission")
    names = {path: [field.name for field in port.fields] for path, port in world.ports.items()}
    while world.t_ns < LONGEST_S * 1e9:
        for sample in world.step(1):
            fields = dict(zip(names[sample.port], sample.value, strict=True))
            reckoning.hear(sample, fields)
            if sample.port == "rov/truth/pose":
                write(sample.port, sample.t_ns, True, {"p_NB": fields["p_NB"], "q_NB": fields["q_NB"]})
                write("rov/dead_reckoning/pose", sample.t_ns, True, {"p_NB": reckoning.p, "q_NB": reckoning.q})
            elif sample.port == "rov/autopilot/state":
                kept = {name: fields[name] for name in ("p_N", "v_N", "q_NB", "depth", "mission_index", "reached")}
                write(sample.port, sample.t_ns, fields["position_valid"], kept)
                if fields["reached"] >= len(LINES):
                    return
    raise SystemExit(f"the survey was not done after {LONGEST_S} s")


def main() -> None:
    """Dive and write."""
    with tempfile.TemporaryDirectory() as folder, FILE.open("wb") as file:
        path = Path(folder) / "dive.toml"
        path.write_text(SCENARIO)
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start("", "tools/make_filter_review.py")
        writer.add_metadata(
            "uwserver", {"scenario": json.dumps({"scenario": {"world": {"epoch_utc": "2026-06-01T10:00:00Z"}}})}
        )
        channels: dict[str, int] = {}

        def write(topic: str, t_ns: int, valid: bool, value: dict[str, Any]) -> None:
            if topic not in channels:
                schema = writer.register_schema(topic, "jsonschema", b'{"type": "object"}')
                channels[topic] = writer.register_channel(topic, "json", schema)
            rounded = {name: _rounded(given) for name, given in value.items()}
            data = json.dumps({"t_ns": t_ns, "valid": valid, "value": rounded}).encode()
            writer.add_message(channels[topic], t_ns, data, t_ns)

        world = uwserver.load(path).core
        dive(world, write)
        writer.finish()
    print(f"{FILE.name}: {world.t_ns / 1e9:.1f} s, {FILE.stat().st_size} bytes")


def _rounded(value: Any) -> Any:
    """To a tenth of a millimetre, which keeps the file small."""
    if isinstance(value, (list, tuple)):
        return [_rounded(part) for part in value]
    return round(value, 7 if abs(value) <= 1.0 else 4) if isinstance(value, float) else value


if __name__ == "__main__":
    main()
