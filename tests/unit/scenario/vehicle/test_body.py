"""From a vehicle file to kernel parameters: matrices about the origin, in the scenario's water; thrust curves and lags."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from uwserver.actuators import ActuatorTable, ForceTorqueConfig
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.layout import NEAR_CYLINDER, NEAR_NOTHING, SHAPE_BOX, SHAPE_SPHERE
from uwserver.scenario.vehicle.body import (
    body_params,
    buoyancy_and_weight,
    force_table,
    lag,
    matrices,
    own_actuators,
    own_rows,
    params_by_name,
    thruster_params,
)
from uwserver.scenario.vehicle.tables import LagTable, ThrusterDevice, VehicleFile
from uwserver.scenario.world.tables import Environment

SOURCE = {"source": "x", "status": "guess"}
SEA = Environment(density_kgpm3=1025.0)


def changed(raw: dict[str, Any], **tables: Any) -> VehicleFile:
    return msgspec.convert({**raw, **tables}, VehicleFile)


def test_vehicles_that_differ_in_what_they_sense_alone_have_the_same_parameters(
    raw_vehicle: dict[str, Any], motor: ThrusterDevice
) -> None:
    """So that the rows of a swarm are made once, however its vehicles are written down."""
    tables = {"sensors": {"depth": {"kind": "pressure", "rate_hz": 10}}}
    slower = replace(motor, name="another")
    vehicles = {
        "one": (changed(raw_vehicle), {"left": motor}),
        "again": (changed(raw_vehicle), {"left": motor}),
        "senses": (changed(raw_vehicle, **tables), {"left": motor}),
        "driven": (changed(raw_vehicle), {"left": slower}),
        "heavy": (
            changed(raw_vehicle, rigid_body={**raw_vehicle["rigid_body"], "mass_kg": 99.0}), {"left": motor}
        ),
    }  # fmt: skip
    params = params_by_name(vehicles, SEA)
    assert list(params) == list(vehicles)
    assert params["one"] is params["again"] is params["senses"]
    assert len({id(each) for each in params.values()}) == 3
    assert params["heavy"].weight > 1.5 * params["one"].weight


# -- matrices ---------------------------------------------------------------------------------------------------------------------------


def test_a_body_about_its_centre_of_mass(tiny: VehicleFile) -> None:
    assert pytest.approx(np.diag([10, 10, 10, 0.1, 0.2, 0.3])) == matrices(tiny).M_RB


@pytest.mark.parametrize("about", ["center_of_mass", "origin"])
def test_a_lever_couples_and_adds_to_the_inertia(about: str, raw_vehicle: dict[str, Any]) -> None:
    """10 kg at z = 0.2 m: 0.4 kg m2 about x and y, and m z between surge and pitch. Fossen 2011, eq. 3.44."""
    table = {**raw_vehicle["rigid_body"], "center_of_mass_frd_m": [0, 0, 0.2], "inertia_about": about}
    M = matrices(changed(raw_vehicle, rigid_body=table)).M_RB
    more = 0.4 if about == "center_of_mass" else 0.0
    assert M[3:, 3:] == pytest.approx(np.diag([0.1 + more, 0.2 + more, 0.3]))
    assert M[0, 4] == M[4, 0] == pytest.approx(2.0)
    assert M[1, 3] == M[3, 1] == pytest.approx(-2.0)


def test_a_whole_inertia_matrix_is_taken_as_it_stands(raw_vehicle: dict[str, Any]) -> None:
    inertia = [[1.0, -0.1, 0.2], [-0.1, 2.0, 0.3], [0.2, 0.3, 3.0]]
    table = {**SOURCE, "mass_kg": 10, "inertia_matrix_kgm2": inertia}
    assert matrices(changed(raw_vehicle, rigid_body=table)).M_RB[3:, 3:] == pytest.approx(np.array(inertia))


def test_damping_that_is_not_given_is_none_and_that_at_rest_adds_up(raw_vehicle: dict[str, Any]) -> None:
    linear = {**SOURCE, "diagonal": [5, 6, 7, 0.1, 0.1, 0.1]}
    found = matrices(changed(raw_vehicle, damping={"linear": linear, "at_rest": {**SOURCE, "diagonal": [1] * 6}}))
    assert found.D_L.diagonal() == pytest.approx([6, 7, 8, 1.1, 1.1, 1.1])
    assert not found.D_Q.any()
    assert not found.D_S.any()


def test_a_published_matrix_is_taken_whole(raw_vehicle: dict[str, Any]) -> None:
    matrix = np.arange(36.0).reshape(6, 6)
    found = matrices(changed(raw_vehicle, added_mass={**SOURCE, "matrix": matrix.tolist(), "symmetrise": True}))
    assert pytest.approx(matrix) == found.M_A, "it is made symmetric later"


# -- in the scenario's water ------------------------------------------------------------------------------------------------------------


def test_buoyancy_and_weight(tiny: VehicleFile) -> None:
    buoyancy, weight = buoyancy_and_weight(tiny, Environment(density_kgpm3=1000, gravity_mps2=10))
    assert (buoyancy, weight) == pytest.approx((98.0, 100.0))


def test_added_mass_and_damping_scale_with_the_density(raw_vehicle, motor: ThrusterDevice) -> None:
    added = {**raw_vehicle["added_mass"], "reference_density_kgpm3": 500.0}
    vehicle = changed(raw_vehicle, added_mass=added)
    params = body_params(vehicle, {"left": motor}, Environment(density_kgpm3=1000.0))
    assert params.M_A.diagonal() == pytest.approx([10, 12, 14, 0.2, 0.2, 0.2])
    assert params.D_L.diagonal()[:3] == pytest.approx(np.array([5, 6, 7]) * 1000.0 / 1025.0)
    assert params.M_RB[0, 0] == 10.0
    assert params.displaced == pytest.approx(9.8)


def test_an_added_mass_that_may_be_is_made_symmetric(raw_vehicle, motor: ThrusterDevice) -> None:
    matrix = 5.0 * np.eye(6)
    matrix[0, 4] = 1.0
    vehicle = changed(raw_vehicle, added_mass={**SOURCE, "matrix": matrix.tolist(), "symmetrise": True})
    M_A = body_params(vehicle, {"left": motor}, SEA).M_A
    assert M_A[0, 4] == M_A[4, 0] == pytest.approx(0.5)


def test_shapes_of_the_displaced_volume(raw_vehicle, motor: ThrusterDevice) -> None:
    box = {"kind": "box", "size_m": [0.4, 0.2, 0.1], "center_frd_m": [0.1, 0, 0]}
    shapes = {"box": box, "ball": {"kind": "sphere", "radius_m": 0.3}}
    vehicle = changed(raw_vehicle, buoyancy={**SOURCE, "volume_m3": 0.01, "shapes": shapes})
    first, second = body_params(vehicle, {"left": motor}, SEA).shapes
    assert (first.kind, first.center) == (SHAPE_BOX, (0.1, 0.0, 0.0))
    assert (first.half, first.volume) == (pytest.approx((0.2, 0.1, 0.05)), pytest.approx(0.008))
    assert (second.kind, second.half[0]) == (SHAPE_SPHERE, 0.3)
    assert second.volume == pytest.approx(4.0 / 3.0 * math.pi * 0.027)


# -- thrusters --------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("handedness", "sign"), [("right", -1.0), ("left", 1.0), ("none", 0.0)])
def test_the_propeller_turns_the_vehicle_the_other_way(handedness: Any, sign: float, tiny, motor) -> None:
    device = replace(motor, propeller=replace(motor.propeller, torque_per_force_m=0.02))
    found = thruster_params("left", replace(tiny.thrusters["left"], handedness=handedness), device, 1025.0)
    assert found.torque_per_force == pytest.approx(0.02 * sign)
    assert found.disc_radius == pytest.approx(0.038)


def test_the_voltage_is_the_device_s_unless_given(tiny, motor) -> None:
    assert thruster_params("left", tiny.thrusters["left"], motor, 1025.0).voltage == 16.0
    assert thruster_params("left", replace(tiny.thrusters["left"], voltage_V=12.0), motor, 1025.0).voltage == 12.0


def test_factors_of_the_installation(tiny, motor) -> None:
    device = replace(motor, propeller=replace(motor.propeller, inflow_sqrtN_spm=2.0))
    found = thruster_params(
        "left", replace(tiny.thrusters["left"], installed_factor=0.8, inflow_factor=0.5), device, 1025.0
    )
    assert (found.installed, found.inflow) == (0.8, 1.0)


def test_losses_of_thrust_are_off_unless_asked_for(tiny, motor) -> None:
    plain = thruster_params("left", tiny.thrusters["left"], motor, 1025.0)
    assert (plain.ventilates, plain.cross_loss) == (False, 0.0)
    thruster = replace(tiny.thrusters["left"], ventilates=True, cross_flow_loss_s2pm2=0.35)
    found = thruster_params("left", thruster, motor, 1025.0)
    assert (found.ventilates, found.cross_loss) == (True, 0.35)
    body = body_params(changed_thruster(tiny, thruster), dict.fromkeys(tiny.thrusters, motor), SEA)
    rows = Hydrodynamics([body], 0.01).thrusters
    assert rows["ventilates"].tolist() == [1] + [0] * (len(rows) - 1)
    assert rows["cross_loss"].tolist() == [0.35] + [0.0] * (len(rows) - 1)


def changed_thruster(vehicle: VehicleFile, left: Any) -> VehicleFile:
    return replace(vehicle, thrusters={**vehicle.thrusters, "left": left})


def test_length_and_boundaries_are_those_of_the_file(raw_vehicle, motor: ThrusterDevice) -> None:
    """Without the keys the length is that of the shapes, and the added mass the same everywhere."""
    devices = dict.fromkeys(raw_vehicle.get("thrusters", {}), motor)
    plain = body_params(changed(raw_vehicle), devices, SEA)
    assert (plain.length, plain.near.form) == (None, NEAR_NOTHING)
    near = {**SOURCE, "form": "cylinder", "radius_m": 0.15}
    given = changed(
        raw_vehicle,
        buoyancy={**raw_vehicle["buoyancy"], "length_m": 2.5},
        added_mass={**raw_vehicle["added_mass"], "near_boundary": near},
    )
    found = body_params(given, devices, SEA)
    assert (found.length, found.near.form, found.near.radius) == (2.5, NEAR_CYLINDER, 0.15)
    row = Hydrodynamics([found], 0.01).bodies[0]
    assert (row["strip_half"], row["near_form"], row["near_radius"], row["floor"]) == (
        1.25,
        NEAR_CYLINDER,
        0.15,
        np.inf,
    )


def test_a_stopped_thruster_drags_where_the_damping_has_not_got_it(tiny, motor) -> None:
    """Half the density times the area of a disc of 76 mm and the device's coefficient."""
    device = replace(motor, propeller=replace(motor.propeller, stopped_drag=0.8))
    for included, drag in ((True, 0.0), (False, 0.8 * 0.5 * 1025.0 * math.pi * 0.038**2)):
        thruster = replace(tiny.thrusters["left"], damping_includes_stopped=included)
        assert thruster_params("left", thruster, device, 1025.0).drag == pytest.approx(drag)


