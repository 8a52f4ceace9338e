"""Sentences: what a real library reads of them, the standard's own examples, rates, logs, garbage."""

from __future__ import annotations

import math
from datetime import date
from typing import Any

import pynmea2
import pytest
from devices_rig import ALTIMETER, ATTITUDE, DEPTH, DVL, GPS, LOCKED, LOST, ask, make_context, sample
from uwserver_adapters.devices.nmea0183 import (
    LINE_LIMIT,
    Nmea0183,
    Nmea0183Table,
    degrees_minutes,
    is_sentence,
    sentence,
)

from uwserver.adapter import CannotServe
from uwserver.testing import CodecCase, check_codec

FIX = (math.radians(-33.8567844), math.radians(151.2152967), 12.25, (1.0, -1.0, 0.1), 9, 3)
ALL = {
    "gps": "rov/gps",
    "heading": "rov/attitude",
    "altimeter": "rov/ping",
    "speed_log": "rov/dvl",
    "temperature": "rov/depth",
}


def make(**keys: Any) -> Nmea0183:
    return Nmea0183Table(udp_to=("127.0.0.1:10110",), **keys).build(make_context())


def read(messages: list[bytes]) -> dict[str, Any]:
    """By kind, as pynmea2 reads them, checksums required."""
    assert all(message.endswith(b"\r\n") and len(message) <= 82 for message in messages)
    return {said.sentence_type: said for said in (pynmea2.parse(m.decode(), check=True) for m in messages)}


def test_a_checksum_is_that_of_the_standards_example():
    assert (
        sentence("GPGLL", ("5057.970", "N", "00146.110", "E", "142451", "A"))
        == b"$GPGLL,5057.970,N,00146.110,E,142451,A*27\r\n"
    )


def test_minutes_never_reach_sixty():
    assert degrees_minutes(math.radians(12.0 + 59.999999 / 60), 2) == "1300.00000"
    assert degrees_minutes(math.radians(-0.5), 3) == "00030.00000"


def test_a_receiver_is_read_by_a_real_library():
    said = read(make(gps="rov/gps").see(sample(GPS, FIX, 3661.25)))
    assert set(said) == {"GGA", "RMC", "VTG", "GLL", "ZDA"}
    for kind in ("GGA", "RMC", "GLL"):
        assert said[kind].latitude == pytest.approx(-33.8567844, abs=2e-7)
        assert said[kind].longitude == pytest.approx(151.2152967, abs=2e-7)
    assert (said["GGA"].gps_qual, int(said["GGA"].num_sats), said["GGA"].altitude) == (1, 9, 12.25)
    assert said["GGA"].timestamp.strftime("%H:%M:%S.%f") == "01:01:01.250000"
    assert (said["RMC"].datestamp, said["RMC"].status) == (date(2024, 1, 1), "A")
    assert float(said["RMC"].spd_over_grnd) == pytest.approx(math.sqrt(2.0) * 3600 / 1852, abs=1e-3)
    assert float(said["RMC"].true_course) == 315.0
    assert float(said["VTG"].spd_over_grnd_kmph) == pytest.approx(math.sqrt(2.0) * 3.6, abs=1e-3)
    assert (said["ZDA"].year, said["ZDA"].month, said["ZDA"].day) == (2024, 1, 1)


def test_without_a_fix_no_position_is_told():
    lost = (None, None, None, (None, None, None), 0, 0)
    said = read(make(gps="rov/gps").see(sample(GPS, lost, valid=False)))
    assert (said["GGA"].gps_qual, said["GGA"].lat, said["RMC"].status, said["GLL"].status) == (0, "", "V", "V")


