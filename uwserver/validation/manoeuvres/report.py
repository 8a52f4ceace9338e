"""The manoeuvre report of a vehicle: its numbers, its manoeuvres, and published figures of the real one beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import get_args

from msgspec import UnsetType

from uwserver.scenario.load.resolved import ResolvedVehicle
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.tables import Published, Quantity
from uwserver.scenario.water.tables import Environment
from uwserver.units import deg, rad
from uwserver.validation.energy import feeds
from uwserver.validation.manoeuvres import trials
from uwserver.validation.manoeuvres.figures import BY_THRUST, ON_THE_SPOT, Column, Row, Trial, Value, ahead, turn_told
from uwserver.validation.manoeuvres.helm import Helm
from uwserver.validation.manoeuvres.particulars import Particular, guesses, particulars
from uwserver.validation.manoeuvres.runs import Waters
from uwserver.validation.manoeuvres.turning import RUDDER, turning_circle, zig_zag

NONE_FOUND = "none found"


@dataclass(frozen=True)
class Comparison:
    """One quantity of the vehicle file's `published`, in the unit of its name: what the simulation gives, and what is known."""

    quantity: str
    condition: str
    simulated: Value
    published: tuple[Published, ...] = ()


@dataclass(frozen=True)
class Report:
    """All of one vehicle.

    Attributes:
        floats: whether it is one of the surface.
        guesses, groups: of how many groups of numbers of its hull and devices are guesses, and how many there are.
    """

    name: str
    description: str
    density_kgpm3: float
    floats: bool
    guesses: int
    groups: int
    particulars: tuple[Particular, ...]
    comparisons: tuple[Comparison, ...]
    trials: tuple[Trial, ...]

    def trial(self, key: str) -> Trial:
        """One of them."""
        return next(trial for trial in self.trials if trial.key == key)


def resolve(model: str, environment: Environment) -> ResolvedVehicle:
    """A vehicle by name or file, as a scenario would load it.

    Raises:
        ScenarioError: a fault of its file.
    """
    entry = VehicleEntry(model=model, position_ned_m=(0.0, 0.0, 5.0))
    return load(Scenario(schema=1, environment=environment, vehicles={"vehicle": entry}), adapters={}).vehicles[
        "vehicle"
    ]


def report(model: str, density_kgpm3: float = 1025.0) -> Report:
    """Run all manoeuvres of a vehicle, by name or file, in still water.

    Raises:
        ScenarioError: a fault of its file.
        FloatingPointError: a manoeuvre diverged.
    """
    environment = Environment(density_kgpm3=density_kgpm3)
    resolved = resolve(model, environment)
    body = body_params(resolved.vehicle, resolved.devices, environment)
    helm = Helm(resolved.vehicle, body)
    waters, published = Waters(helm), resolved.vehicle.published
    throttles = {p.throttle for p in published if p.quantity == "ahead_speed_mps"}
    turns = [
        (p.throttle, _rudder(p, helm)) for p in published if p.quantity in ("turning_diameter_m", "turn_rate_degps")
    ]
    done = (
        trials.left_alone(waters),
        trials.straight(waters, sorted({*trials.THROTTLES, *throttles})),
        turning_circle(waters, turns if helm.has("rudder") else ()),
        zig_zag(waters),
        trials.dive(waters),
        trials.glide(waters),
        trials.sway(waters),
        trials.free_decay(waters),
        trials.stop(waters),
        _energy(helm),
    )
    found = tuple(particulars(resolved, body, helm))
    some, groups = guesses(resolved)
    file = resolved.vehicle
    unfinished = Report(file.name, file.description, density_kgpm3, waters.floats, some, groups, found, (), done)
    return replace(unfinished, comparisons=tuple(_comparisons(unfinished, helm, published)))


def _rudder(figure: Published, helm: Helm) -> float:
    return min(RUDDER, helm.rudder) if isinstance(figure.rudder_deg, UnsetType) else rad(figure.rudder_deg)


def _energy(helm: Helm) -> Trial:
    """`validation.energy` as a trial."""
    columns = (Column("rate", "power of the water over the energy, at its largest", "1/s"),)
    rows = tuple(Row(f"energy of {feed.speed:g} m/s", (feed.rate,)) for feed in feeds(helm.body))
    text = (
        "Without thrust, whatever the motion, the water must take energy (a negative power); worst velocity of all with the kinetic energy\n"
        "of that speed ahead, also astern, sideways and turning. At 50 m/s only terms of second degree are left."
    )
    return Trial("energy", "Energy", text, columns, rows)


def _comparisons(report: Report, helm: Helm, published: Sequence[Published]) -> list[Comparison]:
    """Each quantity that the vehicle has, at each condition for which a figure is published."""
    found = []
    for quantity in get_args(Quantity):
        figures = [figure for figure in published if figure.quantity == quantity]
        conditions = {_condition(quantity, 1.0, min(RUDDER, helm.rudder), helm): ()} | {
            _condition(quantity, figure.throttle, _rudder(figure, helm), helm): () for figure in figures
        }
        for condition in conditions:
            at = tuple(f for f in figures if _condition(quantity, f.throttle, _rudder(f, helm), helm) == condition)
            simulated = _simulated(report, quantity, condition)
            if simulated is not None or at:
                found.append(Comparison(quantity, condition, simulated, at))
    return found


