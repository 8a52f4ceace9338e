"""Parameters: the list, single ones, C-cast values, the packed file over FTP, and bad input."""

from __future__ import annotations

import io
import math

import pytest
from uwserver_adapters.mavlink.vehicle.parameters import (
    BURST,
    CRC,
    LIST,
    NAK,
    OPEN,
    READ,
    SIZE,
    TERMINATE,
    Files,
    Parameters,
    Request,
    parse,
)

mavftp = pytest.importorskip("pymavlink.mavftp")

ASKED_BY_NAME = [
    "FRAME_CONFIG",
    "FS_PILOT_INPUT",
    "FS_PILOT_TIMEOUT",
    "FS_GCS_ENABLE",
    "FS_LEAK_ENABLE",
    "FS_PRESS_ENABLE",
    "FS_PRESS_MAX",
    "FS_TEMP_ENABLE",
    "FS_TEMP_MAX",
    "FS_EKF_ACTION",
    "FS_EKF_THRESH",
    "LEAK1_PIN",
    "LEAK1_LOGIC",
    "ARMING_CHECK",
    "BATT_MONITOR",
    "BATT_CAPACITY",
    "BATT_VOLT_PIN",
    "MNT1_TYPE",
    "COMPASS_DEV_ID",
    "INS_ACCOFFS_X",
    "AHRS_ORIENTATION",
    "MOT_1_DIRECTION",
    "SERVO9_FUNCTION",
    "RC9_OPTION",
    "JS_GAIN_DEFAULT",
    "ATC_RAT_RLL_P",
    "PSC_POSXY_P",
    "WPNAV_SPEED",
] + [f"BTN{k}_{f}FUNCTION" for k in range(16) for f in ("", "S")]


def test_all_come_once_and_in_order(bench):
    station = bench.station()
    station.send("PARAM_REQUEST_LIST", 1, 1)
    bench.run(1.0)
    values = station.of("PARAM_VALUE")
    assert [v.param_index for v in values] == list(range(len(values)))
    assert {v.param_count for v in values} == {len(values)}
    assert set(ASKED_BY_NAME) <= {v.param_id for v in values}
    assert max(len(v.param_id) for v in values) <= 16


def test_a_download_waits_for_a_slow_link(bench):
    station = bench.station()
    station.is_ready = False
    station.send("PARAM_REQUEST_LIST", 1, 1)
    bench.run(1.0)
    assert not station.of("PARAM_VALUE")
    station.is_ready = True
    bench.run(1.0)
    assert len(station.of("PARAM_VALUE")) == len(bench.vehicle.parameters.names)


def test_downloads_of_several_stations(bench):
    stations = [bench.station(255 - k) for k in range(4)]
    for station in stations:
        station.send("PARAM_REQUEST_LIST", 1, 1)
    bench.run(1.0)
    for station in stations:
        assert len(station.of("PARAM_VALUE")) == len(bench.vehicle.parameters.names)


def test_one_by_name_or_index(bench):
    station = bench.station()
    station.send("PARAM_REQUEST_READ", 1, 1, b"FS_PILOT_TIMEOUT", -1)
    by_name = station.last("PARAM_VALUE")
    station.send("PARAM_REQUEST_READ", 1, 1, b"", by_name.param_index)
    assert station.last("PARAM_VALUE").param_id == "FS_PILOT_TIMEOUT"
    assert (by_name.param_value, by_name.param_type) == (3.0, 9)
    count = len(station.of("PARAM_VALUE"))
    for name, index in ((b"NO_SUCH", -1), (b"", 30_000), (b"\xff\xfe", -5)):
        station.send("PARAM_REQUEST_READ", 1, 1, name, index)
    assert len(station.of("PARAM_VALUE")) == count


@pytest.mark.parametrize(
    ("name", "value", "kept", "kind"),
    [
        ("FS_GCS_ENABLE", 3.7, 3.0, 2),  # measured: a real ArduSub makes 3.0 of it, by a cast
        ("JS_LIGHTS_STEPS", -2.9, -2.0, 4),
        ("FS_PRESS_MAX", 105_001.0, 105_001.0, 6),
        ("JS_THR_GAIN", 0.1, 0.10000000149011612, 9),
        ("FS_GCS_ENABLE", 200.0, 2.0, 2),  # beyond its type: as it was
        ("FS_GCS_ENABLE", math.nan, 2.0, 2),
        ("FS_GCS_ENABLE", math.inf, 2.0, 2),
        ("MAV_SYSID", 9.0, 1.0, 4),
    ],
)
def test_setting(bench, name, value, kept, kind):
    setter, other = bench.station(), bench.station(254)
    setter.send("PARAM_SET", 1, 1, name.encode(), value, kind)
    for station in (setter, other):
        answer = station.last("PARAM_VALUE")
        assert (answer.param_id, answer.param_value, answer.param_type, answer.param_index) == (name, kept, kind, 65535)
    is_refused = name == "MAV_SYSID" or not math.isfinite(value) or abs(value - kept) > 1.0
    assert bench.counters["refused"] == is_refused


def test_an_unknown_name_is_met_with_silence(bench):
    station = bench.station()
    station.send("PARAM_SET", 1, 1, b"NO_SUCH", 1.0, 9)
    assert not station.of("PARAM_VALUE")
    assert bench.counters["refused"] == 1