def test_compass_sounder_log_and_thermometer():
    device = make(**ALL, transducer_offset_m=0.4)
    assert float(read(device.see(sample(ATTITUDE, ((1.0, 0.0, 0.0, 0.0), 1.5))))["HDT"].heading) == pytest.approx(85.94)
    said = read(device.see(sample(ALTIMETER, (10.0, 0.9))))
    assert (float(said["DPT"].depth), float(said["DPT"].offset)) == (10.0, 0.4)
    assert (float(said["DBT"].depth_meters), float(said["DBT"].depth_feet)) == (10.0, 32.81)
    assert float(said["DBT"].depth_fathoms) == 5.47
    said = read(device.see(sample(DVL, (*LOCKED[:-1], (0.3, -0.2, 0.0)))))
    assert float(said["VBW"].lon_water_spd) == pytest.approx(0.3 * 3600 / 1852, abs=1e-3)
    assert float(said["VBW"].lon_grnd_spd) == pytest.approx(0.5 * 3600 / 1852, abs=1e-3)
    assert float(said["VBW"].trans_water_spd) == pytest.approx(-0.2 * 3600 / 1852, abs=1e-3)
    assert float(said["VBW"].trans_grnd_spd) == pytest.approx(0.1 * 3600 / 1852, abs=1e-3)
    assert said["VBW"].data_validity_grnd_spd == "A"
    assert float(read(device.see(sample(DEPTH, (3.0, 11.5))))["MTW"].temperature) == 11.5


def test_a_heading_just_below_north_is_no_360():
    said = read(make(heading="rov/attitude").see(sample(ATTITUDE, ((1.0, 0.0, 0.0, 0.0), 2 * math.pi - 1e-6))))
    assert said["HDT"].heading == 0.0


def test_the_log_counts_the_way_through_water_and_over_ground():
    device = make(speed_log="rov/dvl", rate_hz=10)
    for i in range(10001):
        last = device.see(sample(DVL, LOCKED, i / 10))
    # Total and trip through the water, total and trip over ground.
    water, ground = 0.3 * 1000 / 1852, math.hypot(0.5, 0.1) * 1000 / 1852
    told = [float(number) for number in pynmea2.parse(last[1].decode()).data[::2]]
    assert told == pytest.approx([water, water, ground, ground], abs=1e-3)
    device.reset()
    told = [float(number) for number in pynmea2.parse(device.see(sample(DVL, LOCKED, 0.0))[1].decode()).data[::2]]
    assert told == pytest.approx([water, 0.0, ground, 0.0], abs=1e-3)


def test_a_log_without_lock_says_so_and_a_sounder_without_echo_nothing():
    device = make(**ALL)
    vbw = read(device.see(sample(DVL, LOST, valid=False)))["VBW"]
    assert (vbw.data_validity_grnd_spd, vbw.lon_grnd_spd, vbw.data_validity_water_spd) == ("V", None, "V")
    assert device.see(sample(ALTIMETER, (None, None), valid=False)) == []


def test_rate_and_choice():
    device = make(gps="rov/gps", sentences=("GGA",), rate_hz=2)
    messages = [device.see(sample(GPS, FIX, i / 5)) for i in range(51)]
    assert sum(map(len, messages)) == 21
    assert {kind for some in messages for kind in read(some)} == {"GGA"}


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({}, "no sensor is named"),
        ({"gps": "rov/gps", "sentences": ("HDT",)}, "HDT needs a sensor: give heading"),
        ({"gps": "rov/dvl"}, 'gps: "rov/dvl" has no field "latitude"'),
    ],
)
def test_a_table_that_does_not_fit_is_told(keys: dict[str, Any], text: str):
    with pytest.raises(CannotServe, match=text):
        make(**keys)


def test_sentences_of_peers_are_let_pass_and_garbage_is_counted():
    good = sentence("GPHDT", ("1.0", "T"))
    assert ask(make(gps="rov/gps"), good) == ([], [])
    garbage = (b"hello\n", b"$GPHDT,1.0,T*00\r\n", b"$*00\r\n", b"\xff\xfe\x00\n", b"$" + b"A" * LINE_LIMIT + b"*00\n")
    for junk in garbage[:4]:
        assert len(ask(make(gps="rov/gps"), junk + good)[1]) == 1
    assert is_sentence(good.strip())
    check_codec(
        make(gps="rov/gps").reader,
        [CodecCase("hdt", good, (good.strip(),))],
        need_data=None,
        garbage=garbage,
        resynchronises=True,
    )
