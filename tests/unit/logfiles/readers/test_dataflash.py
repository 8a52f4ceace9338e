"""Dataflash logs of ArduPilot, against pymavlink's own reader."""

import numpy as np
import pytest
from bin_rig import dive
from pymavlink.DFReader import DFReader_binary

from uwserver.logfiles import LogError
from uwserver.logfiles.readers.dataflash import layout_of


def by_pymavlink(file):
    reader = DFReader_binary(str(file))
    found = []
    while (m := reader.recv_msg()) is not None:
        if m.get_type() != "FMT":
            value = m.to_dict()
            value.pop("mavpackettype")
            found.append((m.get_type(), {k: list(v) if k == "Data" else v for k, v in value.items()}))
    reader.close()
    return found


def test_every_record_is_that_of_pymavlink(opened, tmp_path):
    log = opened(dive(), "dive.bin")
    ours = [(d.topic.partition("[")[0], dict(d.value)) for d in log.read()]
    theirs = by_pymavlink(tmp_path / "dive.bin")
    assert len(ours) == len(theirs) > 600
    assert ours == theirs


def test_topics_units_and_time(opened):
    log = opened(dive(), "dive.bin")
    assert {"ATT", "XKF1[0]", "XKF1[1]", "GPS"} <= set(log.topics)
    fields = {f.name: f.unit for f in log.topics["XKF1[1]"].fields}
    assert (fields["PD"], fields["VN"], fields["TimeUS"], fields["C"]) == ("m", "m/s", "us", "")
    assert {f.name: f.unit for f in log.topics["ATT"].fields}["Yaw"] == "deg"
    assert [d.value["PD"] for d in log.read({"XKF1[1]"})] == [3.0] * 200
    # The first fix: GPS week 2300, 1 s, at 1.00202 s of a clock whose first record is at 0.0001 s.
    gps = 315_964_800 + 2300 * 604_800 + 1 - 18
    assert log.epoch_ns == gps * 1_000_000_000 - 1_001_920_000
    assert log.remarks == ()


def test_flash_pages_end_in_padding_and_damage_is_told(opened):
    raw = dive()
    log = opened(raw + b"\xff" * 200, "dive.bin")
    assert log.remarks == ()
    log = opened(raw[:3000] + b"what is this" + raw[3000:], "dive.bin")
    assert "no record and were skipped" in log.remarks[0]


def test_truncation_anywhere(opened):
    raw = dive(2)
    whole = list(opened(raw, "dive.bin").read())
    begin = raw.index(b"ArduSub") + 80
    for cut in range(begin, len(raw), 13):
        some = list(opened(raw[:cut], "dive.bin").read())
        assert some == whole[: len(some)]
        assert len(some) >= 1


def test_flipped_bytes_never_crash(opened):
    raw = dive(2)
    rng = np.random.default_rng(2)
    for _ in range(200):
        hurt = bytearray(raw)
        for at in rng.integers(3, len(raw), 6):
            hurt[at] = int(rng.integers(0, 256))
        try:
            times = [d.t_ns for d in opened(bytes(hurt), "dive.bin").read()]
        except LogError:
            continue
        assert times == sorted(times)


@pytest.mark.parametrize(
    ("length", "letters", "columns"),
    [(12, "Qf", "TimeUS,A"), (15, "Qf", "TimeUS"), (15, "Q?", "TimeUS,A"), (15, "Qf", "A,A"), (3, "", "")],
)
def test_a_layout_that_contradicts_itself_is_none(length, letters, columns):
    assert layout_of("XYZ", length, letters, columns) is None
    assert layout_of("XYZ", 15, "Qf", "TimeUS,A") is not None


def test_no_record_at_all(opened):
    with pytest.raises(LogError, match="not a dataflash log"):
        opened(b"\xa3\x95\x80" + b"\0" * 20, "x.bin")
