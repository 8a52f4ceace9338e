"""Samples of ports in our names, axes and units."""

import math

from logs_made import MadeLog

from uwserver.logfiles.mapping import parse_mapping
from uwserver.logfiles.ports import port_samples

MAPPING = parse_mapping("""
[ports."rov/pressure"]
topic = "P"
where = { id = 2 }
fields.pressure = { field = "press_abs", unit = "hPa" }
[ports."rov/dvl"]
topic = "V"
fields.v_S = [{ field = "v.0", unit = "cm/s" }, { field = "v.1", unit = "cm/s", scale = -1.0 }, "w"]
fields.name = "name"
""")


def test_values_are_converted():
    log = MadeLog("csv", [(1, "P", {"press_abs": 1000.0, "id": 2}), (2, "P", {"press_abs": 1.0, "id": 1}),
                          (3, "V", {"v": [100, 50], "w": 2.5, "name": "a"})])  # fmt: skip
    assert [tuple(d) for d in port_samples(log, MAPPING)] == [
        (1, "rov/pressure", {"pressure": 100_000.0}),
        (3, "rov/dvl", {"v_S": (1.0, -0.5, 2.5), "name": "a"}),
    ]
    assert [d.topic for d in port_samples(log, MAPPING, {"rov/dvl"})] == ["rov/dvl"]
    assert list(port_samples(log, MAPPING, start_ns=2, end_ns=2)) == []


def test_what_is_no_number_is_none_and_an_empty_sample_is_none_at_all():
    log = MadeLog("csv", [(1, "P", {"press_abs": math.nan, "id": 2}), (2, "P", {"press_abs": 10**400, "id": 2}),
                          (3, "V", {"v": [], "w": 2.5})])  # fmt: skip
    assert [tuple(d) for d in port_samples(log, MAPPING)] == [(3, "rov/dvl", {"v_S": (None, None, 2.5), "name": None})]
