"""Sensors and beacons, as viewers get them."""

from __future__ import annotations

import math

import msgspec
import pytest

from uwserver.scenario.scene.senses import beacon_views, sensor_views
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.sensors import (
    AcousticModemConfig,
    AdcpConfig,
    AltimeterConfig,
    DvlConfig,
    PressureConfig,
    RangeArrayConfig,
    ScanningSonarConfig,
    UsblConfig,
)
from uwserver.sensors.acoustic.positioning.interrogation import Beacon


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
    import msgspec

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
