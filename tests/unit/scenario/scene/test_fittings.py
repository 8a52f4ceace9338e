"""Actuators, sensors and beacons as viewers get them; and the configured errors of sensors as standard deviations of their samples."""

from __future__ import annotations

import math

import msgspec
import pytest

from uwserver.adapter import installed_adapters
from uwserver.modifiers import Bias, GaussMarkov, Quantise, WhiteNoise
from uwserver.ports import ActuatorView
from uwserver.scenario.load.scenario import load
from uwserver.scenario.scene.fittings import actuator_views, beacon_views, sensor_views, sigmas
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.sensors import (
    AcousticModemConfig,
    AdcpConfig,
    AltimeterConfig,
    AttitudeConfig,
    CtdConfig,
    DvlConfig,
    ImuConfig,
    MagnetometerConfig,
    PressureConfig,
    RangeArrayConfig,
    ScanningSonarConfig,
    SoundSpeedConfig,
    UsblConfig,
)
from uwserver.sensors.acoustic.positioning.interrogation import Beacon
from uwserver.sensors.motion.triad import TriadErrors
from uwserver.units import rad


def of(scenario: str, name: str) -> dict[str, ActuatorView]:
    resolved = load(scenario, adapters=installed_adapters())
    vehicle = resolved.vehicles[name]
    params = body_params(vehicle.vehicle, vehicle.devices, resolved.scenario.environment)
    return {view.name: view for view in actuator_views("it", vehicle, params)}


def test_thrusters_have_place_axis_disc_and_their_element_of_the_command() -> None:
    vehicle = load("bluerov2_pool", adapters=installed_adapters()).vehicles["bluerov2"]
    views = of("bluerov2_pool", "bluerov2")
    for k, (name, table) in enumerate(vehicle.vehicle.thrusters.items()):
        view = views[name]
        assert (view.kind, view.p, view.port, view.index) == ("thruster", table.position_frd_m, "it/thrusters", k)
        assert view.axis is not None
        assert sum(c * c for c in view.axis) == pytest.approx(1.0)
        assert view.diameter == vehicle.devices[name].propeller.diameter_m
        assert view.low < 0.0 < view.high
        assert view.unit == "N"


def test_fins_and_propellers_have_their_limits() -> None:
    vehicle = load("remus_survey", adapters=installed_adapters()).vehicles
    name, resolved = next(iter(vehicle.items()))
    views = of("remus_survey", name)
    fins = [view for view in views.values() if view.kind == "fin"]
    assert len(fins) == len(resolved.vehicle.fins) > 0
    for view in fins:
        limit = rad(resolved.vehicle.fins[view.name].limit_deg)
        assert (view.low, view.high, view.unit) == (-limit, limit, "rad")
        assert view.chord is not None
        assert view.span is not None
        assert view.span > 0.0
    (screw,) = (view for view in views.values() if view.kind == "propeller")
    assert (screw.unit, screw.low) == ("rad/s", -screw.high)


def test_a_dvl_has_its_beams_about_the_axis() -> None:
    found = list(
        DvlConfig(rate_hz=8, beam_angle_deg=30.0, beam_azimuth_deg=(0.0, 90.0, 180.0), max_altitude_m=10.0)
        .traits()
        .beams
    )
    assert [beam.direction for beam in found] == [
        pytest.approx((0.5, 0.0, math.sqrt(0.75))), pytest.approx((0.0, 0.5, math.sqrt(0.75))), pytest.approx((-0.5, 0.0, math.sqrt(0.75))),
    ]  # fmt: skip
    assert found[0].far == pytest.approx(10.0 / math.sqrt(0.75)), "it reaches the altitude, along the beam"


def test_a_current_profiler_has_its_slanted_beams_and_its_axial_one() -> None:
    config = AdcpConfig(rate_hz=2, beam_angle_deg=30.0, beam_azimuth_deg=(0.0, 120.0, 240.0), axial_beam=True)
    *slanted, axial = msgspec.structs.replace(config, max_range_m=10.0, blanking_m=1.0).traits().beams
    assert slanted[0].direction == pytest.approx((0.5, 0.0, math.sqrt(0.75)))
    assert len(slanted) == 3
    assert (slanted[0].near, slanted[0].far) == pytest.approx((1.0 / math.sqrt(0.75), 10.0 / math.sqrt(0.75)))
    assert (axial.direction, axial.near, axial.far) == ((0.0, 0.0, 1.0), 1.0, 10.0)


def test_an_altimeter_looks_along_its_z() -> None:
    (beam,) = AltimeterConfig(rate_hz=5, beam_width_deg=6.0, max_range_m=30.0).traits().beams
    assert (beam.direction, beam.far) == ((0.0, 0.0, 1.0), 30.0)
    assert beam.width == pytest.approx(math.pi / 30)


