"""Converts the tables of fins, propellers, ballasts and hull to kernel parameters, in the water of the scenario."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping

from msgspec import UnsetType

from uwserver.physics.dynamics.appendage_params import (
    Appendages,
    DerivativeParams,
    FoilParams,
    HullParams,
    PropellerParams,
    Series,
    ServoParams,
    WeightParams,
)
from uwserver.scenario.vehicle.appendage_tables import Ballast, Fin, Foil, Hull, MovingMass, ShaftPropeller
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.scenario.vehicle.wageningen import b4_70
from uwserver.scenario.world.tables import Environment
from uwserver.units import rad

TERM = re.compile(r"([XYZKMN])([uvwpqr])([uvwpqr])(d{0,2})")
"""Name of a derivative: axis, two velocities, power of the angle."""


def appendages(vehicle: VehicleFile, environment: Environment) -> Appendages:
    """Return all appendages of a checked vehicle."""
    rho, g = environment.density, environment.gravity
    servos = [_fin_servo(f"fins.{name}", fin) for name, fin in vehicle.fins.items()]
    servos += [
        ServoParams(
            f"propellers.{name}", -p.max_speed_radps, p.max_speed_radps, _limit(p.rate_radps2), p.time_constant_s
        )
        for name, p in vehicle.propellers.items()
    ]
    servos += [
        ServoParams(
            f"ballasts.{name}", b.min_volume_m3, b.max_volume_m3, b.rate_m3ps, b.time_constant_s, b.neutral_volume_m3
        )
        for name, b in vehicle.ballasts.items()
    ]
    servos += [
        ServoParams(f"moving_masses.{name}", m.min_position_m, m.max_position_m, m.rate_mps, m.time_constant_s)
        for name, m in vehicle.moving_masses.items()
    ]
    foils = [_foil(foil, "", rho) for foil in vehicle.foils.values()]
    foils += [_foil(fin, f"fins.{name}", rho) for name, fin in vehicle.fins.items() if fin.area_m2 > 0.0]
    weights = [_ballast(b, f"ballasts.{name}", rho * g) for name, b in vehicle.ballasts.items()]
    weights += [_moving_mass(m, f"moving_masses.{name}", g) for name, m in vehicle.moving_masses.items()]
    return Appendages(
        servos=tuple(servos),
        foils=tuple(foils),
        propellers=tuple(_propeller(p, f"propellers.{name}", rho) for name, p in vehicle.propellers.items()),
        weights=tuple(weights),
        derivatives=tuple(_derivatives(vehicle, rho)),
        hulls=tuple(_hull(vehicle, rho)),
    )


def _limit(rate: float | UnsetType) -> float:
    return math.inf if isinstance(rate, UnsetType) else rate


def _fin_servo(name: str, fin: Fin) -> ServoParams:
    rate = fin.rate_degps if isinstance(fin.rate_degps, UnsetType) else rad(fin.rate_degps)
    return ServoParams(name, -rad(fin.limit_deg), rad(fin.limit_deg), _limit(rate), fin.time_constant_s)


def lift_slope(foil: Foil) -> float:
    """Return dC_L/dalpha, 1/rad, of a foil with a slope or an aspect ratio (`vehicle.checks` ensures one)."""
    if not isinstance(foil.lift_slope_prad, UnsetType):
        return foil.lift_slope_prad
    ratio = 0.0 if isinstance(foil.aspect_ratio, UnsetType) else foil.aspect_ratio
    return math.pi * ratio / (1.0 + math.sqrt(1.0 + 0.25 * ratio * ratio))


def _foil(foil: Foil, servo: str, rho: float) -> FoilParams:
    ratio = 1.0 if isinstance(foil.aspect_ratio, UnsetType) else foil.aspect_ratio
    span = math.sqrt(ratio * foil.area_m2) if isinstance(foil.span_m, UnsetType) else foil.span_m
    return FoilParams(
        servo=servo,
        r=foil.position_frd_m,
        hinge=foil.hinge_frd,
        chord=foil.chord_frd,
        pressure_area=0.5 * rho * foil.area_m2,
        slope=lift_slope(foil),
        induced=0.0 if isinstance(foil.aspect_ratio, UnsetType) else 1.0 / (math.pi * foil.oswald * ratio),
        cd0=foil.drag,
        cd90=foil.plate_drag,
        stall=rad(foil.stall_deg),
        stall_end=rad(foil.stall_deg + foil.stall_width_deg),
        whole=foil.inflow == "speed",
        radius=0.5 * span,
    )


def quadrant_series(propeller: ShaftPropeller) -> Series:
    """Return the Fourier series of a propeller in four quadrants; an empty one if it has a curve."""
    if not isinstance(propeller.curve, UnsetType):
        return ()
    if not isinstance(propeller.quadrants, UnsetType):
        return propeller.quadrants
    return b4_70(1.0 if isinstance(propeller.pitch_ratio, UnsetType) else propeller.pitch_ratio)


def _propeller(propeller: ShaftPropeller, servo: str, rho: float) -> PropellerParams:
    return PropellerParams(
        servo=servo,
        r=propeller.position_frd_m,
        axis=propeller.axis_frd,
        diameter=propeller.diameter_m,
        density=rho,
        curve=() if isinstance(propeller.curve, UnsetType) else propeller.curve,
        series=quadrant_series(propeller),
        damping_includes_stopped=propeller.damping_includes_stopped,
        wake=1.0 - propeller.wake_fraction,
        deduction=1.0 - propeller.thrust_deduction,
        astern=propeller.astern_factor,
        sense={"right": -1.0, "left": 1.0, "none": 0.0}[propeller.handedness],
        whole=propeller.inflow == "speed",
    )


def _ballast(ballast: Ballast, servo: str, specific_weight: float) -> WeightParams:
    force = -specific_weight if ballast.form == "bladder" else specific_weight
    x, y, z = ballast.position_frd_m
    return WeightParams(servo, force, (force * x, force * y, force * z), displaces=ballast.form == "bladder")


def _moving_mass(mass: MovingMass, servo: str, g: float) -> WeightParams:
    x, y, z = (mass.mass_kg * g * component / math.hypot(*mass.axis_frd) for component in mass.axis_frd)
    return WeightParams(servo, 0.0, (x, y, z))


def _derivatives(vehicle: VehicleFile, rho: float) -> Iterator[DerivativeParams]:
    if not isinstance(vehicle.hull.derivatives, UnsetType):
        table = vehicle.hull.derivatives
        yield from _terms(table.terms, rho / table.reference_density_kgpm3, "")
    for name, fin in vehicle.fins.items():
        yield from _terms(fin.derivatives, rho / fin.reference_density_kgpm3, f"fins.{name}")


def _terms(terms: Mapping[str, float], scale: float, servo: str) -> Iterator[DerivativeParams]:
    for name, value in terms.items():
        match = TERM.fullmatch(name)
        assert match is not None  # checked at load
        axis, j, k, power = match.groups()
        if value != 0.0:
            yield DerivativeParams(
                "XYZKMN".index(axis), "uvwpqr".index(j), "uvwpqr".index(k), scale * value, servo if power else "",
                len(power),
            )  # fmt: skip


def _hull(vehicle: VehicleFile, rho: float) -> Iterator[HullParams]:
    hull: Hull = vehicle.hull
    if not isinstance(hull.slow_damping, UnsetType):
        scale = rho / vehicle.damping.reference_density_kgpm3
        slow = hull.slow_damping
        a, b, c, d, e, f = (scale * value for value in slow.diagonal)
        yield HullParams(slow=(a, b, c, d, e, f), fade=1.0 / slow.fading_mps)
    if not isinstance(hull.cross_flow, UnsetType):
        table = hull.cross_flow
        yield HullParams(
            length=table.length_m,
            center=table.center_m,
            strips=table.strips,
            sway=0.5 * rho * table.sway_drag * table.height_m,
            heave=0.5 * rho * table.heave_drag * table.width_m,
            joint=table.joint,
        )