def test_the_force_curve_runs_from_full_astern_to_full_ahead(motor) -> None:
    (voltage,), (curve,) = (force_table(motor).voltages, force_table(motor).curves)
    commands, forces = zip(*curve, strict=True)
    assert voltage == 16.0
    assert (commands[0], forces[0]) == (-1.0, pytest.approx(-40.0))
    assert (commands[-1], forces[-1]) == (1.0, pytest.approx(50.0))
    assert (np.diff(commands) > 0.0).all()
    assert (np.diff(forces) >= 0.0).all()
    assert [f for c, f in curve if -0.07 <= c <= 0.07] == [0.0, 0.0]


def test_between_dead_band_and_full_command_the_shape_holds(motor) -> None:
    """v + 2 v^3 over its value at 1, v = 0 at the edge of the dead band."""
    (curve,) = force_table(motor).curves
    for command, force in curve[-10:]:
        v = (command - 0.07) / 0.93
        assert force == pytest.approx(50.0 * (v + 2.0 * v**3) / 3.0)


def test_curves_are_in_rising_order_of_voltage(motor) -> None:
    first = motor.curves["v16"]
    table = force_table(replace(motor, curves={"b": first, "a": replace(first, voltage_V=12.0, max_forward_N=30.0)}))
    assert table.voltages == (12.0, 16.0)
    assert [curve[-1][1] for curve in table.curves] == pytest.approx([30.0, 50.0])


