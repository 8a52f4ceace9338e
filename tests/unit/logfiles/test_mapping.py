"""Mappings: their file, and what it refuses."""

from pathlib import Path

import pytest

from uwserver.logfiles import LogError
from uwserver.logfiles.mapping import Origin, mapping_text, parse_mapping, read_mapping
from uwserver.logfiles.si import scale_of

TEXT = """
format = "uwserver-log-mapping-1"
[origin]
latitude_deg = 60.0
longitude_deg = 10.0
[tracks.rov]
position = { topic = "a", north = "n", east = { field = "e", topic = "b", unit = "cm", scale = -1.0 }, depth = "d" }
attitude = { topic = "q", unit = "deg", yaw = "heading", where = { C = 0 } }
velocity = { topic = "v", forward = "u", left = "v", up = "w" }
[ports."rov/dvl"]
topic = "dvl"
fields.v_S = ["x", { field = "y", scale = -1.0 }, "z"]
fields.altitude = { field = "range", unit = "mm" }
"""


def test_what_is_written_is_read_again():
    mapping = parse_mapping(TEXT)
    assert mapping.origin == Origin(60.0, 10.0)
    written = mapping_text(mapping)
    assert parse_mapping(written) == mapping
    assert 'unit = "m"' in written
    assert 'axes = "NED/FRD"' in written


def test_the_mapping_of_the_how_to():
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "logs.md").read_text(encoding="utf-8")
    mapping = parse_mapping(page.split("```toml\n")[1].split("```")[0])
    assert set(mapping.tracks) == {"filter", "robot", "boat"}
    assert set(mapping.ports) == {"rov/pressure"}


TRACK = 'format = "uwserver-log-mapping-1"\n[tracks.rov]\n'
NED = 'position = { topic = "a", north = "n", east = "e" }\n'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('format = "2"', 'format "2"'),
        (TRACK + 'position = { topic = "a", north = "n" }', "tracks.rov.position: give north and east"),
        (
            TRACK + 'position = { north = "n", east = "e" }',
            "tracks.rov.position.north: give the topic, here or in the section",
        ),
        (
            TRACK + 'position = { topic = "a", north = "n", east = "e", up = "u", down = "d" }',
            "one of down, depth, up, altitude, not 2",
        ),
        (TRACK + 'position = { topic = "a", north = "n", east = "e", unit = "meter" }', 'no unit "meter"'),
        (TRACK + 'position = { topic = "a", nord = "n" }', "nord"),
        (TRACK + NED + 'attitude = { topic = "q", w = "w" }', "give w, x, y and z, or yaw"),
        (TRACK + NED + 'attitude = { topic = "q", yaw = "w", axes = "NWU" }', "NWU"),
        (TRACK + NED + 'velocity = { topic = "q", forward = "u", up = "w" }', "one of right, left"),
        (TRACK + NED + 'velocity = { topic = "q", up = "w" }', "give north and east, or forward"),
        ('[ports.x]\ntopic = "a"\nfields.p = { field = "p", unit = "barn" }', "ports.x.p: no unit"),
        ("a = [", "."),
        ("a = " + "[" * 5000, "."),
    ],
)
def test_mistakes_are_told_with_their_place(tmp_path, text, told):
    file = tmp_path / "m.toml"
    file.write_text(text)
    with pytest.raises(LogError) as error:
        read_mapping(file)
    assert told in str(error.value)
    assert "m.toml" in str(error.value)


def test_files_that_are_no_mapping(tmp_path):
    with pytest.raises(LogError, match="No such file"):
        read_mapping(tmp_path / "gone.toml")
    big = tmp_path / "big.toml"
    big.write_bytes(b"\xff" * (1 << 21))
    with pytest.raises(LogError, match="not a mapping"):
        read_mapping(big)
    big.write_bytes(b"\xff\xfe")
    with pytest.raises(LogError, match="big"):
        read_mapping(big)


@pytest.mark.parametrize(
    ("unit", "number", "si"),
    [
        ("deg", 180.0, 3.141592653589793), ("degE7", 900_000_000.0, 1.5707963267948966), ("hPa", 1013.25, 101_325.0),
        ("mG", 1000.0, 9.80665), ("kn", 1.0, 0.5144444444), ("K", 273.15, 0.0), ("degF", 212.0, 100.0), ("rpm", 60.0, 6.283185307),
        ("cdegC", 1250.0, 12.5), ("", 3.0, 3.0),
    ],
)  # fmt: skip
def test_units(unit, number, si):
    scale = scale_of(unit)
    assert number * scale.factor + scale.offset == pytest.approx(si, abs=1e-9)
