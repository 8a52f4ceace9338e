"""Keys of a vehicle that follows poses from a log or another source, and their checks."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

from uwserver.scenario.files.convert import Node, Report, check_known
from uwserver.scenario.files.errors import KeyPath
from uwserver.scenario.world.checks import check_rate
from uwserver.scenario.world.earth import instant
from uwserver.sensors import ModemTable
from uwserver.table import Name, NonNegative, Positive, Table, Vector3
from uwserver.world.external.pose_source import PREDICT_S
from uwserver.world.external.track import MAX_GAP_S

Part = Annotated[float, Meta(ge=0.0, le=1.0)]
DYNAMIC_TABLES = (
    "mounts", "foils", "ballasts", "moving_masses", "actuators", "sensors", "autopilot", "lamps", "published",
)  # fmt: skip
"""Tables of a vehicle file that an external vehicle does not use. What remains is its looks, its solid shapes, and the parts that turn."""
COLOURS: tuple[Vector3, ...] = (
    (0.05, 0.55, 0.95), (0.95, 0.35, 0.05), (0.15, 0.75, 0.25), (0.85, 0.15, 0.65), (0.95, 0.80, 0.10), (0.45, 0.35, 0.95),
)  # fmt: skip
"""Colours that external vehicles without a `colour` get in turn (linear red, green, blue)."""


class Following(Table, kw_only=True, frozen=True):
    """Keys of a vehicle of ``kind = "external"``: where its poses come from, and how it appears to others.

    Without `log` the poses come as commands to its port ``<name>/pose``, from any adapter.

    Attributes:
        log: recording or log file, relative to this file, from which the poses are read before the run.
        track: topic of the log; in a recording the path of a port with p_NB and q_NB, such as ``rov/truth/pose`` or ``rov/autopilot/state``.
        mapping: TOML file that says how poses are made from the topics of the log; `uwserver log FILE --mapping` prints one to start from.
        start: which moment of the log is time 0 of the scenario: "first" for the first pose of the track, a number of seconds on the log's own
            clock, or an instant in UTC (``2026-01-01T00:00:00Z``).
        offset_s: delay of all poses.
        speed: seconds of the log per second of simulation time.
        outside: where the vehicle is before the first pose, after the last one and in gaps: nowhere ("hide"), or at its last place ("hold").
        max_gap_s: longest gap between two poses over which the pose is interpolated.
        predict_s: how long it moves on at constant velocity after a pose that came as a command.
        solid: whether it can be touched and sensors of others see it. If not, it is a ghost, which viewers draw.
        colour: red, green, blue, 0..1, linear, of a ghost and of its trail.
        compare_with: name of another vehicle; the port ``<name>/difference`` gives the difference to its pose.
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
        """Whether it follows poses, and so has no dynamics."""
        return self.kind == "external"


def check_external(name: str, scenario: Node, report: Report) -> None:
    """Check that the keys of a vehicle's table fit its kind.

    Args:
        name: of the table.
        scenario: the scenario file.
        report: called for errors.
    """
    node = scenario.at("vehicles", name)
    path: KeyPath = ("vehicles", name)
    if node.at("kind").value != "external":
        for key in Following.__struct_fields__:
            if key in node.parts and key != "kind":
                report((*path, key), f'"{key}" is for vehicles of kind = "external"')
        return
    for sensor_name, sensor in node.values("sensors").items():
        if not isinstance(sensor, ModemTable):
            report(
                (*path, "sensors", sensor_name),
                "an external vehicle measures nothing: the only sensors that it can carry are modems; remove this one",
            )
    for key in ("autopilot", "velocity_frd_mps", "angular_velocity_frd_degps"):
        if key in node.parts:
            report((*path, key), f'"{key}" is for simulated vehicles: an external one follows poses; remove this key')
    _check_source(node, path, report)
    world, rate = scenario.at("world").value, node.at("rate_hz").value
    if world is not None and rate is not None:
        check_rate(rate, world.rate_hz, (*path, "rate_hz"), report)
    other = node.at("compare_with").value
    if other == name:
        report((*path, "compare_with"), "it cannot be compared with itself: name another vehicle")
    elif other is not None:
        check_known(other, scenario.names("vehicles"), "vehicle", (*path, "compare_with"), report)


def _check_source(node: Node, path: KeyPath, report: Report) -> None:
    logged = "log" in node.parts
    for key in ("track", "mapping", "start", "offset_s", "speed"):
        if key in node.parts and not logged:
            report(
                (*path, key),
                f'"{key}" is for poses from a log: name its file by log = "...", or remove this key if the poses come as commands',
            )
    if logged and "predict_s" in node.parts:
        report(
            (*path, "predict_s"),
            '"predict_s" is for poses that come as commands: in a log the next pose is known; remove this key',
        )
    if logged and node.at("copies").value is not None:
        report((*path, "copies"), "all copies would follow the same log, at the same place: remove copies")
    start = node.at("start").value
    if isinstance(start, str) and start != "first":
        try:
            instant(start)
        except ValueError:
            text = 'start is "first", a number of seconds on the clock of the log, or an instant "2026-01-01T00:00:00Z"'
            report((*path, "start"), f'{text}, not "{start}"')
