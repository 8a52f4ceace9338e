"""The manoeuvre report of a vehicle: its numbers, its manoeuvres, and a comparison with published figures of the real vehicle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import get_args

from msgspec import UnsetType

from uwserver.scenario.load.resolved import ResolvedVehicle
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.tables import Published, Quantity
from uwserver.scenario.world.tables import Environment
from uwserver.units import deg, rad
from uwserver.validation.energy import feeds
from uwserver.validation.manoeuvres import trials
from uwserver.validation.manoeuvres.helm import Helm
from uwserver.validation.manoeuvres.particulars import Particular, guesses, particulars
from uwserver.validation.manoeuvres.runs import (
    BY_THRUST,
    ON_THE_SPOT,
    Column,
    Row,
    Trial,
    Value,
    Waters,
    ahead,
    turn_told,
)
from uwserver.validation.manoeuvres.trials import RUDDER, turning_circle, zig_zag
from uwserver.validation.manoeuvres.verdicts import Verdict, lines_of, verdicts


@dataclass(frozen=True)
class Comparison:
    """A quantity of `published` in the vehicle file, in the unit of its name: the simulated value, and the published figures."""

    quantity: str
    condition: str
    simulated: Value
    published: tuple[Published, ...] = ()


@dataclass(frozen=True)
class Report:
    """The report on one vehicle.

    Attributes:
        floats: whether the vehicle is a surface vessel.
        verdicts: what stands out, with its cause and what to change.
        guesses: how many groups of numbers of its hull and devices are guesses.
        groups: how many such groups there are.
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
    verdicts: tuple[Verdict, ...] = ()

    def trial(self, key: str) -> Trial:
        """Return a trial by its key."""
        return next(trial for trial in self.trials if trial.key == key)


def resolve(model: str, environment: Environment) -> ResolvedVehicle:
    """Load a vehicle by name or file, as a scenario does.

    Raises:
        ScenarioError: there is a fault in its file.
    """
    entry = VehicleEntry(model=model, position_ned_m=(0.0, 0.0, 5.0))
    scenario = Scenario(schema=1, environment=environment, vehicles={"vehicle": entry})
    return load(scenario, adapters={}).vehicles["vehicle"]


def report(model: str, density_kgpm3: float = 1025.0) -> Report:
    """Run all manoeuvres of a vehicle, by name or file, in still water of a density (kg/m3).

    Raises:
        ScenarioError: there is a fault in its file.
        FloatingPointError: a manoeuvre diverged.
    """
    environment = Environment(density_kgpm3=density_kgpm3)
    resolved = resolve(model, environment)
    body = body_params(resolved.vehicle, resolved.devices, environment)
    file = resolved.vehicle
    helm = Helm(file, body)
    waters, published = Waters(helm), file.published
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
    numbers = tuple(particulars(resolved, body, helm))
    without = Report(file.name, file.description, density_kgpm3, waters.floats, *guesses(resolved), numbers, (), done)
    comparisons = tuple(_comparisons(without, helm, published))
    figures = [(c.quantity, c.simulated, p.value) for c in comparisons for p in c.published]
    judged = verdicts(done, figures, lines_of(helm), waters.floats)
    return replace(without, comparisons=comparisons, verdicts=judged)


def _rudder(figure: Published, helm: Helm) -> float:
    return min(RUDDER, helm.rudder) if isinstance(figure.rudder_deg, UnsetType) else rad(figure.rudder_deg)


def _energy(helm: Helm) -> Trial:
    """Return the test of `validation.energy` as a trial."""
    columns = (Column("rate", "largest power of the water over the energy", "1/s"),)
    rows = tuple(Row(f"energy of {feed.speed:g} m/s", (feed.rate,)) for feed in feeds(helm.body))
    text = (
        "Without thrust the water must take energy (negative power), whatever the motion. The row shows the worst of all velocities with the\n"
        "kinetic energy of this speed ahead, including astern, sideways and turning. At 50 m/s only terms of the second degree matter."
    )
    return Trial("energy", "Energy", text, columns, rows)


def _comparisons(report: Report, helm: Helm, published: Sequence[Published]) -> Iterator[Comparison]:
    """Yield each quantity that the vehicle has, at full throttle and at each condition for which a figure is published."""
    for quantity in get_args(Quantity):
        # The figures of each condition, in the order of the conditions.
        figures: dict[str, tuple[Published, ...]] = {_condition(quantity, 1.0, min(RUDDER, helm.rudder), helm): ()}
        for figure in published:
            if figure.quantity == quantity:
                condition = _condition(quantity, figure.throttle, _rudder(figure, helm), helm)
                figures[condition] = (*figures.get(condition, ()), figure)
        for condition, at in figures.items():
            simulated = _simulated(report, quantity, condition)
            if simulated is not None or at:
                yield Comparison(quantity, condition, simulated, at)


_WHERE = {
    "ahead_speed_mps": ("straight", "steady", ""),
    "astern_speed_mps": ("straight", "steady", "astern 100 %"),
    "sway_speed_mps": ("sway", "speed", "to starboard 100 %"),
    "descent_mps": ("dive", "sink", "down 100 %"),
    "ascent_mps": ("dive", "sink", "up 100 %"),
    "turning_diameter_m": ("turn", "diameter", ""),
    "turn_rate_degps": ("turn", "rate", ""),
    "spot_turn_rate_degps": ("turn", "rate", ON_THE_SPOT),
    "roll_period_s": ("decay", "period", "roll"),
    "pitch_period_s": ("decay", "period", "pitch"),
    "glide_speed_mps": ("glide", "speed", "down"),
    "glide_angle_deg": ("glide", "angle", "down"),
}
"""Trial, column and condition of each quantity; "" if the condition depends on the figure. Bollard pulls are no trials."""


def _condition(quantity: str, throttle: float, rudder: float, helm: Helm) -> str:
    """Return the name of the run that a figure belongs to."""
    if quantity == "ahead_speed_mps":
        return ahead(throttle)
    if quantity in ("turning_diameter_m", "turn_rate_degps"):
        return turn_told(throttle, rudder) if helm.has("rudder") else BY_THRUST
    return _WHERE.get(quantity, ("", "", ""))[2]


def _simulated(report: Report, quantity: str, condition: str) -> Value:
    if quantity not in _WHERE:
        name = f"thrust {quantity.split('_')[1]}"
        return next((p.values[0] for p in report.particulars if p.name == name), None)
    trial, column, _ = _WHERE[quantity]
    value = report.trial(trial).value(condition, column)
    if value is None:
        return None
    return abs(deg(value) if "deg" in quantity.rpartition("_")[2] else value)


def as_json(report: Report) -> dict[str, object]:
    """Return the report as plain values in SI units and radians; comparisons are in the unit of their quantity."""
    tree = asdict(report)
    tree["comparisons"] = [
        {**asdict(c), "published": [{"value": p.value, "status": p.status, "source": p.source} for p in c.published]}
        for c in report.comparisons
    ]
    return tree
