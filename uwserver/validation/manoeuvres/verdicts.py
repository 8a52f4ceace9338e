"""What a person should do about a vehicle: verdicts on its manoeuvres, each with its cause in the numbers of the file.

A verdict compares a figure of a run with a threshold of ours, which is generous, and looks for the cause in statics: the lines along which thrust,
drag, weight and buoyancy act (Fossen 2011, 4.1 and 6.4).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from uwserver.physics.dynamics.params import BodyParams
from uwserver.units import deg, rad
from uwserver.validation.manoeuvres.helm import Helm, Sticks, bollard
from uwserver.validation.manoeuvres.runs import Trial, Value, ahead
from uwserver.validation.manoeuvres.trials import SHORT_S

LEANS = rad(15.0)
"""Pitch at full ahead."""
TURNS = rad(20.0)
"""Change of heading in the first seconds at full ahead."""
TRIM = rad(3.0)
"""Roll or pitch of a vehicle that is left alone."""
HEAVY = 0.02
"""Weight in the water over weight; less is what ballast on site changes."""
OFF = 0.2
"""Difference to a published figure over that figure."""
ARM = 0.005
"""Distance of two lines of force that explains a lean or a turn, m."""


@dataclass(frozen=True)
class Verdict:
    """One thing that stands out.

    Attributes:
        text: what the vehicle does.
        cause: why, in the numbers of its file; "" if statics do not show it.
        remedy: what to change.
    """

    text: str
    cause: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.text}{f': {self.cause}' if self.cause else ''}; {self.remedy}"


@dataclass(frozen=True)
class Lines:
    """Where the forces of a vehicle act, in B.

    Attributes:
        thrust, drag: distance of the line of full thrust ahead, and of that of the drag ahead, from the origin: y (to starboard) and z (down), m;
            None without thrust.
        body: weight, buoyancy, and their centres.
    """

    thrust: tuple[float, float] | None
    drag: tuple[float, float]
    body: BodyParams


def lines_of(helm: Helm) -> Lines:
    """Return where thrust ahead at full command and drag ahead act, from moments over forces: M = z X, N = -y X."""
    body = helm.body
    thrust = None
    if helm.has("surge"):
        X, M, N = bollard(body, [partial(helm.tell, sticks=Sticks(surge=1.0))])[0, [0, 4, 5]]
        thrust = (-float(N / X), float(M / X)) if abs(X) > 1e-6 else None
    # At speeds at which a vehicle leans the quadratic drag leads; where there is none, the linear.
    D = body.D_Q if body.D_Q[0, 0] > 0.0 else body.D_L
    drag = (-float(D[5, 0] / D[0, 0]), float(D[4, 0] / D[0, 0])) if D[0, 0] > 0.0 else (0.0, 0.0)
    return Lines(thrust, drag, body)


def verdicts(
    trials: Sequence[Trial], published: Sequence[tuple[str, Value, float]], lines: Lines, floats: bool
) -> tuple[Verdict, ...]:
    """Return all verdicts, those that spoil a run first.

    Args:
        trials: trials of the report.
        published: name of a quantity with its unit, simulated value and published figure.
        lines: where the forces act.
        floats: whether it is a surface vessel.
    """
    by_key = {trial.key: trial for trial in trials}
    found = [
        *_energy(by_key["energy"]),
        *(() if floats else _righting(lines.body)),
        *(() if floats else _buoyancy(lines.body)),
        *(() if floats else _trim(by_key["rest"], lines.body)),
        *_ahead(by_key["straight"], lines, floats),
        *_loops(by_key),
        *_published(published),
    ]
    return tuple(found)


def _energy(trial: Trial) -> Iterator[Verdict]:
    worst = max((value for row in trial.rows if (value := row.values[0]) is not None), default=0.0)
    if worst > 0.0:
        yield Verdict(
            "the water drives it",
            f"it gains energy at a rate of {worst:.3g} 1/s without thrust",
            "make the damping larger, or the terms of [hull.derivatives] smaller, until the rates of Energy are negative",
        )


def _righting(body: BodyParams) -> Iterator[Verdict]:
    arm = (body.weight * body.r_g[2] - body.buoyancy * body.r_b[2]) / max(body.weight, 1e-9)
    if arm < 0.0:
        yield Verdict(
            "it turns over when it is let go",
            f"the centre of buoyancy lies {-1e3 * arm:.0f} mm below the centre of gravity",
            "z is down: make z of [buoyancy] center_frd_m smaller",
        )
    elif arm < 1e-4:
        yield Verdict(
            "it stays at any angle",
            "the centres of buoyancy and gravity are at the same height",
            "z is down: make z of [buoyancy] center_frd_m smaller, by some centimetres for an ROV",
        )


def _buoyancy(body: BodyParams) -> Iterator[Verdict]:
    surplus = body.weight - body.buoyancy
    if abs(surplus) <= HEAVY * body.weight:
        return
    share = 100.0 * abs(surplus) / body.weight
    does, too = ("sinks", "heavy") if surplus > 0.0 else ("rises", "light")
    neutral = f"{body.weight / body.buoyancy:.3f} times" if body.buoyancy > 0.0 else "larger"
    yield Verdict(
        f"it {does} when it is left alone",
        f"it is {abs(surplus):.3g} N too {too} for this water ({share:.0f} % of its weight)",
        f"{neutral} the volume_m3 of [buoyancy] would make it neutral, or another mass_kg, or another --density",
    )


def _trim(trial: Trial, body: BodyParams) -> Iterator[Verdict]:
    roll, pitch, _ = trial.rows[0].values
    for angle, name, axis, words in (
        (pitch, "pitch", 0, ("bow up", "bow down", "ahead of", "behind")),
        (roll, "roll", 1, ("heeled to starboard", "heeled to port", "to port of", "to starboard of")),
    ):
        if angle is None or abs(angle) <= TRIM:
            continue
        moment = body.weight * body.r_g[axis] - body.buoyancy * body.r_b[axis]
        apart = 1e3 * moment / max(body.weight, 1e-9)
        side = words[0] if angle > 0.0 else words[1]
        where = words[2] if angle > 0.0 else words[3]
        cause = (
            f"the centre of buoyancy is {abs(apart):.0f} mm {where} the centre of gravity" if abs(apart) >= 1.0 else ""
        )
        yield Verdict(
            f"it lies {side} by {deg(abs(angle)):.0f} degrees when it is left alone",
            cause,
            f"move [buoyancy] center_frd_m along {'xy'[axis]}, or the weights ({name} should be near 0)",
        )


def _ahead(trial: Trial, lines: Lines, floats: bool) -> Iterator[Verdict]:
    if not trial.rows:
        return
    full = ahead(1.0)
    pitch, turned, tilt = (trial.value(full, column) for column in ("pitch", "heading", "tilt"))
    tumbles = tilt is not None and tilt >= 0.5 * math.pi
    if not floats and pitch is not None and tilt is not None and (tumbles or abs(pitch) >= LEANS):
        yield _lean(pitch, tilt, lines)
    # Of a vehicle that tumbles the heading says nothing.
    if turned is not None and abs(turned) >= TURNS and not tumbles:
        yield _turn(turned, lines)


def _lean(pitch: float, tilt: float, lines: Lines) -> Verdict:
    text = f"leans {deg(abs(pitch)):.0f} degrees {'bow up' if pitch > 0.0 else 'bow down'} at full ahead"
    if tilt >= 0.5 * math.pi:
        text = f"tumbles at full ahead (it tilts by up to {deg(tilt):.0f} degrees)"
    arm = 0.0 if lines.thrust is None else lines.thrust[1] - lines.drag[1]
    # Thrust below the drag lifts the bow, above it presses the bow down.
    if abs(arm) >= ARM and ((arm > 0.0) == (pitch > 0.0) or tilt >= 0.5 * math.pi):
        word = "below" if arm > 0.0 else "above"
        cause = f"the centre of thrust is {1e3 * abs(arm):.0f} mm {word} the centre of drag"
        other = "up" if arm > 0.0 else "down"
        remedy = f"move the thrusters that push ahead {other} (z of position_frd_m), tilt their axis_frd, or make the righting arm longer"
        return Verdict(text, cause, remedy)
    remedy = "make the righting arm longer (z of [buoyancy] center_frd_m), or add fins or foils astern"
    return Verdict(text, "the moment of the flow on the hull is larger than that of weight and buoyancy", remedy)


def _turn(turned: float, lines: Lines) -> Verdict:
    side, often = "starboard" if turned > 0.0 else "port", abs(turned) / (2.0 * math.pi)
    how = f"spins {often:.1f} times" if often > 1.0 else f"turns {deg(abs(turned)):.0f} degrees"
    text = f"{how} to {side} within {SHORT_S:g} s at full ahead"
    arm = 0.0 if lines.thrust is None else lines.thrust[0] - lines.drag[0]
    # Thrust to port of the drag turns the bow to starboard.
    if abs(arm) >= ARM and (arm < 0.0) == (turned > 0.0):
        word = "port" if arm < 0.0 else "starboard"
        cause = f"the centre of thrust is {1e3 * abs(arm):.0f} mm to {word} of the centre of drag"
        return Verdict(text, cause, "make y of the thrusters' position_frd_m and their axis_frd symmetric")
    cause = "it does not keep its course by itself, as most ROVs; or the torques of its propellers do not cancel"
    return Verdict(
        text,
        cause,
        "let an autopilot hold the heading, add fins astern, or give thrusters the other handedness in pairs",
    )


def _loops(by_key: dict[str, Trial]) -> Iterator[Verdict]:
    looping = [row.condition for row in by_key["dive"].rows if row.condition.endswith("(it loops)")]
    if looping:
        yield Verdict(
            f"it loops with {looping[0].removesuffix(' (it loops)')}",
            "the planes are stronger than the righting moment at this speed",
            "make the planes smaller, or their largest angle, or the righting arm longer",
        )


def _published(published: Sequence[tuple[str, Value, float]]) -> Iterator[Verdict]:
    for quantity, simulated, figure in published:
        if simulated is None or figure == 0.0 or abs(simulated - figure) <= OFF * figure:
            continue
        name, _, unit = quantity.rpartition("_")
        factor = simulated / figure
        remedy = "look at the numbers with status guess first"
        if name.endswith("speed") and unit == "mps":
            # At a steady speed thrust equals drag, which grows with the square of the speed.
            remedy = f"{factor**2:.2g} times the quadratic damping along this axis, or {factor**-2:.2g} times the thrust, would give it"
        text = f"{name.replace('_', ' ')} is {simulated:.3g} {unit}, published is {figure:.3g}"
        yield Verdict(text, f"{100.0 * abs(factor - 1.0):.0f} % too {'much' if factor > 1.0 else 'little'}", remedy)
