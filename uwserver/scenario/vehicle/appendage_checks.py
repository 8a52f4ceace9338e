"""Checks of fins, propellers, ballast, moving masses and hull derivatives of one vehicle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from msgspec import UNSET, UnsetType

from uwserver.actuators import FinsConfig
from uwserver.actuators.servo import OneServo
from uwserver.physics.dynamics.appendage_params import quadrant_coefficients
from uwserver.scenario.files.convert import Report
from uwserver.scenario.files.errors import KeyPath, suggestion
from uwserver.scenario.vehicle.appendage_tables import Foil, ShaftPropeller
from uwserver.scenario.vehicle.appendages import TERM, quadrant_series
from uwserver.scenario.vehicle.assembly import Draft
from uwserver.units import deg

_DERIVATIVE = "an axis of XYZKMN and two velocities of uvwpqr"


def check_appendages(draft: Draft, report: Report) -> None:
    """All checks of what could be read; `report` takes in faults."""
    for table, foils in (("foils", draft.foils), ("fins", draft.fins)):
        for name, foil in foils.items():
            _check_foil(foil, (table, name), report)
    for name, fin in draft.fins.items():
        _check_terms(fin.derivatives, True, ("fins", name, "derivatives"), report)
    if draft.hull is not None and not isinstance(draft.hull.derivatives, UnsetType):
        _check_terms(draft.hull.derivatives.terms, False, ("hull", "derivatives", "terms"), report)
    for name, propeller in draft.propellers.items():
        _check_propeller(propeller, ("propellers", name), report)
    for name, ballast in draft.ballasts.items():
        if not ballast.min_volume_m3 <= ballast.neutral_volume_m3 <= ballast.max_volume_m3:
            report(
                ("ballasts", name, "neutral_volume_m3"),
                f"must lie between min_volume_m3 ({ballast.min_volume_m3:g}) and max_volume_m3 ({ballast.max_volume_m3:g})",
            )
    for name, mass in draft.moving_masses.items():
        path: KeyPath = ("moving_masses", name)
        if not any(mass.axis_frd):
            report((*path, "axis_frd"), "the axis has no direction: give the direction of a positive position")
        if not mass.min_position_m <= 0.0 <= mass.max_position_m:
            report(path, "position 0 must lie between min_position_m and max_position_m")
        if draft.rigid_body is not None and mass.mass_kg >= draft.rigid_body.mass_kg:
            report((*path, "mass_kg"), f"is part of the vehicle's mass_kg ({draft.rigid_body.mass_kg:g}): must be less")
    _check_members(draft, report)


def _check_propeller(propeller: ShaftPropeller, path: KeyPath, report: Report) -> None:
    if not any(propeller.axis_frd):
        report((*path, "axis_frd"), "the axis has no direction: give the direction of the thrust at a positive speed")
    if isinstance(propeller.curve, UnsetType):
        if propeller.astern_factor != 1.0:
            report((*path, "astern_factor"), "belongs to a curve: four quadrants have their own thrust astern")
        if propeller.inflow != "axial":
            report((*path, "inflow"), "the whole speed belongs to a curve: in four quadrants its direction counts")
        if propeller.quadrants is not UNSET and propeller.pitch_ratio is not UNSET:
            report((*path, "pitch_ratio"), "belongs to the B4-70, but quadrants give another propeller: leave one out")
        _check_quadrants(propeller, path, report)
        return
    if any(b[0] <= a[0] for a, b in pairwise(propeller.curve)):
        report((*path, "curve"), "the advance numbers J (first of each point) must rise from point to point")
    for key in ("pitch_ratio", "quadrants"):
        if getattr(propeller, key) is not UNSET:
            report((*path, key), "gives four quadrants, but the curve gives the first alone: leave one out")
    if propeller.damping_includes_stopped:
        report((*path, "damping_includes_stopped"), "by a curve a stopped propeller has no drag: leave the key out")


def _check_quadrants(propeller: ShaftPropeller, path: KeyPath, report: Report) -> None:
    """What the shaft gives to the water, less what the thrust does with it, is lost there: Q 2 pi n - T V_a >= 0."""
    beta = np.linspace(-math.pi, math.pi, 361)
    thrust, torque = quadrant_coefficients(quadrant_series(propeller), beta)
    lost = np.cos(beta) / 0.35 * torque - np.sin(beta) * thrust
    worst = int(lost.argmin())
    if lost[worst] < -1e-3:
        report((*path, "quadrants"), f"the propeller gives more power than its shaft takes at beta = {deg(beta[worst]):.0f} degrees")  # fmt: skip


def _check_foil(foil: Foil, path: KeyPath, report: Report) -> None:
    if not any(foil.hinge_frd):
        report((*path, "hinge_frd"), "the hinge has no direction: give the axis of a positive angle")
    elif not any(foil.chord_frd):
        report((*path, "chord_frd"), "the chord has no direction: give the direction of the leading edge")
    elif float(np.linalg.norm(np.cross(foil.hinge_frd, foil.chord_frd))) < 1e-6 * math.hypot(
        *foil.hinge_frd
    ) * math.hypot(*foil.chord_frd):
        report((*path, "chord_frd"), "the chord is parallel to the hinge: it must lie across")
    if foil.area_m2 > 0.0 and foil.lift_slope_prad is UNSET and foil.aspect_ratio is UNSET:
        report(path, "give lift_slope_prad, aspect_ratio, or both: none is given")


def _check_terms(terms: Mapping[str, float], turned: bool, path: KeyPath, report: Report) -> None:
    for term in terms:
        match = TERM.fullmatch(term)
        if match is None or bool(match[4]) != turned:
            example = ", then d or dd for the angle, such as Yuud" if turned else ", such as Yur"
            report((*path, term), f'"{term}" is no derivative: name {_DERIVATIVE}{example}')


def _check_members(draft: Draft, report: Report) -> None:
    for name, actuator in draft.actuators.items():
        path: KeyPath = ("actuators", name)
        if not actuator.enabled:
            continue
        if isinstance(actuator, FinsConfig):
            present = draft.names("fins")
            if actuator.members is None and not present:
                report(path, "the vehicle has no fins to command")
            for k, member in enumerate(actuator.members or ()):
                check_member(member, present, "fin", (*path, "members", k), report)
                if member in (actuator.members or ())[:k]:
                    report((*path, "members", k), f'"{member}" is named twice')
        elif isinstance(actuator, OneServo):
            moved = actuator.moved
            check_member(actuator.member, draft.names(moved.table), moved.noun, (*path, "member"), report)


def check_member(member: str, present: tuple[str, ...], noun: str, path: KeyPath, report: Report) -> None:
    """A name must be among those that are present; `noun` is what it names."""
    if member not in present:
        report(path, f'no {noun} "{member}"{suggestion(member, present, "; there are: ")}')
