"""A vehicle that follows poses from elsewhere: the keys of its table in the scenario, and their checks."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

from uwserver.scenario.files.convert import Node, Report
from uwserver.scenario.files.errors import KeyPath, suggestion
from uwserver.scenario.world.checks import check_rate
from uwserver.scenario.world.epoch import instant
from uwserver.sensors import ModemTable
from uwserver.table import Name, NonNegative, Positive, Table, Vector3
from uwserver.world.external.source import PREDICT_S
from uwserver.world.external.track import MAX_GAP_S

Part = Annotated[float, Meta(ge=0.0, le=1.0)]
ACTIVE_TABLES = (
    "mounts", "foils", "ballasts", "moving_masses", "actuators", "sensors", "autopilot", "lamps", "published",
)  # fmt: skip
"""Tables of a vehicle file that one without dynamics has no use for: of its file remain what it looks like, what is solid of it, and what turns."""
COLOURS: tuple[Vector3, ...] = (
    (0.05, 0.55, 0.95), (0.95, 0.35, 0.05), (0.15, 0.75, 0.25), (0.85, 0.15, 0.65), (0.95, 0.80, 0.10), (0.45, 0.35, 0.95),
)  # fmt: skip
"""Of externals without one of their own, one after the other (linear red, green, blue)."""


class Following(Table, kw_only=True, frozen=True):
    """What a vehicle of ``kind = "external"`` may have beside a model and a name: where its poses come from, and what it is for others.

    Without `log` they come as commands to its port ``<name>/pose``, from any adapter.

    Attributes:
        log: recording or log file from which they are read before the run, relative to this file.
        track: topic of it: of a recording the path of a port with p_NB and q_NB, as ``rov/truth/pose`` or ``rov/autopilot/state``.
        mapping: TOML file that says how poses are made of the log's topics; `uwserver log FILE --mapping` prints one to begin with.
        start: what of the log is at the time 0 of the scenario: "first" for the first pose of the track, a number of seconds on the log's own
            clock, or an instant in UTC (``2026-01-01T00:00:00Z``).
        offset_s: it all happens so much later.
        speed: seconds of the log in one second of simulation time.
        outside: where it is while nobody says so, before, after and in gaps: nowhere ("hide"), or where it was last ("hold").
        max_gap_s: longest gap between two poses that is bridged.
        predict_s: how long it goes on by itself after a pose that came as a command.
        solid: it can be touched, and sensors of others see it; without, it is a ghost that is drawn only.
        colour: red, green, blue, 0..1, linear, of a ghost and of its trail.
        compare_with: another vehicle; the port ``<name>/difference`` tells how far it is from that one.
        rate_hz: of ``<name>/state`` and ``<name>/difference``; divides the physics rate.
    """

    kind: Literal["simulated", "external"] = "simulated"
    log: Name | UnsetType = UNSET
    track: Name | UnsetType = UNSET
    mapping: Name | UnsetType = UNSET
    start: float | str = "first"
    offset_s: float = 0.0
    speed: Positive = 1.0
    outside: Literal["hide", "hold"] = "hide"
    max_gap_s: Positive = MAX_GAP_S
    predict_s: NonNegative = PREDICT_S
    solid: bool = False
    colour: tuple[Part, Part, Part] | UnsetType = UNSET
    compare_with: Name | UnsetType = UNSET
    rate_hz: Positive | UnsetType = UNSET

    @property
    def is_external(self) -> bool:
        """It follows poses, and has no dynamics."""
        return self.kind == "external"


def check_external(name: str, scenario: Node, report: Report) -> None:
    """The keys of a vehicle's table go together.

    Args:
        name: of the table.
        scenario: the file.
        report: takes in faults.
    """
    node = scenario.at("vehicles", name)
    path: KeyPath = ("vehicles", name)
    if node.at("kind").value != "external":
        for key in Following.__struct_fields__:
            if key in node.parts and key != "kind":
                report((*path, key), f'"{key}" is for vehicles of kind = "external"')
        return
    for name, sensor in node.at("sensors").parts.items():
        if sensor.value is not None and not isinstance(sensor.value, ModemTable):
            text = "an external vehicle has no dynamics and measures nothing: of sensors it may carry modems alone"
            report((*path, "sensors", name), text)
    for key in ("autopilot", "velocity_frd_mps", "angular_velocity_frd_degps"):
        if key in node.parts:
            report(
                (*path, key),
                f'"{key}" is for vehicles that are simulated: an external one has no dynamics and measures nothing',
            )
    _check_source(node, path, report)
    world, rate = scenario.at("world").value, node.at("rate_hz").value
    if world is not None and rate is not None:
        check_rate(rate, world.rate_hz, (*path, "rate_hz"), report)
    other, vehicles = node.at("compare_with").value, tuple(scenario.at("vehicles").parts)
    if other == name:
        report((*path, "compare_with"), "it cannot be compared with itself")
    elif other is not None and other not in vehicles:
        report((*path, "compare_with"), f'no vehicle "{other}"{suggestion(other, vehicles, "; there are: ")}')


def _check_source(node: Node, path: KeyPath, report: Report) -> None:
    logged = "log" in node.parts
    for key in ("track", "mapping", "start", "offset_s", "speed"):
        if key in node.parts and not logged:
            report(
                (*path, key),
                f'"{key}" is about a log: name its file by log = "...", or leave this key out for poses that come live',
            )
    if logged and "predict_s" in node.parts:
        report((*path, "predict_s"), '"predict_s" is for poses that come live: in a log the next one is known')
    copies = node.at("copies").value
    if logged and copies is not None:
        report((*path, "copies"), "all copies would follow one log, in one place: leave copies out")
    start = node.at("start").value
    if isinstance(start, str) and start != "first":
        try:
            instant(start)
        except ValueError:
            text = 'start is "first", a number of seconds on the clock of the log, or an instant "2026-01-01T00:00:00Z"'
            report((*path, "start"), f'{text}, not "{start}"')
