"""Why a port has no message of its own in an exported log."""

from __future__ import annotations

from uwserver.logfiles.export.left_out import left_out
from uwserver.logfiles.mapping import Mapping, PortSource


def ports(**fields: tuple[str, ...]) -> Mapping:
    return Mapping(ports={name: PortSource("t", {field: field for field in each}) for name, each in fields.items()})


def test_a_port_whose_samples_were_never_valid_is_told_apart_from_one_that_has_no_message():
    mapping = ports(altimeter=("range",), sonar=("range", "head_angle"), imu=("f_S", "w_S"), half=("latitude",))
    assert left_out(mapping, {"imu"}) == [
        "left out, because no message fits: sonar, half",
        "left out, because no sample was valid: altimeter",
    ]


def test_nothing_is_told_where_all_were_written():
    assert left_out(ports(imu=("f_S", "w_S")), {"imu"}) == []