# -- lags -------------------------------------------------------------------------------------------------------------------------------


def lag_of(**keys: Any) -> Any:
    return lag(msgspec.convert({**SOURCE, **keys}, LagTable))


def test_a_transfer_function_is_normalised_and_padded() -> None:
    short = lag_of(numerator=[4.0], denominator=[2.0, 4.0, 6.0, 8.0])
    assert short == lag_of(numerator=[0.0, 0.0, 2.0], denominator=[1.0, 2.0, 3.0, 4.0])
    assert short != lag_of(numerator=[2.0, 0.0, 0.0], denominator=[1.0, 2.0, 3.0, 4.0])


def test_a_time_constant_is_a_lag_of_first_order() -> None:
    assert lag_of(time_constant_s=0.1) != lag_of(time_constant_s=0.2)
    assert lag_of(time_constant_s=0.1) == lag_of(time_constant_s=0.1)


@pytest.mark.parametrize(
    ("numerator", "denominator"), [([1.0], [1.0, 2.0]), ([1.0] * 4, [1.0] * 4), ([1.0], [0.0, 1.0, 1.0, 1.0])]
)
def test_other_orders_are_refused(numerator: list[float], denominator: list[float]) -> None:
    with pytest.raises(ValueError, match="needs 4 denominator and at most 3 numerator coefficients"):
        lag_of(numerator=numerator, denominator=denominator)