def test_the_table_of_the_scenario():
    assert Parameters({"JS_GAIN_DEFAULT": 0.8}).value("JS_GAIN_DEFAULT") == pytest.approx(0.8)
    with pytest.raises(ValueError, match="NO_SUCH"):
        Parameters({"NO_SUCH": 1.0})


def test_the_packed_file_is_made_once_until_a_parameter_changes(monkeypatch):
    """It takes 0.8 ms, and sixty of a peer's requests for it, or for its checksum, are answered in one go."""
    made = []
    pack = Parameters._pack
    monkeypatch.setattr(Parameters, "_pack", lambda self, defaults: (made.append(defaults), pack(self, defaults))[1])
    parameters = Parameters({})
    served = Files({"p": lambda options: parameters.packed(bool(options))})
    for number in range(60):
        for opcode in (OPEN, CRC):
            (answer,) = served.answer((255, 190), Request(number, 0, opcode, 1, 0, b"p"))
            assert parse(answer).opcode != NAK
    assert made == [False]
    before = parameters.packed(False), parameters.packed(True)
    assert made == [False, True]
    assert parameters.set("JS_GAIN_DEFAULT", 0.25)
    assert (parameters.packed(False), parameters.packed(True)) != before
    assert made == [False, True, False, True]


def test_the_packed_file_is_read_by_pymavlink():
    parameters = Parameters({"JS_GAIN_DEFAULT": 0.8, "FS_GCS_ENABLE": 4})
    for with_defaults in (False, True):
        decoded = mavftp.MAVFTP.ftp_param_decode(parameters.packed(with_defaults))
        assert decoded is not None
        values = {name.decode(): value for name, value, _ in decoded.params}
        assert values == pytest.approx({name: parameters.value(name) for name in parameters.names})
        defaults = {name.decode(): value for name, value, _ in decoded.defaults or []}
        if with_defaults:
            assert defaults["FS_GCS_ENABLE"] == 2


def _ask(files: Files, **fields: object) -> list[Request]:
    wanted = {"seq": 5, "session": 3, "opcode": OPEN, "size": 0, "offset": 0, "data": b"", **fields}
    return [parse(payload) for payload in files.answer((255, 190), Request(**wanted))]  # type: ignore[arg-type]


@pytest.fixture
def files():
    return Files({"a": lambda _: bytes(range(256)) * 40})


def test_a_file_is_read_in_parts_and_in_bursts(files):
    assert _ask(files, data=b"a", size=1)[0].data == (10_240).to_bytes(4, "little")
    assert _ask(files, opcode=READ, offset=100, size=10)[0].data == bytes(range(100, 110))
    content = io.BytesIO()
    offset, bursts = 0, 0
    while True:
        parts = _ask(files, opcode=BURST, size=239, offset=offset)
        if parts[0].opcode == NAK:
            assert parts[0].data == bytes((6,))
            break
        bursts += 1
        assert [p.seq for p in parts] == list(range(6, 6 + len(parts)))
        for part in parts:
            assert part.offset == content.tell()
            content.write(part.data)
        offset = content.tell()
    assert content.getvalue() == bytes(range(256)) * 40
    assert bursts == 3


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"data": b"no such file"}, 10),
        ({"opcode": READ}, 4),
        ({"opcode": BURST, "session": 9}, 4),
        ({"opcode": 6, "data": b"new"}, 7),
        ({"opcode": 77}, 7),
        ({"opcode": LIST, "data": b"/"}, 10),
    ],
)
def test_what_cannot_be_is_refused_at_once(files, fields, reason):
    (answer,) = _ask(files, **fields)
    assert (answer.opcode, answer.data) == (NAK, bytes((reason,)))


def test_sessions_are_bounded_and_each_client_has_its_own(files):
    for session in range(64):
        assert _ask(files, session=session, data=b"a", size=1)[0].opcode == 128
    assert next(iter(files.answer((254, 190), Request(1, 0, READ, 10, 0, b""))))[3] == NAK
    assert next(iter(files.answer((254, 190), Request(1, 0, OPEN, 1, 0, b"a"))))[3] == NAK
    _ask(files, opcode=TERMINATE, session=63)
    assert next(iter(files.answer((254, 190), Request(1, 0, OPEN, 1, 0, b"a"))))[3] == 128


def test_any_payload_is_parsed():
    for size in range(SIZE + 1):
        assert parse(b"\xff" * size).seq <= 0xFFFF


def test_over_mavlink(bench):
    station = bench.station()
    name = b"@PARAM/param.pck?withdefaults=1"
    payload = (1).to_bytes(2, "little") + bytes((0, OPEN, len(name), 0, 0, 0, 0, 0, 0, 0)) + name
    station.send("FILE_TRANSFER_PROTOCOL", 0, 1, 1, list(payload.ljust(251, b"\0")))
    answer = parse(bytes(station.last("FILE_TRANSFER_PROTOCOL").payload))
    assert int.from_bytes(answer.data, "little") == len(bench.vehicle.parameters.packed(True))


@pytest.mark.parametrize(("thrusters", "frame"), [(6, 1), (8, 2), (3, 7)])
def test_the_frame_is_that_of_the_vehicle(make_bench, thrusters, frame):
    assert make_bench(thrusters=thrusters).vehicle.parameters.value("FRAME_CONFIG") == frame


def test_the_rates_of_the_streams_are_parameters(make_bench):
    bench = make_bench(parameters={"MAV1_EXTRA1": 20.0})
    station = bench.station()
    bench.run(1.0)
    assert len(station.of("ATTITUDE")) == 21  # at once, then 20 a second