@pytest.mark.parametrize(("count", "angles"), [(1, [0.0]), (3, [-math.pi / 4, 0.0, math.pi / 4])])
def test_a_range_array_has_its_first_ray_to_port(count: int, angles: list[float]) -> None:
    found = list(RangeArrayConfig(rate_hz=5, beams=count, field_of_view_deg=90.0).traits().beams)
    assert [math.atan2(b.direction[1], b.direction[0]) for b in found] == pytest.approx(angles)


def test_a_scanning_sonar_has_a_fan() -> None:
    view = ScanningSonarConfig(rate_hz=5, sector_center_deg=90.0, sector_width_deg=60.0, range_m=20.0).traits().fan
    assert view is not None
    assert view.sector == pytest.approx((math.pi / 3, 2 * math.pi / 3))
    assert view.far == 20.0
    whole = ScanningSonarConfig(rate_hz=5).traits().fan
    assert whole is not None
    assert whole.sector == pytest.approx((-math.pi, math.pi))
    assert PressureConfig(rate_hz=5).traits().fan is None
    assert PressureConfig(rate_hz=5).traits().beams == ()


def test_beacons_stand_in_the_world_or_sit_on_a_vehicle(tiny_file: VehicleFile) -> None:
    beacons = {
        "bottom": Beacon(position_ned_m=(1.0, 2.0, 30.0), turn_around_s=0.1),
        "ship": Beacon(vehicle="ship", position_frd_m=(0.0, 0.0, 2.0)),
    }
    file = msgspec.structs.replace(tiny_file, sensors={"usbl": UsblConfig(rate_hz=1, beacons=beacons)})
    bottom, ship = beacon_views("rov", file)
    assert (bottom.sensor, bottom.p, bottom.body, bottom.delay) == ("rov/usbl", (1.0, 2.0, 30.0), None, 0.1)
    assert (ship.p, ship.body) == ((0.0, 0.0, 2.0), "ship")


def test_a_modem_has_its_address_where_packets_tell_one(tiny_file: VehicleFile) -> None:
    modems = {
        "modem": AcousticModemConfig(rate_hz=1, address=7),
        "caller": AcousticModemConfig(rate_hz=1, address=7, addressed=False, acknowledges=False),
        "depth": PressureConfig(rate_hz=1),
    }
    file = msgspec.structs.replace(tiny_file, sensors=modems)
    found = {view.path: view.address for view in sensor_views("rov", file)}
    assert found == {"rov/modem/received": 7, "rov/caller/received": msgspec.UNSET, "rov/depth": msgspec.UNSET}


def test_white_noise_grows_with_the_rate():
    errors = TriadErrors(noise_density=0.01)
    assert sigmas(ImuConfig(rate_hz=100, gyroscope=errors)) == {"w_S": (pytest.approx(0.1),)}
    assert sigmas(ImuConfig(rate_hz=400, gyroscope=errors)) == {"w_S": (pytest.approx(0.2),)}


def test_errors_add_in_variance():
    errors = TriadErrors(noise_density=0.03, instability=0.618 * 0.4, turn_on=1.2)
    assert sigmas(MagnetometerConfig(rate_hz=1, errors=errors))["field_S"] == (
        pytest.approx(math.sqrt(0.0009 + 0.16 + 1.44)),
    )


def test_modifiers_count():
    modifiers = {
        "a": WhiteNoise(field="pressure", sigma=3.0), "b": GaussMarkov(field="pressure", sigma=4.0, tau_s=10),
        "c": Bias(field="pressure", sigma=12.0), "d": Quantise(field="pressure", step=1.0), "e": WhiteNoise(field="temperature", density=0.1),
    }  # fmt: skip
    found = sigmas(PressureConfig(rate_hz=4, modifiers=modifiers))
    assert found == {"pressure": (pytest.approx(13.0),), "temperature": (pytest.approx(0.2),)}


def test_kinds_with_errors_of_their_own():
    attitude = sigmas(
        AttitudeConfig(rate_hz=10, tilt_sigma_deg=3.0, heading_sigma_deg=12.0, heading_turn_on_deg=3.0, noise_deg=4.0)
    )
    assert [math.degrees(part) for part in attitude["q_NS"]] == pytest.approx([5.0, 5.0, 13.0])
    assert sigmas(AltimeterConfig(rate_hz=10, range_sigma_m=0.02)) == {"range": (0.02,)}
    assert sigmas(SoundSpeedConfig(rate_hz=1, sigma_mps=0.3, accuracy_mps=0.4)) == {
        "sound_speed": (pytest.approx(0.5),)
    }
    assert sigmas(CtdConfig(rate_hz=1, pressure_sigma_Pa=30, pressure_accuracy_Pa=40)) == {
        "pressure": (pytest.approx(50),)
    }


def test_what_is_exact_or_unknown_is_not_told():
    assert sigmas(ImuConfig(rate_hz=100)) == {}
    assert sigmas(ImuConfig(rate_hz=100, ideal=True, gyroscope=TriadErrors(noise_density=0.01))) == {}
    assert sigmas(PressureConfig(rate_hz=100)) == {}
