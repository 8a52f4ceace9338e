"""Checks the fins, propellers, ballasts, moving masses and hull derivatives of one vehicle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from msgspec import UNSET, UnsetType

from uwserver.physics.dynamics.appendage_params import quadrant_coefficients
from uwserver.scenario.files.convert import Node, Report
from uwserver.scenario.files.errors import KeyPath
from uwserver.scenario.vehicle.appendage_tables import Foil, Hull, ShaftPropeller
from uwserver.scenario.vehicle.appendages import TERM, quadrant_series
from uwserver.scenario.vehicle.tables import RigidBody
from uwserver.table import Vector3
from uwserver.units import deg

_DERIVATIVE = "an axis of XYZKMN and two velocities of uvwpqr"


def check_appendages(vehicle: Node, report: Report) -> None:
    """Check all appendages of a vehicle file that could be read; `report` is called for errors."""
    for name, foil in vehicle.values("foils").items():
        _check_foil(foil, ("foils", name), report)
    for name, fin in vehicle.values("fins").items():
        _check_foil(fin, ("fins", name), report)
        _check_terms(fin.derivatives, True, ("fins", name, "derivatives"), report)
    hull: Hull | None = vehicle.at("hull").value
    if hull is not None and not isinstance(hull.derivatives, UnsetType):
        _check_terms(hull.derivatives.terms, False, ("hull", "derivatives", "terms"), report)
    for name, propeller in vehicle.values("propellers").items():
        _check_propeller(propeller, ("propellers", name), report)
    for name, ballast in vehicle.values("ballasts").items():
        if not ballast.min_volume_m3 <= ballast.neutral_volume_m3 <= ballast.max_volume_m3:
            report(
                ("ballasts", name, "neutral_volume_m3"),
                f"must lie between min_volume_m3 ({ballast.min_volume_m3:g}) and max_volume_m3 ({ballast.max_volume_m3:g})",
            )
    body: RigidBody | None = vehicle.at("rigid_body").value
    for name, mass in vehicle.values("moving_masses").items():
        path: KeyPath = ("moving_masses", name)
        check_direction(mass.axis_frd, "axis", "a positive position", (*path, "axis_frd"), report)
        if not mass.min_position_m <= 0.0 <= mass.max_position_m:
            report(path, "position 0 must lie between min_position_m and max_position_m")
        if body is not None and mass.mass_kg >= body.mass_kg:
            report((*path, "mass_kg"), f"is part of the vehicle's mass_kg ({body.mass_kg:g}): must be less")


def check_direction(vector: Vector3, noun: str, meaning: str, path: KeyPath, report: Report) -> bool:
    """Return whether a vector is not zero; report it otherwise. `meaning` says what its direction stands for."""
    if not any(vector):
        report(path, f"the {noun} has no direction: give the direction of {meaning}")
    return any(vector)


def _check_propeller(propeller: ShaftPropeller, path: KeyPath, report: Report) -> None:
    check_direction(propeller.axis_frd, "axis", "the thrust at a positive speed", (*path, "axis_frd"), report)
    if isinstance(propeller.curve, UnsetType):
        if propeller.astern_factor != 1.0:
            report(
                (*path, "astern_factor"),
                "works with a curve only: a propeller in four quadrants has its own thrust astern",
            )
        if propeller.inflow != "axial":
            report(
                (*path, "inflow"),
                '"speed" works with a curve only: in four quadrants the direction of the inflow counts',
            )
        if propeller.quadrants is not UNSET and propeller.pitch_ratio is not UNSET:
            report(
                (*path, "pitch_ratio"),
                "is for the B4-70, but quadrants describe another propeller: leave one of the two out",
            )
        _check_quadrants(propeller, path, report)
        return
    if any(b[0] <= a[0] for a, b in pairwise(propeller.curve)):
        report((*path, "curve"), "the advance numbers J (first of each point) must rise from point to point")
    for key in ("pitch_ratio", "quadrants"):
        if getattr(propeller, key) is not UNSET:
            report(
                (*path, key),
                "describes four quadrants, but the curve describes the first one only: leave one of the two out",
            )
    if propeller.damping_includes_stopped:
        report((*path, "damping_includes_stopped"), "a stopped propeller with a curve has no drag: leave this key out")


def _check_quadrants(propeller: ShaftPropeller, path: KeyPath, report: Report) -> None:
    """Check that the propeller nowhere gives more power than its shaft takes: Q 2 pi n - T V_a >= 0."""
    beta = np.linspace(-math.pi, math.pi, 361)
    thrust, torque = quadrant_coefficients(quadrant_series(propeller), beta)
    lost = np.cos(beta) / 0.35 * torque - np.sin(beta) * thrust
    worst = int(lost.argmin())
    if lost[worst] < -1e-3:
        report((*path, "quadrants"), f"the propeller gives more power than its shaft takes at beta = {deg(beta[worst]):.0f} degrees")  # fmt: skip


def _check_foil(foil: Foil, path: KeyPath, report: Report) -> None:
    hinge = check_direction(foil.hinge_frd, "hinge", "the axis of a positive angle", (*path, "hinge_frd"), report)
    if hinge and check_direction(foil.chord_frd, "chord", "the leading edge", (*path, "chord_frd"), report):
        lengths = math.hypot(*foil.hinge_frd) * math.hypot(*foil.chord_frd)
        if float(np.linalg.norm(np.cross(foil.hinge_frd, foil.chord_frd))) < 1e-6 * lengths:
            report((*path, "chord_frd"), "the chord is parallel to the hinge: it must lie across")
    if foil.area_m2 > 0.0 and foil.lift_slope_prad is UNSET and foil.aspect_ratio is UNSET:
        report(path, "a foil with an area needs lift_slope_prad, aspect_ratio, or both: none is given")


def _check_terms(terms: Mapping[str, float], turned: bool, path: KeyPath, report: Report) -> None:
    for term in terms:
        match = TERM.fullmatch(term)
        if match is None or bool(match[4]) != turned:
            example = ", then d or dd for the angle, such as Yuud" if turned else ", such as Yur"
            report((*path, term), f'"{term}" is not a derivative: write {_DERIVATIVE}{example}')