# -- rows -------------------------------------------------------------------------------------------------------------------------------


class OwnConfig(ActuatorTable, tag="own", kw_only=True, frozen=True):
    """A kind of an extension."""


def test_each_actuator_of_an_extension_has_a_wrench_of_its_own(tiny, motor) -> None:
    vehicle = replace(tiny, actuators={"push": ForceTorqueConfig(), "one": OwnConfig(), "two": OwnConfig()})
    assert list(own_actuators(vehicle)) == ["one", "two"]
    params = body_params(vehicle, {"left": motor}, SEA)
    assert params.wrenches == 3
    hydro = Hydrodynamics((), 0.01)
    for first in (0, 3):  # the second vehicle's rows come after those of the first
        bodies = own_rows(hydro, vehicle, hydro.add(params))
        assert {name: body.wrench for name, body in bodies.items()} == {"": first, "one": first + 1, "two": first + 2}
        assert {body.row for body in bodies.values()} == {first // 3}
        assert bodies["one"].thrusters == {"left": first // 3}
    assert len(hydro.wrenches) == 6


def test_a_vehicle_of_shipped_kinds_has_one(tiny, motor) -> None:
    params = body_params(tiny, {"left": motor}, SEA)
    assert params.wrenches == 1
    assert list(own_rows(Hydrodynamics([params], 0.01), tiny, 0)) == [""]