def _condition(quantity: str, throttle: float, rudder: float, helm: Helm) -> str:
    """The run that a figure belongs to, as `trials` names it."""
    if quantity == "ahead_speed_mps":
        return ahead(throttle)
    if quantity in ("turning_diameter_m", "turn_rate_degps"):
        return turn_told(throttle, rudder) if helm.has("rudder") else BY_THRUST
    return {
        "astern_speed_mps": "astern 100 %",
        "sway_speed_mps": "to starboard 100 %",
        "descent_mps": "down 100 %",
        "ascent_mps": "up 100 %",
        "spot_turn_rate_degps": ON_THE_SPOT,
        "roll_period_s": "roll",
        "pitch_period_s": "pitch",
        "glide_speed_mps": "down",
        "glide_angle_deg": "down",
    }.get(quantity, "")


_WHERE = {
    "ahead_speed_mps": ("straight", "steady"),
    "astern_speed_mps": ("straight", "steady"),
    "sway_speed_mps": ("sway", "speed"),
    "descent_mps": ("dive", "sink"),
    "ascent_mps": ("dive", "sink"),
    "turning_diameter_m": ("turn", "diameter"),
    "turn_rate_degps": ("turn", "rate"),
    "spot_turn_rate_degps": ("turn", "rate"),
    "roll_period_s": ("decay", "period"),
    "pitch_period_s": ("decay", "period"),
    "glide_speed_mps": ("glide", "speed"),
    "glide_angle_deg": ("glide", "angle"),
}
"""Trial and column of each quantity."""


def _simulated(report: Report, quantity: str, condition: str) -> Value:
    if quantity.startswith("bollard"):
        name = f"thrust {quantity.split('_')[1]}"
        return next((p.values[0] for p in report.particulars if p.name == name), None)
    trial, column = _WHERE[quantity]
    value = report.trial(trial).value(condition, column)
    if value is None:
        return None
    return abs(deg(value) if "deg" in quantity.rpartition("_")[2] else value)


def as_json(report: Report) -> dict[str, object]:
    """Plain values, SI and radians; comparisons in the unit of their quantity."""
    tree = asdict(report)
    tree["comparisons"] = [
        {**asdict(c), "published": [{"value": p.value, "status": p.status, "source": p.source} for p in c.published]}
        for c in report.comparisons
    ]
    return tree


def markdown(report: Report, picture: str = "") -> str:
    """The report as a page; `picture` is the way to one from there."""
    water = f"{report.density_kgpm3:g} kg/m3"
    lines = [f"# {report.name}", "", report.description + ".", ""]
    if picture:
        lines += [f"![Shapes and thrusters of {report.name}]({picture})", ""]
    share = f"{report.guesses} of {report.groups} groups of numbers of hull, thrusters and fins are guesses"
    lines += ["## Numbers", "", f"In water of {water}; signs and axes forward, right, down. {share}.", ""]
    lines += _table(("number", "value", "unit", "status"), [
        (p.name, ", ".join(_digits(v) for v in p.values), p.unit, p.status or "-") for p in report.particulars
    ])  # fmt: skip
    lines += ["", "## Beside the real vehicle", ""]
    lines += _table(("quantity", "condition", "simulated", "published", "status", "source"), [
        row for comparison in report.comparisons for row in _compared(comparison)
    ])  # fmt: skip
    for trial in report.trials:
        lines += ["", f"## {trial.title}", ""]
        if not trial.rows:
            lines.append(f"Does not apply: {trial.reason}.")
            continue
        head = ("", *(f"{c.name}{_unit(c.unit)}" for c in trial.columns))
        body = [
            (row.condition, *(_shown(v, c.unit) for v, c in zip(row.values, trial.columns, strict=True)))
            for row in trial.rows
        ]
        lines += [trial.text, "", *_table(head, body)]
    return "\n".join(lines) + "\n"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(head)} |", "|" + "---|" * len(head), *(f"| {' | '.join(row)} |" for row in rows)]


def _compared(comparison: Comparison) -> list[tuple[str, ...]]:
    begin = (
        comparison.quantity,
        comparison.condition or "-",
        "-" if comparison.simulated is None else _digits(comparison.simulated),
    )
    if not comparison.published:
        return [(*begin, NONE_FOUND, "-", "-")]
    return [(*begin, _digits(p.value), p.status, p.source) for p in comparison.published]


def _unit(unit: str) -> str:
    return "" if unit == "1" else f", {unit.replace('rad', 'deg')}"


def _shown(value: Value, unit: str) -> str:
    if value is None:
        return "-"
    if unit.startswith("rad"):
        return f"{deg(value) + 0.0:.1f}".replace("-0.0", "0.0")
    return _digits(value)


def _digits(value: float) -> str:
    """Three digits, and nothing below a thousandth."""
    if abs(value) < 5e-4:
        return "0"
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
