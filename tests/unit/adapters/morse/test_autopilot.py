"""Lines of ArduPilot's MORSE backend: sensors as its reader looks for them, pulse widths as it writes them."""

import math
import re

import pytest
from uwserver_adapters.morse.autopilot import pulses, sensors

from uwserver.frames import quat_from_rpy
from uwserver.ports import Refused

# The text of SIM_Morse.cpp's output_pwm, with its letters too much.
FORM = (
    b'{"pwm": [%u, %uf, %u, %u, %u, %uf, %u, %u, %u, %uf, %u, %u, %u, %uf, %u, %u]}'.replace(b"%u", b"%d")
)  # fmt: skip


def test_pulse_widths_with_the_stray_letter() -> None:
    widths = tuple(range(1100, 1900, 50))
    assert pulses(FORM % widths) == list(widths)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (b'{"steer": 0.1, "force": 2.00, "brake": 0.00}', "morse-pwm"),
        (b'{"pwm": []}', "morse-pwm"),
        (b'{"pwm": [' + b"1500," * 16 + b"1500]}", "morse-pwm"),
        (b'{"pwm": [-1]}', "65535"),
        (b'{"pwm": [true]}', "65535"),
        (b'{"pwm": [1500.5]}', "65535"),
        (b"garbage", "no JSON"),
        (b"\xff", "no JSON"),
    ],
)
def test_other_lines_are_refused(line: bytes, text: str) -> None:
    with pytest.raises(Refused, match=text):
        pulses(line)


def _read(line: bytes, section: str, key: str) -> list[float]:
    """As SIM_Morse.cpp does it: by looking for texts."""
    text = line.decode()
    at = text.index(section) + len(section) + 1 if section else 1
    at = text.index(key, at) + len(key) + 3
    found = re.match(r"\[(\S+), (\S+), (\S+)\]", text[at:])
    if found:
        return [float(each) for each in found.groups()]
    number = re.match(r"[-+.0-9e]+", text[at:])
    assert number is not None
    return [float(number[0])]


def test_the_autopilot_reads_back_what_is_true() -> None:
    """Turned back as its source does: roll, -pitch, -yaw; (x, -y, -z) of all vectors."""
    q = quat_from_rpy(0.1, 0.2, 0.3)
    line = sensors("heavy", 12.5, ((0.1, 0.2, 0.3), (1.0, 2.0, -9.8)), (4.0, 5.0, 6.0), q, (1.0, 0.0, 0.0))
    assert line.endswith(b"\n")
    assert _read(line, "", "timestamp") == [12.5]
    back = (1.0, -1.0, -1.0)
    signed = lambda values: [s * v for s, v in zip(back, values, strict=True)]  # noqa: E731
    assert signed(_read(line, ".imu", "angular_velocity")) == pytest.approx([0.1, 0.2, 0.3])
    assert signed(_read(line, ".imu", "linear_acceleration")) == pytest.approx([1.0, 2.0, -9.8])
    position = [_read(line, ".gps", axis)[0] for axis in ("x", "y", "z")]
    assert signed(position) == pytest.approx([4.0, 5.0, 6.0])
    angles = [_read(line, ".pose", angle)[0] for angle in ("roll", "pitch", "yaw")]
    assert signed(angles) == pytest.approx([0.1, 0.2, 0.3])
    v_N = signed(_read(line, ".velocity", "world_linear_velocity"))
    assert v_N == pytest.approx([math.cos(0.2) * math.cos(0.3), math.cos(0.2) * math.sin(0.3), -math.sin(0.2)])


def test_the_time_stands_first() -> None:
    line = sensors("v", 1.0, ((0.0,) * 3, (0.0,) * 3), (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3)
    assert line.startswith(b'{"timestamp": 1.0, ')
