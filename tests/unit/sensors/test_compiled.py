"""Sensors as rows of the same arrays: each reads as it would alone, whoever else is due; what it remembers goes with it, and can be told and set."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from sensor_rig import MOUNT, at, started

from uwserver.modifiers import Measurement
from uwserver.modifiers.columns import Columns
from uwserver.physics.kernel.arrays import Pool
from uwserver.physics.kernel.random import draw_normals, key_of
from uwserver.ports import Field, Refused
from uwserver.sensors import (
    AdcpConfig,
    AltimeterConfig,
    DvlConfig,
    GpsConfig,
    ImuConfig,
    Pose,
    ProfilerConfig,
    RangeArrayConfig,
    ScanningSonarConfig,
    Sensor,
    SoundSpeedConfig,
)
from uwserver.sensors.acoustic.altimeter import AltimeterMemory
from uwserver.sensors.compiled import HEAD, read
from uwserver.sensors.motion.triad import TriadErrors
from uwserver.sensors.surroundings import ScopeArrays
from uwserver.sensors.water.sound_speed import SoundSpeedMemory
from uwserver.testing.fake_geometry import FakeGeometry, Plane
from uwserver.testing.sensors import BOTTOM

NOISY = SoundSpeedConfig(rate_hz=10, accuracy_mps=0.5, sigma_mps=0.1)
ECHO = AltimeterConfig(rate_hz=10, max_range_m=60.0)


class Together:
    """Sensors of one kind in shared arrays, as in a world."""

    def __init__(self, sensors):
        self.sensors, self.kernel = sensors, sensors[0].kernel
        self.heads, self.rows, self.numbers = Pool(HEAD, 1), Pool(self.kernel.record, 1), Pool(np.float64, 1)
        for sensor in sensors:
            sensor.enter(self.heads, self.rows)
            columns = Columns(sensor.fields)
            first = self.numbers.take(columns.width)
            head = self.heads.rows[sensor.head]
            head["first"], head["width"], head["dt"] = first, columns.width, sensor.dt

    def read(self, scope, due):
        """Validity, times and values of those that are due, in their order; None of those that have no reading."""
        there = ScopeArrays(scope)
        heads = np.array([self.sensors[k].head for k in due])
        arrays = self.heads.rows, self.rows.rows, self.numbers.rows
        read(self.kernel, *arrays, heads, there.table, scope.t, scope.geometry)
        return [self._told(self.sensors[k]) for k in due]

    def _told(self, sensor):
        head, columns = self.heads.rows[sensor.head], Columns(sensor.fields)
        if not head["ready"]:
            return None
        row = self.numbers.rows[head["first"] : head["first"] + head["width"]]
        return bool(head["valid"]), int(head["delay_ns"]), columns.unpack(row)


def told(reading):
    return None if reading is None else (reading.valid, reading.delay_ns, tuple(reading.values))


def several(config, count=4):
    """Sensors of one kind, each of another path and at another place."""
    made = []
    for k in range(count):
        sensor = config.build(Pose((0.1 * k, 0.0, 0.2 * k), MOUNT.q if k == 1 else (1.0, 0.0, 0.0, 0.0)))
        sensor.dt = 1.0 / config.rate_hz
        sensor.start(key_of(1, f"rov/s{k}"))
        made.append(sensor)
    return made


@pytest.mark.parametrize(
    "config",
    [
        NOISY,
        ECHO,
        DvlConfig(rate_hz=5),
        AdcpConfig(rate_hz=2, cells=12, axial_beam=True, pings=3, scale_sigma=0.01, heading_sigma_deg=1.0),
        ImuConfig(rate_hz=100, gyroscope=TriadErrors(noise_density=1e-3, turn_on=0.1)),
        RangeArrayConfig(rate_hz=5, beams=9, field_of_view_deg=90, max_range_m=60, sigma_m=0.1, loss_probability=0.2),
        ProfilerConfig(rate_hz=5, range_m=30.0, sector_width_deg=60.0, sector_center_deg=45.0),
        ScanningSonarConfig(rate_hz=5, range_m=40.0, bins=64, step_deg=9.0),
    ],
    ids=lambda config: config.__struct_config__.tag,
)
@pytest.mark.parametrize("due", [[0, 1, 2, 3], [3, 1, 0, 2], [2]], ids=str)
def test_each_reads_as_it_would_alone(scope, config, due):
    together, alone = Together(several(config)), several(config)
    for step in range(3):
        instant = at(scope, float(step), p_NB=(1.0, 2.0, 5.0 + step), v_NB_B=(0.5, 0.1, -0.2), geometry=BOTTOM)
        for sensor in together.sensors:
            sensor.begin(step)
        expected = [told(alone[k].sense(instant)) for k in due]
        assert None not in expected
        assert together.read(instant, due) == expected
        for k in due:
            assert together.sensors[k].memory == alone[k].memory


def test_rays_are_those_of_the_sensor_though_one_among_them_is_silent(scope):
    together, alone = Together(several(ECHO)), several(ECHO)
    together.heads.rows["silent"][together.sensors[1].head] = 1
    instant = at(scope, 0.0, geometry=BOTTOM)
    readings = together.read(instant, [0, 1, 2, 3])
    assert readings[1] is None
    assert [readings[k] for k in (0, 2, 3)] == [told(alone[k].sense(instant)) for k in (0, 2, 3)]
    assert len({reading[2] for reading in readings if reading}) == 3


def test_one_that_sees_farther_beside_it_does_not_lengthen_its_range(scope):
    """Rays of all are cast together."""
    both = Together([started(RangeArrayConfig(rate_hz=10, beams=3, max_range_m=r), mount=Pose()) for r in (4.0, 20.0)])
    wall = FakeGeometry([Plane((6.0, 0.0, 0.0), (-1.0, 0.0, 0.0))])
    told_ranges = [ranges for _, _, (ranges,) in both.read(at(scope, 0.0, geometry=wall), [0, 1])]
    assert told_ranges == [(None,) * 3, (5.0,) * 3]


class Drawn(Sensor):
    """What it draws, and nothing else."""

    doc, fields = "Chance.", (Field("chance", "1", "drawn"),)

    def sense(self, scope):
        return Measurement([float(self.rng.standard_normal())], True)


def test_the_numbers_of_a_reading_are_those_of_its_number_alone(scope):
    """Of a kind in compiled code, and of one in plain Python."""
    instant = at(scope, 1.0)
    for made in (lambda: started(NOISY), Drawn):
        one, other = made(), made()
        for number in range(5):
            one.begin(number)
            one.sense(instant)
        other.begin(7)
        one.begin(7)
        seventh = told(one.sense(instant))
        assert told(other.sense(instant)) == seventh
        one.begin(8)
        assert told(one.sense(instant)) != seventh


def test_what_is_drawn_once_a_run_is_that_of_the_path():
    expected = 0.5 * draw_normals(key_of(1, "rov/x"), 1)[0]
    sensor = started(NOISY)
    assert sensor.memory == SoundSpeedMemory(offset=expected)
    sensor.memory = SoundSpeedMemory(offset=3.0)
    sensor.start(key_of(1, "rov/x"))
    assert sensor.memory == SoundSpeedMemory(offset=expected)


def test_who_is_switched_on_again_remembers_nothing(scope):
    sensor = started(ECHO)
    sensor.sense(at(scope, 5.0, geometry=BOTTOM))
    sensor.start(key_of(1, "rov/x"))
    assert sensor.memory == AltimeterMemory()
    assert sensor.heads.rows["number"][sensor.head] == 0


def test_a_reading_alone_goes_on_with_the_next_number(scope):
    one, other = started(NOISY), started(NOISY)
    instant = at(scope, 1.0)
    for number in range(3):
        other.begin(number)
        assert told(one.sense(instant)) == told(other.sense(instant))


def test_it_takes_what_it_remembers_with_it(scope):
    sensor = started(ECHO)
    sensor.sense(at(scope, 5.0, geometry=BOTTOM))
    ready = sensor.memory.ready
    assert ready > 5.0
    heads, rows = Pool(HEAD, 1), Pool(sensor.kernel.record, 1)
    heads.take(3)
    sensor.enter(heads, rows)
    assert (sensor.head, sensor.memory) == (3, AltimeterMemory(ready=ready))
    rows.rows["m"]["ready"][sensor.row] = ready + 1.0
    sensor.leave()
    assert sensor.memory == AltimeterMemory(ready=ready + 1.0)
    assert (heads.take(1), rows.take(1)) == (3, 0)  # its places are free again
    assert sensor.sense(at(scope, ready + 0.5, geometry=BOTTOM)) is None  # and it waits as long as it should


def test_a_nested_memory_is_told_and_set():
    config = ImuConfig(rate_hz=100, gyroscope=TriadErrors(instability=0.1, turn_on=0.2, scale=0.01))
    one, other = started(config, seed=1), started(config, seed=2)
    assert one.memory != other.memory
    assert one.memory.gyroscope.turn_on != (0.0, 0.0, 0.0)
    other.memory = one.memory
    assert other.memory == one.memory


def test_a_record_beyond_the_limits_is_no_memory():
    """It may come from a file."""
    sensor = started(ECHO)
    row = np.zeros((), sensor.kernel.record["m"])
    for ready in (np.nan, -2.0, 1e18):
        row["ready"] = ready
        with pytest.raises(msgspec.ValidationError):
            sensor.memory_of(row)


def test_a_setting_acts_at_the_next_reading_and_a_refused_one_not_at_all(scope):
    instant = at(scope, 0.0, p_NB=(0.0, 0.0, 5.0), geometry=BOTTOM)
    dvl = started(DvlConfig(rate_hz=5, beam_sigma_mps=0.0), mount=Pose())
    assert dvl.sense(instant).valid
    with pytest.raises(Refused):
        dvl.change({"max_altitude": 10.0, "range_mode": 3})
    assert dvl.sense(instant).valid
    dvl.change({"max_altitude": 10.0})
    assert not dvl.sense(instant).valid  # the bottom is 25 m away


def test_it_reads_nothing_while_it_is_not_ready(scope):
    gps = started(GpsConfig(rate_hz=5), mount=Pose())
    below = gps.sense(at(scope, 0.0, p_NB=(0.0, 0.0, 5.0)))
    assert below is not None
    assert below.valid is False
    echo = started(ECHO)
    assert echo.sense(at(scope, 0.0, geometry=BOTTOM)) is not None
    assert echo.sense(at(scope, 1e-3, geometry=BOTTOM)) is None
    assert echo.measure(at(scope, 2e-3, geometry=BOTTOM)) == (False, [None] * len(echo.fields))
